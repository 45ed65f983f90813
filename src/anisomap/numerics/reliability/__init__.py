"""Reliability of correlations: sampling noise, split-half reliability and significance."""
