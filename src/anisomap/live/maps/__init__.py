"""Maps of a session.

====================  ============================================================
`statistics`          what is accumulated of the frames
`quick_map`           the quick map, which follows the session
`examination`         the checked map: the default method, sensor health and verdict
`coach`               where to touch next
`workers`             the processes that make the maps
`session_maps`        when maps are made, and what they show so far
====================  ============================================================
"""
