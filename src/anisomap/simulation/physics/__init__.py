"""Scenarios simulated with MuJoCo."""
