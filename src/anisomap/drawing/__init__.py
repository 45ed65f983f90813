"""Figures and reports of maps, recordings and scenes."""
