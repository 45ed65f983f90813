"""Inner loops compiled with numba, and how they run in parallel."""
