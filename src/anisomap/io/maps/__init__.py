"""Readers and writers of maps, one module per kind of file."""
