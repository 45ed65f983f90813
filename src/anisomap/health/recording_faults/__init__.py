"""Faults of the read-out that concern several sensors, and courses that no map can be made of.

Each module finds one fault in a complete recording, or a few alike, says what was found, and mends
it where possible. Faults are searched in an excerpt of some thousand frames and some hundred
sensors; see `anisomap.numerics.signals`.
"""
