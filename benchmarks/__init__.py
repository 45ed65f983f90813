"""Benchmarks of speed (``make bench``) and of accuracy (``make quality``)."""
