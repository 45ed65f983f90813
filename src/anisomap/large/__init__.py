"""Recordings and maps that are larger than memory."""
