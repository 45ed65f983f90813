"""Dissimilarities of pairs of objects, from a square matrix, a triangle or a list of pairs.

A matrix has one row per object. Names may stand in the first row, in the first column or in both.
One triangle suffices, with or without the diagonal: the other cells are empty or left out. A list
has three columns: two names and a value. Words for missing values are unknown pairs. PHYLIP's files
begin with the number of objects. A vector in the order of ``scipy.spatial.distance.pdist`` holds
the pairs above the diagonal. Other formats than text hold the matrix as the readings of a
recording.
"""

from __future__ import annotations

import itertools
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
from anisomap.files.budget import Budget
from anisomap.files.paths import open_regular
from anisomap.io import npz
from anisomap.io.parsing.names import distinct_names
from anisomap.io.parsing.source import file_errors, open_text, quote, read_head, read_lines
from anisomap.io.parsing.tables import is_number, parse_number, read_sample, records
from anisomap.io.recordings import contact_lists, delimited_text
from anisomap.io.registry import read
from anisomap.recording import default_names, match_sensors

Rows = list[list[str]]
_MARKS = (",", ";", "\t")

_ALIKE = 0.5  # r of cells across the diagonal, of nearly symmetric matrices
_LEAST = 4  # objects of a matrix that is recognised; smaller ones look like many tables
_DOUBT = (
    "give --dissimilarities if it holds the dissimilarities of objects, or --no-dissimilarities if "
    "it is a recording"
)
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
    values[np.abs(values) <= _ROUNDING * np.nanmax(np.abs(values), initial=0)] = 0
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


def read_pair_weights(path: Path, names: Sequence[str]) -> NDArray[np.float64]:
    """Read weights of the pairs of N objects, 1 for those that the file lacks. Returns (N, N).

    Objects are matched by name, or by order if no name is shared.
    """
    values, own = _read_pairs(path)
    with file_errors(path):
        found, _ = match_sensors(own, names, "the weights and the dissimilarities")
    if (found < 0).any():
        raise FileError(f"{path}: there is no object {own[int(np.argmin(found))]} to weight")
    weights = np.ones((len(names), len(names)))
    weights[np.ix_(found, found)] = np.where(np.isnan(values), 1, values)
    if (weights < 0).any():
        raise FileError(f"{path}: weights must be at least 0")
    return weights


def find_dissimilarities(path: Path) -> Dissimilarities | None:
    """Recognise dissimilarities; None for anything else.

    They are a list of two names and a value per line; or a square matrix, or a triangle, that is
    symmetric, with a diagonal of 0 and positive values elsewhere. Raises InputError if the diagonal
    is only constant, or a value 0, or a list has numbers for names and each pair once, so that it
    may be a recording as well.
    """
    rows, n_lines = _sampled(path)
    pairs = _pairs_of(rows) if rows else []
    if _names_pairs(pairs):
        return read_dissimilarities(path)
    if _numbers_pairs(pairs) and not contact_lists.is_text(path, read_head(path)):
        raise InputError(
            f"{path} has a pair of different numbers and a value per line: {_DOUBT} of 3 sensors"
        )
    if not _may_be_square(path, rows, n_lines):
        return None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", AnisomapWarning)
            values, names = _read_values(path, lists=False)
    except InputError:
        return None
    if values.shape != (len(names),) * 2 or len(names) < _LEAST:
        return None
    values = np.where(np.isinf(values), np.nan, values)
    own = np.diag(values)[~np.isnan(np.diag(values))]
    others = values[~np.eye(len(values), dtype=bool)]
    tolerance = _ROUNDING * np.abs(values).max(where=np.isfinite(values), initial=0)
    if np.isnan(others).all() or (np.abs(own - own[:1]) > tolerance).any():
        return None
    positive = not (np.abs(own) > tolerance).any() and not (others <= 0).any()
    cell = _asymmetry(values)
    if cell is None and not positive:
        raise InputError(_doubt(path, len(values)))
    if cell is not None and positive and _resembles_transpose(values):
        raise InputError(
            f"{path} has a diagonal of 0 and is nearly symmetric: {_cells(values, names, *cell)}. "
            f"Correct it, and {_DOUBT} of {len(values)} frames"
        )
    return None if cell else read_dissimilarities(path)


def doubt_of(path: Path, readings: NDArray[np.generic]) -> str:
    """Return what to ask if readings, shape (T, N), may be dissimilarities; empty if not."""
    n = len(readings)
    if readings.shape != (n, n) or n < _LEAST or (np.diag(readings) != readings[0, 0]).any():
        return ""
    return _doubt(path, n) if np.array_equal(readings, readings.T) else ""


def _doubt(path: Path, n: int) -> str:
    return f"{path} is a symmetric matrix of {n} x {n}: {_DOUBT} of {n} frames"


def _sampled(file: Path) -> tuple[Rows, int]:
    """Return the rows of the first lines of delimited text, and their number; none of others."""
    if file.is_dir():
        return [], 0
    with suppress(FileError), file_errors(file):
        head = read_head(file)
        if delimited_text.recognises(file, head) and not head.startswith(delimited_text.SIGNATURE):
            sample = read_sample(file)
            return _rows(sample), len(sample)
    return [], 0


def _rows(lines: Sequence[str]) -> Rows:
    """Split lines into rows of cells by the mark in half of them, since triangles vary in width."""
    marks = (mark for mark in ";\t," if 2 * sum(mark in line for line in lines) >= len(lines))
    return [[cell.strip() for cell in row] for _, row in records(lines, next(marks, None))]


def _names_pairs(pairs: Rows) -> bool:
    """Return whether rows hold two names, which take either place, and a value."""
    first, second = ({row[place] for row in pairs} for place in (0, 1))
    return bool(first & second) and _number(pairs[0][0]) is None


def _numbers_pairs(pairs: Rows) -> bool:
    """Return whether rows hold each pair of whole numbers once, and no fewer pairs than numbers."""
    found = {frozenset(row[:2]) for row in pairs}
    numbers = {cell for pair in found for cell in pair}
    once = len(found) == len(pairs) and {*map(len, found)} == {2}
    return once and len(found) >= len(numbers) and all(map(str.isdecimal, numbers))


def _may_be_square(file: Path, rows: Rows, n_lines: int) -> bool:
    """Return whether a file has about as many rows as columns, by those of its first lines."""
    with suppress(FileError), file_errors(file):
        if rows:
            n_columns = max(map(len, rows))
            with open_text(file) as text:
                more = itertools.islice(text, n_lines, n_lines + n_columns)
                n_rows = len(rows) + sum(1 for _ in more)
            return n_columns > 2 and n_columns - 1 <= n_rows <= n_columns + 1
        if not file.is_dir() and read_head(file).startswith(npz.ARRAY_MAGIC):
            with open_regular(file) as stream:
                shape = npz.read_header(stream, "the array").shape
            return len(shape) == 2 and shape[0] == shape[1]
    return False


def _read_pairs(file: Path) -> tuple[NDArray[np.float64], tuple[str, ...]]:
    """Return values, (N, N), symmetric and NaN where unknown, and the names of the objects."""
    return _symmetric(file, *_read_values(file))


def _read_values(file: Path, *, lists: bool = True) -> tuple[NDArray[np.float64], tuple[str, ...]]:
    """Return values, (N, N), and the names of the objects."""
    with file_errors(file):
        if not delimited_text.recognises(file, read_head(file)):
            if (vector := _stored_vector(file)) is not None:
                return _from_vector(file, vector)
            recording = read(file)
            return recording.readings.astype(float), recording.names
        lines = read_lines(file)
        rows = _rows(lines)
        if not rows:
            raise FileError(f"{file} is empty")
        *_, before, last = ("", *(line.rstrip("\r\n ") for line in lines))
        if last == lines[-1] and last.endswith(_MARKS) and not before.endswith(_MARKS):
            raise FileError(f"{file} is cut short: its last line ends with {quote(last[-1])}")
        Budget(file).check(8 * len(rows) ** 2, "its matrix")
        pairs = _pairs_of(rows) if lists else []
        if pairs:
            values, names = _from_list(file, pairs)
        elif lists and (1 in (len(rows), max(map(len, rows)))) and len(rows) * len(rows[0]) > 1:
            cells = [_number(cell) for row in rows for cell in row]
            if None in cells:
                wrong = quote([cell for row in rows for cell in row][cells.index(None)])
                raise FileError(f"{file} holds one row or column, in which {wrong} is not a number")
            values, names = _from_vector(file, np.array(cells, dtype=np.float64))
        else:
            values, names = _from_table(file, _of_phylip(file, lines) or rows)
        return values, distinct_names(file, names)


def _stored_vector(file: Path) -> NDArray[np.float64] | None:
    """Return the array of an NPY file if it has a single axis."""
    if not read_head(file).startswith(npz.ARRAY_MAGIC):
        return None
    with open_regular(file) as stream:
        header = npz.read_header(stream, "the array")
        if len(header.shape) != 1 or header.dtype.kind not in "biuf":
            return None
        n_bytes = header.shape[0] * header.dtype.itemsize
        Budget(file).check(n_bytes, "the array")
        if len(content := stream.read(n_bytes)) < n_bytes:
            raise FileError(f"{file} is cut short: its array lacks {n_bytes - len(content)} bytes")
        return np.frombuffer(content, header.dtype).astype(np.float64)


def _from_vector(
    file: Path, vector: NDArray[np.float64]
) -> tuple[NDArray[np.float64], tuple[str, ...]]:
    """Return a matrix from the pairs above its diagonal, row by row."""
    n = (1 + math.isqrt(1 + 8 * len(vector))) // 2
    if n * (n - 1) // 2 != len(vector):
        raise FileError(
            f"{file} has {len(vector)} numbers, which are not the pairs of N objects, N (N - 1) / 2"
        )
    Budget(file).check(8 * n**2, "its matrix")
    values = np.zeros((n, n))
    values[np.triu_indices(n, 1)] = vector
    return values + values.T, default_names(n)


def _of_phylip(file: Path, lines: Sequence[str]) -> Rows:
    """Return the rows of a square or lower triangle of PHYLIP, which begins with its size."""
    words = [line.split() for line in lines if line.strip()]
    if not words or len(words[0]) != 1 or not words[0][0].isdecimal() or len(words[0][0]) > 6:
        return []
    n, found = int(words[0][0]), list(itertools.chain.from_iterable(words[1:]))
    if len(found) == n * (n + 1):
        return [found[i : i + n + 1] for i in range(0, len(found), n + 1)]
    if len(found) != n + n * (n - 1) // 2:
        if len(words) > 1 and len(words[1]) > 1 and _number(words[1][0]) is None:
            raise FileError(
                f"{file} announces {n} objects, but what follows is neither a square nor a lower "
                f"triangle of them: {len(found)} names and numbers; names must not hold blanks"
            )
        return []
    rows, start = Rows(), 0
    for i in range(n):
        rows.append([*found[start : start + i + 1], "0"])
        start += i + 1
    return rows


def _number(cell: str) -> float | None:
    """Convert a cell, which may have a decimal comma: NaN if it is unknown, None if it is text."""
    return parse_number(cell, None) if is_number(cell, None) else None


def _pairs_of(rows: Rows) -> Rows:
    """Return the rows of a list, two names and a value each; three rows of numbers are a matrix."""
    pairs = rows[len(rows[0]) != 3 or _number(rows[0][2]) is None :]
    if any(len(row) != 3 or _number(row[2]) is None for row in pairs):
        return []
    texts = {_number(cell) is None for row in pairs for cell in row[:2]}
    return pairs if texts == {True} or (texts == {False} and len(pairs) > 3) else []


def _from_list(file: Path, body: Rows) -> tuple[NDArray[np.float64], tuple[str, ...]]:
    names = tuple(dict.fromkeys(name for row in body for name in row[:2]))
    Budget(file).check(8 * len(names) ** 2, "its matrix")
    index = {name: i for i, name in enumerate(names)}
    values = np.full((len(names), len(names)), np.nan)
    np.fill_diagonal(values, 0)
    for first, second, cell in body:
        pair, value = (index[first], index[second]), _number(cell)
        if value is not None and values[pair] != value:
            if not math.isnan(values[pair]):
                raise FileError(
                    f"{file} gives two values for {quote(first)} and {quote(second)}: "
                    f"{values[pair]:g} and {value:g}"
                )
            values[pair] = value
    return values, names


def _split_labels(rows: Rows) -> tuple[Rows, list[str]]:
    """Separate the names in the first row and the first column from the cells."""
    header: list[str] = []
    column = [row[0] for row in rows if row]
    repeated = column[1:] == rows[0][1:] and len(column) > 2 and math.isnan(_number(column[0]) or 0)
    if repeated or any(_number(cell) is None for cell in rows[0][1:]):
        header, rows, column = rows[0], rows[1:], column[1:]
    wide = header and max(map(len, rows), default=0) > len(rows)
    if not wide and all(_number(cell) is not None for cell in column):
        return rows, header
    if len(header) > len(column) + 1:
        raise InputError(
            f"its first row names {len(header)} objects, and {len(column)} rows follow"
        )
    header = header[len(header) > len(column) :]
    rows = [row[1:] for row in rows]
    if header and header != column and len(rows[0]) < len(rows[-1]):
        return rows, [header[0], *column]  # a triangle as R prints it, without its diagonal
    return rows, column


def _from_table(file: Path, rows: Rows) -> tuple[NDArray[np.float64], tuple[str, ...]]:
    """Return a matrix from its rows, or from those of a triangle."""
    cells, names = _split_labels(rows)
    body = [[_number(cell) for cell in row] for row in cells]
    for i, row in enumerate(body):
        if None in row:
            wrong = quote(cells[i][row.index(None)])
            raise FileError(f"{file}, row {i + 1} of the matrix: {wrong} is not a number")
    widths, n_rows = [len(row) for row in body], len(body)
    if set(widths) == {n_rows}:
        return np.array(body, dtype=float), tuple(names) or default_names(n_rows)
    steps = set(np.diff(widths).tolist())
    if steps not in ({1}, {-1}) or min(widths) > 1:
        raise FileError(
            f"{file} has {n_rows} rows of {min(widths, default=0)} to {max(widths, default=0)} "
            "numbers; dissimilarities are a square matrix, a triangle, or lines of two names and a "
            "value"
        )
    if upper := steps == {-1}:
        body, names = [row[::-1] for row in body[::-1]], names[::-1]
    zeros = [row[-1] == 0 for row in body if row]
    if len(zeros) > 2 and all(zeros[:-1]) and not zeros[-1]:
        raise FileError(
            f"{file} is damaged or cut short: one row of its triangle does not end at 0"
        )
    ends_at_0 = all(zeros)
    n = len(body[-1]) + (len(names) != len(body[-1]) and (bool(names) or not ends_at_0))
    if names and len(names) != n:
        raise FileError(f"{file} names {len(names)} objects, but its triangle has {n}")
    values = np.full((n, n), np.nan)
    for i, row in enumerate(body, start=n - n_rows):
        values[i, : len(row)] = row
    np.fill_diagonal(values, 0)
    if upper:
        values, names = values[::-1, ::-1], names[::-1]
    return values, tuple(names) or default_names(n)


def _symmetric(
    file: Path, values: NDArray[np.float64], names: tuple[str, ...]
) -> tuple[NDArray[np.float64], tuple[str, ...]]:
    """Fill each triangle from the other; raise unless they agree where both are known."""
    if values.shape != (len(names),) * 2:
        raise FileError(
            f"{file} has {values.shape[0]} rows of {values.shape[1]} numbers and {len(names)} "
            "names; dissimilarities are a square matrix"
        )
    values = np.where(np.isinf(values), np.nan, values)
    if (cell := _asymmetry(values)) is not None:
        cells = _cells(values, names, *cell)
        raise FileError(f"{file} is not symmetric: {cells}; average both first")
    filled = np.where(np.isnan(values), values.T, values)
    return (filled + filled.T) / 2, names


def _asymmetry(values: NDArray[np.float64]) -> tuple[int, int] | None:
    """Return the first cell that differs from the one across the diagonal by more than rounding."""
    values = np.where(np.isinf(values), np.nan, values)
    apart = np.abs(values - values.T) > _ROUNDING * np.nanmax(np.abs(values), initial=0)
    if not apart.any():
        return None
    i, j = np.argwhere(apart)[0].tolist()
    return i, j


def _cells(values: NDArray[np.float64], names: Sequence[str], i: int, j: int) -> str:
    return (
        f"{names[i]} to {names[j]} is {values[i, j]:g}, but {names[j]} to {names[i]} is "
        f"{values[j, i]:g}"
    )


def _resembles_transpose(values: NDArray[np.float64]) -> bool:
    """Return whether cells correlate with those across the diagonal."""
    rows, columns = np.triu_indices(len(values), 1)
    pairs = np.array([values[rows, columns], values[columns, rows]])
    pairs = pairs[:, np.isfinite(pairs).all(axis=0)]
    if pairs.shape[1] < 2 or not (np.ptp(pairs, axis=1) > 0).all():
        return False
    return bool(np.corrcoef(pairs)[0, 1] > _ALIKE)
