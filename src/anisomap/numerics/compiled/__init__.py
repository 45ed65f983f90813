"""Inner loops compiled with numba, and the threads that run them.

Loops do not check their arguments. They release the interpreter's lock, so that threads can work
on separate rows or columns. Importing numba takes about a second: modules with loops are loaded by
`anisomap.numerics.compiled.parallel.load_loops` when an array is large enough.
"""
