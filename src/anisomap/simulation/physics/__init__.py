"""Scenarios in which bodies move by physics, computed by MuJoCo."""
