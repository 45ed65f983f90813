"""Read files by libraries in another process, within limits of memory and time.

With damaged files, libraries may use unlimited memory, run forever, or terminate the process. A
request is a line of JSON; an answer is a line of JSON, followed by the bytes of its arrays.
"""

from __future__ import annotations

import atexit
import ctypes
import errno
import faulthandler
import json
import logging
import math
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
import traceback
import warnings
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager, suppress
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import AnisomapError, AnisomapWarning, DamagedError, FileError, error_reason
from anisomap.files.budget import Budget
from anisomap.numerics.precision import physical_memory

if sys.platform != "win32":
    import resource

_COPIES, _ANY = 2, 1 << 62  # copies of unpacked contents in memory; no limit of bytes
_SECONDS, _BYTES_PER_SECOND = 10, 50_000  # processor time on a slow machine
_PATIENCE = 10  # elapsed time on a busy machine, relative to processor time
_WATCH_S = 0.05
_OUT_OF_MEMORY = 99  # exit code
_NO_SPACE = (errno.EFBIG, errno.ENOMEM)

_SERVE = "from anisomap.files.reader_process import serve; serve()"
_ENVIRONMENT = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
_ARRAY = "\0array"
_OF_VALUES = (ValueError, ArithmeticError, OSError, EOFError)
_OF_CODE = (TypeError, AttributeError, IndexError)  # messages refer to code of a library


@contextmanager
def opened(function: Callable[..., Any], path: Path, *arguments: Any) -> Iterator[Iterator[Any]]:
    """Call a generator function in another process: ``function(path, *arguments)``.

    Arguments and results are JSON, or arrays in JSON. Exceptions by libraries or by unreadable
    values become a `DamagedError`.
    """
    budget, folder = Budget(path), None
    with suppress(OSError):  # the file may have been removed
        folder = os.getcwd()  # noqa: PTH109
    request = {
        "module": function.__module__,
        "function": function.__name__,
        "path": os.fspath(path),
        "arguments": arguments,
        "folder": folder,
        "memory": min(_COPIES * budget.limit, (physical_memory() or _ANY) // 2),
        "seconds": _SECONDS + budget.size // _BYTES_PER_SECOND,
    }
    try:
        reader = _idle[os.getpid()].pop()
        answer = reader.ask(request)
    except (LookupError, _StoppedError):  # an earlier file may have corrupted the process
        reader = _Reader()
        answer = reader.ask(request)

    def answers() -> Iterator[Any]:
        found = _value(answer)
        while found is not None:
            yield found
            found = _value(reader.ask({}))

    try:
        yield answers()
    finally:
        reader.close()


class _StoppedError(DamagedError):
    """A library has terminated the process that reads a file."""


class _Reader:
    """A process that reads files, one after another."""

    def __init__(self) -> None:
        self._folder = Path(tempfile.mkdtemp(prefix="anisomap-"))
        self._said = self._folder / "stderr.txt"
        self._request: dict[str, Any] = {}
        folders = dict.fromkeys(("TMPDIR", "TEMP", "TMP"), os.fspath(self._folder))
        folders["PYTHONPATH"] = os.pathsep.join(map(os.path.abspath, sys.path))
        with self._said.open("wb") as said:
            self._process: Any = subprocess.Popen(  # noqa: S603
                [sys.executable, "-P", "-c", _SERVE, self._folder],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=said,
                cwd=self._folder,
                env={**os.environ, **_ENVIRONMENT, **folders},
            )

    def ask(self, request: dict[str, Any]) -> dict[str, Any]:
        """Send a request, and return the answer."""
        self._request = self._request | request
        answer: dict[str, Any] = {"ends": True}
        try:
            self._process.stdin.write(json.dumps(request).encode() + b"\n")
            self._process.stdin.flush()
            answer = _receive(self._process.stdout)
        except (OSError, EOFError):
            raise self._ended(self._process.wait()) from None
        finally:
            if answer["ends"]:
                self.stop()
        return answer

    def close(self) -> None:
        """Close the file, and keep the process for other files."""
        if self._process.returncode is None:
            with suppress(AnisomapError):
                self.ask({"close": True})
                _idle.setdefault(os.getpid(), []).append(self)

    def stop(self) -> None:
        """Terminate the process, and remove its files."""
        self._process.kill()
        self._process.wait()
        with suppress(OSError):
            self._process.stdin.close()
        self._process.stdout.close()
        shutil.rmtree(self._folder, ignore_errors=True)

    def _ended(self, code: int) -> Exception:
        path, said = self._request["path"], self._said.read_text(errors="replace")
        if -code == getattr(signal, "SIGXCPU", 0) or said.startswith("Timeout"):
            seconds = self._request["seconds"]
            return FileError(f"{path}: reading takes more than {seconds} s; it is damaged")
        killed = code == _OUT_OF_MEMORY or -code == getattr(signal, "SIGKILL", 0)
        if killed or "MemoryError" in said:  # also while an error was answered
            return FileError(_too_large(self._request))
        if 0 <= code < 256:
            return RuntimeError(f"the process that reads {path} has ended: {said}")
        name = f"exit code {code}" if code > 0 else str(signal.strsignal(-code)).lower()
        error = _StoppedError(f"{path} is damaged: the library that reads it stopped ({name})")
        error.__cause__ = RuntimeError(f"the library that reads it stopped: {name}")
        return error


_idle: dict[int, list[_Reader]] = {}
"""Idle reader processes, by the process that started them; forked processes start their own."""


@atexit.register
def stop_all() -> None:
    """Terminate idle reader processes."""
    for reader in _idle.pop(os.getpid(), []):
        reader.stop()


def _too_large(request: dict[str, Any]) -> str:
    return (
        f"{request['path']}: reading takes more than {request['memory'] / 1e6:.0f} MB of memory; "
        "it is damaged or a decompression bomb (if not, store it uncompressed)"
    )


def _value(answer: dict[str, Any]) -> Any:
    """Return the result in an answer; repeat warnings and raise errors of the other process."""
    for text in answer["warnings"]:
        warnings.warn(text, AnisomapWarning, stacklevel=2)
    if "error" not in answer:
        return answer["value"]
    kind = next((kind for kind in _kinds(AnisomapError) if kind.__name__ == answer["error"]), None)
    if kind is None:
        raise RuntimeError(answer["message"])
    error = kind.__new__(kind)
    AnisomapError.__init__(error, answer["message"])
    vars(error).update(answer["facts"])
    raise error from RuntimeError(answer["reason"])


def _kinds(kind: type[AnisomapError]) -> Iterator[type[AnisomapError]]:
    yield kind
    for each in kind.__subclasses__():
        yield from _kinds(each)


def _receive(stream: Any) -> dict[str, Any]:
    def with_arrays(value: dict[str, Any]) -> Any:
        if _ARRAY not in value:
            return value
        kind, shape = value[_ARRAY]
        array = np.empty(shape, kind)
        if stream.readinto(array.reshape(-1).view("u1")) < array.nbytes:
            raise EOFError
        return array

    line = stream.readline()
    if not line.endswith(b"\n"):
        raise EOFError
    answer: dict[str, Any] = json.loads(line, object_hook=with_arrays)
    return answer


def _send(stream: Any, answer: dict[str, Any]) -> None:
    arrays: list[NDArray[Any]] = []

    def plain(value: Any) -> Any:
        if isinstance(value, np.generic):
            return value.item()
        arrays.append(np.ascontiguousarray(value))
        return {_ARRAY: [value.dtype.str, value.shape]}

    stream.write(json.dumps(answer, default=plain).encode() + b"\n")
    for array in arrays:
        stream.write(array.data)
    stream.flush()


def serve() -> None:
    """Answer the requests on standard input, in the other process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the requesting process is interrupted, too
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # libraries print there
    logging.disable()
    if sys.platform != "linux":
        threading.Thread(target=_watch, daemon=True).start()
    parts, patience_s = _parts({}), 0
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("ignore")
        warnings.simplefilter("always", AnisomapWarning)
        for line in sys.stdin.buffer:
            request = json.loads(line)
            answer: dict[str, Any] = {"ends": False}
            try:
                if "path" in request:
                    _limit(request["memory"], request["seconds"])
                    parts, patience_s = _parts(request), _PATIENCE * request["seconds"]
                faulthandler.dump_traceback_later(patience_s, exit=True)
                if "close" in request:
                    parts.close()
                answer |= {"value": next(parts, None)}
            except Exception as error:
                answer |= _description(error)
            texts = [str(each.message) for each in caught if each.category is AnisomapWarning]
            caught.clear()
            faulthandler.cancel_dump_traceback_later()
            _send(answers, {**answer, "warnings": texts})
    shutil.rmtree(sys.argv[1], ignore_errors=True)  # the requesting process has ended


def _description(error: Exception) -> dict[str, Any]:
    if not isinstance(error, AnisomapError):
        return {"ends": True, "error": "", "message": traceback.format_exc()}
    return {
        "ends": isinstance(error.__cause__, MemoryError),  # the state of libraries is undefined
        "error": type(error).__name__,
        "message": str(error),
        "facts": vars(error),
        "reason": error_reason(error.__cause__ or error),
    }


def _parts(request: dict[str, Any]) -> Generator[Any, None, None]:
    """Yield the results of a function that reads a file."""
    if request["folder"]:
        os.chdir(request["folder"])
    try:
        function = getattr(import_module(request["module"]), request["function"])
        yield from function(Path(request["path"]), *request["arguments"])
    except Exception as error:
        known = isinstance(error, AnisomapError)
        cause = error.__cause__ if known else error
        if isinstance(cause, MemoryError) or getattr(cause, "errno", 0) in _NO_SPACE:
            raise FileError(_too_large(request)) from cause
        if known or not _is_damage(error):
            raise
        of_code = isinstance(error, _OF_CODE)
        reason = "a value is missing or of another type" if of_code else error_reason(error)
        raise DamagedError(f"{request['path']} is damaged or cut short: {reason}") from error


def _is_damage(error: Exception) -> bool:
    """Return whether a library or a value in a file caused an error; other errors are defects."""
    place = error.__traceback__
    while place is not None and place.tb_next is not None:
        place = place.tb_next
    name = "" if place is None else str(place.tb_frame.f_globals.get("__name__"))
    return isinstance(error, _OF_VALUES) or name.partition(".")[0] != "anisomap"


def _limit(memory: int, seconds: int) -> None:
    """Limit additional memory and processor time of this process."""
    _allowed[0] = _memory_used() + memory
    if sys.platform != "win32":
        used = resource.getrusage(resource.RUSAGE_SELF)
        for which, value in (
            (resource.RLIMIT_CPU, math.ceil(used.ru_utime + used.ru_stime + seconds)),
            (resource.RLIMIT_CORE, 0),
            (resource.RLIMIT_FSIZE, memory),
            *([(resource.RLIMIT_DATA, _allowed[0])] if sys.platform == "linux" else []),
        ):
            most = resource.getrlimit(which)[1]
            resource.setrlimit(which, (value if most < 0 else min(value, most), most))


_allowed = [_ANY]
"""Bytes of memory that this process may use."""


def _memory_used() -> int:
    if sys.platform == "linux":
        pages = Path("/proc/self/statm").read_text(encoding="ascii").split()
        return int(pages[5]) * resource.getpagesize()
    if sys.platform != "win32":
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    counters = (ctypes.c_size_t * 9)(72)  # PROCESS_MEMORY_COUNTERS of 64 bits, and its size
    ctypes.windll.psapi.GetProcessMemoryInfo(ctypes.c_void_p(-1), counters, 72)
    return counters[7]  # PagefileUsage


def _watch() -> None:
    """Terminate this process at its limit of memory, on systems without such limits."""
    while _memory_used() < _allowed[0]:
        time.sleep(_WATCH_S)
    os._exit(_OUT_OF_MEMORY)
