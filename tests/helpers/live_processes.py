"""Live sessions: sources that are given, and processes of their own, as users run them."""

import json
import os
import queue
import signal
import subprocess
import sys
import threading
import time
from contextlib import nullcontext
from pathlib import Path

from anisomap.live.batches import WAIT_S, Source

LONGEST_S = 300
"""Time after which a process counts as hung; far more than a busy machine needs."""


class Given(Source):
    """A source that yields some items, and then nothing."""

    greeting, description = "", "a test"

    def __init__(self, items=()):
        self._items = iter(items)

    def open(self):
        return nullcontext()

    def receive(self):
        try:
            return next(self._items)
        except StopIteration:
            time.sleep(WAIT_S)
            raise TimeoutError from None

    def parse(self, item):
        yield item


def wait_until(condition, what="it"):
    """Wait until a condition is true, for something that tells nobody."""
    end = time.monotonic() + LONGEST_S
    while not condition():
        assert time.monotonic() < end, f"{what} has not happened"
        time.sleep(0.02)


def wait_for_maps(session, condition):
    """Wait until the maps of a session meet a condition."""
    with session.changed:
        assert session.changed.wait_for(lambda: condition(session.maps), timeout=LONGEST_S)


class LiveProcess:
    """``anisomap live`` with ``--json``, of which the events are read as they come."""

    def __init__(self, folder, *arguments, **options):
        self.process = subprocess.Popen(
            [sys.executable, "-m", "anisomap", "live", *map(str, arguments), "--json"],
            cwd=folder,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
            **options,
        )
        self.events, self.lines, self.said = queue.Queue(), [], []
        self.readers = [
            threading.Thread(target=read, daemon=True) for read in (self._read, self._listen)
        ]
        for reader in self.readers:
            reader.start()

    def _read(self):
        for line in self.process.stdout:
            self.lines.append(line)
            if line.startswith("{") and len(line) > 2:
                self.events.put(json.loads(line))
        self.events.put(None)

    def _listen(self):
        self.said.extend(self.process.stderr)

    def wait_for(self, condition):
        """Return the first event that meets a condition."""
        while True:
            event = self.events.get(timeout=LONGEST_S)
            assert event is not None, "the session ended: " + "".join(self.said)
            if condition(event):
                return event

    def port(self, text):
        """Wait for the notice that begins with a text and ends with a port; return the port."""
        event = self.wait_for(lambda e: any(text in notice for notice in e["notices"]))
        return int(next(notice for notice in event["notices"] if text in notice).split()[-1])

    def children(self):
        """Return the processes that the session has started, where the system lists them."""
        path = Path(f"/proc/{self.process.pid}/task/{self.process.pid}/children")
        return [int(pid) for pid in path.read_text().split()] if path.exists() else []

    def end(self, number=signal.SIGINT):
        """Send a signal; return the exit code, and what was said on standard error."""
        self.process.send_signal(number)
        return self.join()

    def join(self):
        code = self.process.wait(LONGEST_S)
        for reader in self.readers:
            reader.join(LONGEST_S)
        return code, "".join(self.said)

    def close(self):
        """Kill the process and those that it has started, which hold its pipes, and close these."""
        if self.process.poll() is None:
            os.killpg(self.process.pid, signal.SIGKILL)
        self.join()
        self.process.stdout.close()
        self.process.stderr.close()

    @property
    def result(self):
        """The object that is printed at the end."""
        text = "\n" + "".join(self.lines)
        return json.loads(text[text.rindex("\n{\n") :])
