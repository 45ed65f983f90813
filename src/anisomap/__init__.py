"""Reconstruct the positions of a robot's tactile sensors from their readings alone.

McGregor, Polani & Dautenhahn (2011), "Generation of Tactile Maps for Artificial Skin",
PLoS ONE 6(11): e26561, doi:10.1371/journal.pone.0026561.

Names are listed in `__init__.pyi`, for type checkers, and imported on first use.
"""

# The list is read on the first use of any name, not here: the command line imports this package
# before it handles interruptions, and reading the list takes ten times as long as the rest.


def __getattr__(name: str) -> object:
    return _attached(name) if name == "__all__" else _attached("__getattr__")(name)


def __dir__() -> list[str]:
    return list(_attached("__dir__")())


def _attached(name: str):  # type: ignore[no-untyped-def]
    """Replace the functions above by those of the list; return one of them, or the list."""
    import lazy_loader  # noqa: PLC0415

    parts = lazy_loader.attach_stub(__name__, __file__)
    globals().update(zip(("__getattr__", "__dir__", "__all__"), parts, strict=True))
    return globals()[name]
