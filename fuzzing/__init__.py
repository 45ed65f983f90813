"""Read damaged files of every format, and check what the readers and writers do with them.

`subjects` lists what is tried, `damage` and `odd` change the files, `checks` and `uses` state what
must hold, `workers` runs the cases in forked processes. ``python -m fuzzing`` runs all of it.
"""
