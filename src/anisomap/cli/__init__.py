"""The command line, with one module per command."""

# Nothing but what the interpreter has loaded is imported here, so that `main` handles
# interruptions within a millisecond: `signal` and `typing` take 5 to 10 times as long.
import _signal  # type: ignore[import-not-found]
import os

INTERRUPTED = 130
"""Exit code after Ctrl-C: 128 + SIGINT, as shells report it."""

INTERRUPTION = "interrupted; no file was left half-written"
"""Message after Ctrl-C."""

# Objects created between two searches for unreachable ones. Modules are hundreds of thousands of
# objects that stay: with Python's default of 700, the searches take a tenth of the time of imports.
_NEW_OBJECTS = 100_000

# What libraries read when they are imported.
_ENVIRONMENT = {
    # Binary logarithm of the clock ticks for which threads wait busily for work: its least. By
    # default, they take .05 s of a second processor when numpy is loaded, and again with scipy.
    "OPENBLAS_THREAD_TIMEOUT": "4",
    # MuJoCo would start a process that looks for a graphics library, which is needed in the process
    # that renders only: it sets its own.
    "MUJOCO_GL": "disable",
}


def main(arguments: list[str] | None = None) -> None:
    """Run the command line of this process: see `anisomap.cli.app.run`.

    If the process is interrupted or terminated, temporary files are removed before it ends. The
    process should end with this call, which sets how often it collects garbage and how its threads
    wait: from Python, use the functions of `anisomap` instead.
    """
    try:
        if _signal.getsignal(_signal.SIGINT) is _signal.default_int_handler:
            _signal.signal(_signal.SIGINT, end)
    except ValueError:
        pass  # not the main thread, which alone handles signals
    import gc

    gc.set_threshold(_NEW_OBJECTS)
    for name, value in _ENVIRONMENT.items():
        os.environ.setdefault(name, value)
    from anisomap.cli.app import run_process

    run_process(arguments)


def end(*_: object) -> None:
    """End the process as interrupted, before a command has begun.

    No exception is raised: code that is being imported could catch it, or report it as another.
    """
    os.write(2, f"error: {INTERRUPTION}\n".encode())
    os._exit(INTERRUPTED)
