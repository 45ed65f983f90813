"""A command that receives a signal at an event that Python audits; also a script of that."""

import os
import re
import sys

COUNT = 0  # no signal


def run_watched(number: int, event: str, command: list[str]) -> None:
    """Run a command, and send a signal to its process at the first event that is wanted.

    event: Regular expression of the number, name and first argument of an event. Without a signal,
        the number of events is the last line on standard error.
    """
    from anisomap.cli import main  # noqa: PLC0415

    wanted = re.compile(event)
    seen, sent = 0, False

    def watch(name: str, arguments: tuple[object, ...]) -> None:
        nonlocal seen, sent
        seen += 1
        if number != COUNT and not sent:
            sent = bool(wanted.fullmatch(f"{seen} {name} {arguments[0] if arguments else None}"))
            if sent:
                os.kill(os.getpid(), number)

    sys.addaudithook(watch)
    try:
        main(command)
    finally:
        if number == COUNT:
            sys.stderr.write(f"{seen}\n")


if __name__ == "__main__":
    run_watched(int(sys.argv[1]), sys.argv[2], sys.argv[3:])
