"""Read damaged files of every format, and check what the readers and writers do with them.

`subjects` lists what is tried, taken from the registry of formats; `damage` and `odd` change the
files; `checks` states what must hold; `workers` runs the cases in forked processes; `table`
formats the results. ``make fuzz`` runs all of it.
"""
