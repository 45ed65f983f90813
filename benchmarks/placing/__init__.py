"""Accuracy of maps that are placed and updated."""
