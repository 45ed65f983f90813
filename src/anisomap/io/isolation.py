"""Recordings that are read by libraries in another process: see `anisomap.files.reader_process`."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any

from anisomap.files import reader_process
from anisomap.io.stream import Block, Content, ReadOptions, Stream, salvage


@contextmanager
def open_isolated(
    function: Callable[..., Any], path: Path, options: ReadOptions
) -> Iterator[Stream]:
    """Open a recording by the function of a format, and read it in another process."""
    with reader_process.opened(_recording, path, *_sent(function, options)) as parts:
        facts = next(parts)
        path, names = Path(facts.pop("path")), tuple(facts.pop("names"))
        blocks = salvage((Block(**block) for block in parts), path)
        yield Stream(path, blocks=blocks, names=names, **facts)


def contents_isolated(
    function: Callable[..., Any], path: Path, options: ReadOptions
) -> tuple[Content, ...]:
    """List the content of a file by the function of a format, in another process."""
    with reader_process.opened(_contents, path, *_sent(function, options)) as parts:
        return tuple(Content(**each) for each in next(parts))


def _sent(function: Callable[..., Any], options: ReadOptions) -> tuple[Any, ...]:
    width = None if options.bin_s is None else float(options.bin_s)
    definitions = [os.fspath(each) for each in options.definitions]
    return (
        *(function.__module__, function.__name__),
        *(options.select, definitions, width, options.keep),
    )


def _called(path: Path, *sent: Any) -> Any:
    module, name, select, paths, bin_s, keep = sent
    definitions = tuple(map(Path, paths))
    options = ReadOptions(select, definitions=definitions, bin_s=bin_s, keep=tuple(keep))
    return getattr(import_module(module), name)(path, options)


def _recording(path: Path, *sent: Any) -> Iterator[dict[str, Any]]:
    """Yield the facts of a stream, and its blocks."""
    with _called(path, *sent) as stream:
        facts = {**vars(stream), "path": os.fspath(stream.path)}
        blocks = facts.pop("blocks")
        yield {**facts, "metadata": dict(stream.metadata)}
        for block in blocks:
            yield vars(block)


def _contents(path: Path, *sent: Any) -> Iterator[list[dict[str, Any]]]:
    yield [vars(each) for each in _called(path, *sent)]
