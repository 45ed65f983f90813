"""Scenarios that are simulated with MuJoCo."""
