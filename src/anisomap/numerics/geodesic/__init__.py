"""Map lengths taken from a graph of neighbours."""
