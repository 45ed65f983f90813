"""Multidimensional scaling: positions from distances."""
