"""Similarities of sensors: correlations and mutual information of their readings."""
