"""Solids, triangle meshes, and points spread over their surfaces."""
