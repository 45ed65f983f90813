"""Dissimilarities of pairs of objects, from a square matrix, a triangle or a list of pairs.

A matrix has one row per object. Names may stand in the first row, in the first column or in both.
One triangle suffices, with or without the diagonal: the other cells are empty or left out. A list
has three columns: two names and a value. Empty cells, ``NA`` and ``NaN`` are unknown pairs. Other
formats than text hold the matrix as the readings of a recording.
"""

from __future__ import annotations

import math
import os
import warnings
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import AnisomapWarning, FileError, InputError
from anisomap.io.parsing import delimited
from anisomap.io.parsing.naming import distinct_names
from anisomap.io.parsing.source import file_errors, open_text, quote, read_head, read_lines
from anisomap.io.parsing.table import parse_number
from anisomap.io.recordings import delimited_text, npy
from anisomap.io.registry import read
from anisomap.memory import Budget
from anisomap.recording import default_names, match_sensors

Cells = list[list[float | str]]

_UNKNOWN = ("na", "n/a", ".", "-")  # as R, spreadsheets and statistics programs write them
_LEAST = 4  # objects of a matrix that is recognised; smaller ones look like many tables
_ROUNDING = 1e-6  # of values that were printed with 7 digits, relative to the largest


@dataclass(frozen=True, eq=False)
class Dissimilarities:
    """Dissimilarities of all pairs of N objects.

    Attributes
    ----------
    values : ndarray of shape (N, N)
        Symmetric, zero diagonal; infinite where unknown.
    names : tuple of str
        Names of the objects.
    """

    values: NDArray[np.float64]
    names: tuple[str, ...]


def read_dissimilarities(path: str | os.PathLike[str]) -> Dissimilarities:
    """Read dissimilarities.

    Parameters
    ----------
    path : path-like
        Delimited text with a square matrix, a triangle, or lines of two names and a value; or any
        recording format, whose readings are the matrix.

    Returns
    -------
    Dissimilarities

    Raises
    ------
    FileError
        If the file is missing or damaged, the matrix is not square or not symmetric, the diagonal
        is not 0, or a value is negative.
    """
    file = Path(path)
    values, names = _read_pairs(file)
    diagonal = np.diag(values)
    if (diagonal != 0).any() and not np.isnan(diagonal).all():
        i = int(np.flatnonzero(diagonal != 0)[0])
        raise FileError(
            f"{file}: the dissimilarity of {names[i]} to itself is {diagonal[i]:g}; it must be 0. "
            "Convert similarities first: correlations r, for instance, to sqrt(2 (1 - r))"
        )
    if (values < 0).any():
        i, j = np.argwhere(values < 0)[0]
        raise FileError(
            f"{file}: the dissimilarity of {names[i]} and {names[j]} is {values[i, j]:g}; it must "
            "be at least 0"
        )
    found = np.where(np.isnan(values), np.inf, values)
    np.fill_diagonal(found, 0)
    found.setflags(write=False)
    return Dissimilarities(found, names)


def read_pair_weights(path: str | os.PathLike[str], names: Sequence[str]) -> NDArray[np.float64]:
    """Read weights of the pairs of objects.

    Parameters
    ----------
    path : path-like
        As for `read_dissimilarities`. Objects are matched by name, or by order if no name is
        shared; pairs without a weight have weight 1.
    names : sequence of str
        Names of the N objects.

    Returns
    -------
    ndarray of shape (N, N)
        Symmetric; 0 marks a pair to leave out.

    Raises
    ------
    FileError
        As `read_dissimilarities`, or if an object is unknown.
    """
    file = Path(path)
    values, own = _read_pairs(file)
    with file_errors(file):
        found, _ = match_sensors(own, names, "the weights and the dissimilarities")
    if (found < 0).any():
        raise FileError(f"{file}: there is no object {own[int(np.argmin(found))]} to weight")
    weights = np.ones((len(names), len(names)))
    weights[np.ix_(found, found)] = np.where(np.isnan(values), 1, values)
    if not (weights >= 0).all() or not np.isfinite(weights).all():
        raise FileError(f"{file}: weights must be finite and at least 0")
    return weights


def find_dissimilarities(path: str | os.PathLike[str]) -> Dissimilarities | None:
    """Recognise a file of dissimilarities: a square matrix that no recording would hold.

    Parameters
    ----------
    path : path-like

    Returns
    -------
    Dissimilarities or None
        None if the file holds something else. The matrix is symmetric, its diagonal is 0, and all
        other values are positive.

    Raises
    ------
    InputError
        If the matrix is symmetric with a constant diagonal, but may be a recording as well.
    """
    file = Path(path)
    if not _may_be_square(file):
        return None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", AnisomapWarning)
            values, _ = _read_pairs(file, lists=False)
    except InputError:
        return None
    diagonal = np.diag(values)
    others = values[~np.eye(len(values), dtype=bool)]
    constant = len({*diagonal[~np.isnan(diagonal)]}) <= 1
    if len(values) < _LEAST or np.isnan(others).all() or not constant:
        return None
    if not diagonal[~np.isnan(diagonal)].any() and not (others <= 0).any():
        return read_dissimilarities(file)
    raise InputError(
        f"{file} is a symmetric matrix of {len(values)} x {len(values)}: give --dissimilarities if "
        "it holds the dissimilarities of objects, or --no-dissimilarities if it is a recording of "
        f"{len(values)} frames"
    )


def _may_be_square(file: Path) -> bool:
    """Return whether a file has about as many rows as columns, without reading all of it."""
    if file.is_dir():
        return False
    with file_errors(file), suppress(FileError):
        head = read_head(file)
        if head.startswith(npy.MAGIC):
            return True
        if head.startswith(delimited_text.SIGNATURE) or not delimited_text.recognises(file, head):
            return False
        with open_text(file) as text:
            sample = delimited.read_sample(text)
            rows = list(delimited.records(sample, _delimiter(sample)))
            n_columns = max((len(fields) for _, fields in rows), default=0)
            n_rows = len(rows) + sum(1 for _, _ in zip(range(n_columns), text, strict=False))
        return n_columns > 2 and n_columns - 1 <= n_rows <= n_columns + 1
    return False


def _read_pairs(file: Path, *, lists: bool = True) -> tuple[NDArray[np.float64], tuple[str, ...]]:
    """Return values, shape (N, N), symmetric and NaN where unknown, and the names of the objects.

    lists: Whether the file may be a list of pairs.
    """
    with file_errors(file):
        if not delimited_text.recognises(file, read_head(file)):
            recording = read(file)
            return _symmetric(file, recording.readings.astype(float), recording.names)
        lines = read_lines(file)
        delimiter = _delimiter(lines)
        decimal = "." if delimiter == "," else ","
        rows: Cells = [
            [_cell(field, decimal) for field in fields]
            for _, fields in delimited.records(lines, delimiter)
        ]
        Budget(file).check(8 * len(rows) ** 2, "its matrix")
        if not rows:
            raise FileError(f"{file} is empty")
        if lists and _is_list(rows):
            values, names = _from_list(file, rows)
        else:
            body, labels = _split_labels(rows)
            values, names = _from_table(file, body, labels)
        return _symmetric(file, values, distinct_names(file, names))


def _delimiter(lines: Sequence[str]) -> str | None:
    """Return the delimiter: that of half of the lines, since the rows of triangles differ."""
    candidates = (mark for mark in ";\t," if 2 * sum(mark in line for line in lines) >= len(lines))
    return next(candidates, None)


def _cell(field: str, decimal: str) -> float | str:
    """Convert a field to a number, NaN if it is unknown, or text."""
    text = field.strip()
    if text.lower() in _UNKNOWN:
        return math.nan
    try:
        return parse_number(text.replace(decimal, "."))
    except ValueError:
        return text


def _is_list(rows: Cells) -> bool:
    """Return whether all rows are two names and a value; three rows of numbers are a matrix."""
    body = rows[1:] if any(isinstance(cell, str) for cell in rows[0][2:]) else rows
    if not body or any(len(row) != 3 or isinstance(row[2], str) for row in body):
        return False
    named = all(isinstance(cell, str) for row in body for cell in row[:2])
    return named or (len(body) > 3 and not any(math.isnan(_number(row[1])) for row in body))


def _number(cell: float | str) -> float:
    return math.nan if isinstance(cell, str) else cell


def _name(cell: float | str) -> str:
    return f"{cell:g}" if isinstance(cell, float) else cell


def _from_list(file: Path, rows: Cells) -> tuple[NDArray[np.float64], tuple[str, ...]]:
    body = rows[1:] if isinstance(rows[0][2], str) else rows
    pairs = [(_name(row[0]), _name(row[1]), _number(row[2])) for row in body]
    names = tuple(dict.fromkeys(name for first, second, _ in pairs for name in (first, second)))
    Budget(file).check(8 * len(names) ** 2, "its matrix")
    index = {name: i for i, name in enumerate(names)}
    values = np.full((len(names), len(names)), np.nan)
    np.fill_diagonal(values, 0)
    for first, second, value in pairs:
        i, j = index[first], index[second]
        if value not in (values[i, j], math.nan) and not math.isnan(values[i, j]):
            raise FileError(
                f"{file} gives two values for {quote(first)} and {quote(second)}: "
                f"{values[i, j]:g} and {value:g}"
            )
        values[i, j] = value
    return values, names


def _split_labels(rows: Cells) -> tuple[list[list[float]], tuple[str, ...]]:
    """Separate the names in the first row and the first column from the cells."""
    header: list[str] = []
    if any(isinstance(cell, str) for cell in rows[0][1:]) or _repeats_labels(rows):
        header, rows = [_name(cell) for cell in rows[0]], rows[1:]
    column: list[str] = []
    labelled = any(row and isinstance(row[0], str) for row in rows)
    if labelled or (header and max(map(len, rows), default=0) > len(rows)):
        column, rows = [_name(row[0]) for row in rows], [row[1:] for row in rows]
        header = header[1:] if len(header) > len(column) else header
    body = [[_checked_number(cell, i) for cell in row] for i, row in enumerate(rows, 1)]
    if len(header) == len(column) and header != column and len(body[0]) < len(body[-1]):
        column = [header[0], *column]  # a triangle as R prints it, without its diagonal
    return body, tuple(column or header)


def _repeats_labels(rows: Cells) -> bool:
    """Return whether numbers in the first row and column are labels: they agree."""
    column = [row[0] for row in rows[1:] if row]
    width = len(rows[0])
    return (
        len(rows) == width > 2
        and math.isnan(_number(rows[0][0]))
        and column == rows[0][1:]
        and any(value != 0 for value in column)
    )


def _checked_number(cell: float | str, row: int) -> float:
    if isinstance(cell, str):
        raise InputError(f"row {row} of the matrix: {quote(cell)} is not a number")
    return cell


def _from_table(
    file: Path, rows: list[list[float]], names: tuple[str, ...]
) -> tuple[NDArray[np.float64], tuple[str, ...]]:
    """Return a matrix from its rows, or from those of a triangle."""
    widths = [len(row) for row in rows]
    n_rows = len(rows)
    if set(widths) == {n_rows}:
        return np.array(rows), names or default_names(n_rows)
    steps = set(np.diff(widths).tolist())
    if steps not in ({1}, {-1}):
        raise FileError(
            f"{file} has {n_rows} rows of {min(widths)} to {max(widths)} numbers; dissimilarities "
            "are a square matrix, a triangle, or lines of two names and a value"
        )
    if upper := steps == {-1}:
        rows, names = [row[::-1] for row in rows[::-1]], names[::-1]
    with_diagonal = len(names) == len(rows[-1]) or (
        not names and all(row[-1] == 0 for row in rows if row)
    )
    n = len(rows[-1]) + (not with_diagonal)
    values = np.full((n, n), np.nan)
    for i, row in enumerate(rows, start=n - n_rows):
        values[i, : len(row)] = row
    np.fill_diagonal(values, 0)
    if len(names or rows) not in (n, n_rows):
        raise FileError(f"{file} names {len(names)} objects, but its triangle has {n}")
    if upper:
        values, names = values[::-1, ::-1], names[::-1]
    return values, names if len(names) == n else default_names(n)


def _symmetric(
    file: Path, values: NDArray[np.float64], names: tuple[str, ...]
) -> tuple[NDArray[np.float64], tuple[str, ...]]:
    """Fill each triangle from the other; raise unless they agree where both are known."""
    if values.shape[0] != values.shape[1] or len(names) != len(values):
        raise FileError(
            f"{file} has {values.shape[0]} rows of {values.shape[1]} numbers and {len(names)} "
            "names; dissimilarities are a square matrix"
        )
    values = np.where(np.isinf(values), np.nan, values)
    largest = np.nanmax(np.abs(values), initial=0, where=np.isfinite(values))
    apart = np.abs(values - values.T) > _ROUNDING * largest
    if apart.any():
        i, j = np.argwhere(apart)[0]
        raise FileError(
            f"{file} is not symmetric: {names[i]} to {names[j]} is {values[i, j]:g}, but "
            f"{names[j]} to {names[i]} is {values[j, i]:g}; average both first"
        )
    both = np.where(np.isnan(values), values.T, (values + np.where(apart, 0, values.T)) / 2)
    return np.where(np.isnan(both), values, both), names
