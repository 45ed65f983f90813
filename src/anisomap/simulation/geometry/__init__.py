"""Solids, triangle meshes, points and distances on surfaces."""
