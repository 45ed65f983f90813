"""Dissimilarities as edges of a graph: shortest paths, components, neighbour graphs."""
