"""Approximate maps of too many sensors to store all pairs.

Frames are read at least twice. The first pass projects the readings of each sensor onto a few
hundred numbers (`sketch`), from which candidates for its nearest sensors are chosen. The second
computes Pearson r of these pairs (`correlations`). The best become the edges of a graph
(`sensor_graph`). Shortest paths are computed from about a thousand landmarks to all sensors; the
landmarks are scaled, the others triangulated (`landmark_mds`), and all are refined together
(`landmark_stress`).
"""
