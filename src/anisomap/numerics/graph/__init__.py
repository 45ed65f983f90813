"""Dissimilarities, their shortest paths, connected components and neighbour graphs."""
