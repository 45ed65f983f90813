"""Inner loops compiled with numba, and the threads that run them.

Loops do not check their arguments. They release the global interpreter lock, so that threads can
work on separate rows or columns. numba is in the extra ``fast``, and importing it takes about a
second, so modules with loops are imported by `anisomap.numerics.compiled.parallel.load_loops` only
when an array is large enough.
"""
