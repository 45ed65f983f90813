"""Figures and reports of maps, recordings and simulated scenes."""
