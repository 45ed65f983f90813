"""Readers and writers of maps: one file a format."""
