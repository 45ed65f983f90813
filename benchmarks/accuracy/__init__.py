"""Accuracy of maps, of dimensions and of checks of layouts."""
