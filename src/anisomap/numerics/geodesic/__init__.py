"""Refinement of maps by path lengths on a graph of neighbours."""
