"""Read recordings of formats with a library in the process for readers."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any

from anisomap import reader_process
from anisomap.io.stream import Block, Content, ReadOptions, Stream, salvage


@contextmanager
def open_recording(
    function: Callable[..., Any], path: Path, options: ReadOptions
) -> Iterator[Stream]:
    """Open a recording by a format's `open_recording`, and read it in another process."""
    with reader_process.opened(_recording, path, function.__module__, *_sent(options)) as parts:
        facts = next(parts)
        path, names = Path(facts.pop("path")), tuple(facts.pop("names"))
        blocks = salvage((Block(**block) for block in parts), path)
        yield Stream(path, blocks=blocks, names=names, **facts)


def contents(function: Callable[..., Any], path: Path, options: ReadOptions) -> tuple[Content, ...]:
    """List the content of a file by a format's `contents`, in another process."""
    with reader_process.opened(_contents, path, function.__module__, *_sent(options)) as parts:
        return tuple(Content(**each) for each in next(parts))


def _sent(options: ReadOptions) -> tuple[str, list[str], float | None]:
    width = None if options.bin_s is None else float(options.bin_s)
    return options.select, [os.fspath(each) for each in options.definitions], width


def _received(select: str, definitions: list[str], bin_s: float | None) -> ReadOptions:
    return ReadOptions(select, definitions=tuple(map(Path, definitions)), bin_s=bin_s)


def _recording(path: Path, module: str, *options: Any) -> Iterator[dict[str, Any]]:
    """Yield the facts of a stream, and its blocks."""
    with import_module(module).open_recording(path, _received(*options)) as stream:
        facts = {**vars(stream), "path": os.fspath(stream.path)}
        blocks = facts.pop("blocks")
        yield {**facts, "metadata": dict(stream.metadata)}
        for block in blocks:
            yield vars(block)


def _contents(path: Path, module: str, *options: Any) -> Iterator[list[dict[str, Any]]]:
    yield [vars(each) for each in import_module(module).contents(path, _received(*options))]
