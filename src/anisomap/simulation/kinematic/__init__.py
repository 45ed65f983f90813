"""Scenarios with prescribed motion of the stimulus."""
