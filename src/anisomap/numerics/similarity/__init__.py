"""Pairwise statistics of readings: correlations and mutual information."""
