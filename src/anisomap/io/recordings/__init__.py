"""Readers of recordings, one module per kind of file."""
