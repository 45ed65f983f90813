"""Faults of the read-out that concern several sensors or the course of the readings.

Each module finds one fault in readings of shape (T, N), and removes it where possible. Faults are
searched in an excerpt of some thousand frames and some hundred sensors; see
`anisomap.numerics.signals`.
"""
