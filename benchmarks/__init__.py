"""Benchmarks of speed and of accuracy."""
