"""Verdicts on maps, and faults that are found."""
