"""Numerical methods on arrays: similarities, graphs, scaling and their reliability."""
