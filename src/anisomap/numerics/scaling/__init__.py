"""From distances to positions: classical scaling and SMACOF."""
