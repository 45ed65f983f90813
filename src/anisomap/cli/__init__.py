"""The command line, with one module per command."""

# Only modules that the interpreter has loaded are imported here, so that `main` handles
# interruptions within a millisecond: `signal` and `typing` take 5 to 10 times as long.
import _signal  # type: ignore[import-not-found]
import os

INTERRUPTED = 130
"""Exit code after Ctrl-C: 128 + SIGINT, as in shells."""

INTERRUPTION = "interrupted; no file was left half-written"
"""Message after Ctrl-C."""

# Objects created between two garbage collections. Modules are hundreds of thousands of permanent
# objects: with Python's default of 700, collections take a tenth of the time of imports.
_NEW_OBJECTS = 100_000

# Environment variables that libraries read at import.
_ENVIRONMENT = {
    # Binary logarithm of the clock ticks for which threads busy-wait: the minimum. By default, they
    # take .05 s of a second processor when numpy is loaded, and again with scipy.
    "OPENBLAS_THREAD_TIMEOUT": "4",
    # MuJoCo would start a process that searches for a graphics library. Only rendering needs it;
    # the rendering process sets this variable.
    "MUJOCO_GL": "disable",
}


def main(arguments: list[str] | None = None) -> None:
    """Run the command line of this process: see `anisomap.cli.app.run`.

    If the process is interrupted or terminated, temporary files are removed before it ends. This
    call changes garbage collection and waiting threads of the process, and should be its last: in
    Python, use the functions of `anisomap` instead.
    """
    try:
        if _signal.getsignal(_signal.SIGINT) is _signal.default_int_handler:
            _signal.signal(_signal.SIGINT, end)
    except ValueError:
        pass  # only the main thread handles signals
    import gc

    gc.set_threshold(_NEW_OBJECTS)
    for name, value in _ENVIRONMENT.items():
        os.environ.setdefault(name, value)
    from anisomap.cli.app import run_process

    run_process(arguments)


def end(*_: object) -> None:
    """End the process as interrupted, before a command has begun.

    No exception is raised, since code during import could catch or replace it.
    """
    os.write(2, f"error: {INTERRUPTION}\n".encode())
    os._exit(INTERRUPTED)
