"""Readers and writers of maps, one module per format."""
