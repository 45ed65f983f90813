"""Positions at which one function of distance explains all correlations."""
