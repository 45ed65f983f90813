"""Recordings and maps larger than memory: chunks, map-reduce, checkpoints, landmarks."""
