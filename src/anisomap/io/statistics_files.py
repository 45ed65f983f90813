"""Statistics of pairs of sensors beside a map, from which the map can be updated: NumPy archives.

The archive has the names of the sensors, the method with its options, and for each similarity the
sums ``products``, ``squares``, ``weights`` and ``precision``; of symmetric matrices the upper
triangle. It holds no readings.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import asdict, fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import FileError, InputError
from anisomap.files.paths import atomic_write, check_target
from anisomap.io.npz import NUMBERS, Archive, open_archive, to_json, write_arrays
from anisomap.io.parsing.facts import check_encodable
from anisomap.io.parsing.names import distinct_names
from anisomap.io.parsing.source import file_errors
from anisomap.method.evidence import SIMILARITIES
from anisomap.method.named import find_method
from anisomap.method.options import MethodOptions
from anisomap.recording import Scalar
from anisomap.tracking import Evidence, PairSums

_SUFFIX = ".statistics.npz"
_KIND = "anisomap statistics 1"
_WHAT = "statistics of a map"
_FIELDS = tuple(field.name for field in fields(PairSums))
_SYMMETRIC = ("products", "weights", "precision")
_LARGEST = 1e150  # of sums, and of the inverse of weights: products of two do not overflow
_NON_NEGATIVE = ("squares", "weights", "precision")


def statistics_beside(path: str | os.PathLike[str]) -> Path:
    """Return the path of the statistics of a map: ``skin.statistics.npz`` of ``skin.csv``."""
    file = Path(path)
    return file.with_name(f"{file.stem if file.suffix else file.name}{_SUFFIX}")


def write_statistics(evidence: Evidence, path: str | os.PathLike[str]) -> None:
    """Write the statistics of a map; an existing file is replaced after writing has succeeded.

    Parameters
    ----------
    evidence : Evidence
    path : path-like

    Raises
    ------
    FileError
        If the file cannot be written, or a name cannot be encoded.
    """
    file = check_target(path)
    check_encodable(evidence.names, file)
    upper = np.triu_indices(len(evidence.names))
    arrays: dict[str, Any] = {
        "kind": _KIND,
        "names": evidence.names,
        "method": evidence.method,
        "dimensions": evidence.dimensions,
        "options": to_json(_flattened(evidence.options)),
        "frames": evidence.n_frames,
        "recordings": evidence.recordings,
        "single_contacts": int(evidence.single_contacts),
    }
    for key, sums in evidence.sums.items():
        for name, matrix in vars(sums).items():
            arrays[f"{key}.{name}"] = matrix[upper] if name in _SYMMETRIC else matrix
    with atomic_write(file) as temporary:
        write_arrays(arrays, temporary)


def read_statistics(path: str | os.PathLike[str]) -> Evidence:
    """Read the statistics of a map.

    Parameters
    ----------
    path : path-like

    Returns
    -------
    Evidence

    Raises
    ------
    FileError
        If the file is missing or damaged, or holds no statistics.
    """
    file = Path(path)
    with file_errors(file), open_archive(file) as archive:
        archive.require("kind", _WHAT)
        if archive.text("kind") != _KIND:
            problem = "holds statistics of another version of anisomap; make the map again"
            raise FileError(f"{file} {problem}")
        for name in ("names", "method", "dimensions", "options", "frames", "recordings"):
            archive.require(name, _WHAT)
        names, method = distinct_names(file, archive.texts("names")), archive.text("method")
        try:
            find_method(method)
            return Evidence(
                names=names,
                sums=_read_sums(archive, len(names)),
                method=method,
                dimensions=_whole(archive, "dimensions"),
                options=_options(archive.mapping("options")),
                n_frames=_whole(archive, "frames"),
                recordings=tuple(sorted(archive.texts("recordings"))),
                single_contacts=bool(archive.number("single_contacts")),
            )
        except TypeError as error:
            problem = f"has options that this version of anisomap does not know ({error})"
            raise FileError(f"{file} {problem}; make the map again") from error


def _read_sums(archive: Archive, n_sensors: int) -> dict[str, PairSums]:
    held = [key for key in SIMILARITIES if f"{key}.products" in archive.names]
    if not held:
        raise InputError("it holds no sums of pairs of sensors")
    return {
        key: PairSums(*(_matrix(archive, key, name, n_sensors) for name in _FIELDS)) for key in held
    }


def _matrix(archive: Archive, key: str, name: str, n_sensors: int) -> NDArray[np.float64]:
    label, full = f"{key}.{name}", (n_sensors, n_sensors)
    archive.require(label, _WHAT)
    shape = (n_sensors * (n_sensors + 1) // 2,) if name in _SYMMETRIC else full
    if archive.shape(label) != shape:
        raise InputError(f"array {label} must have shape {shape}")
    values = archive.required(label, NUMBERS).astype(np.float64, copy=False)
    valid = np.abs(values) < _LARGEST
    if name in _NON_NEGATIVE:
        valid &= (values == 0) | (values > 1 / _LARGEST)
    if not valid.all():
        raise InputError(f"array {label} has values that no recording gives")
    if name not in _SYMMETRIC:
        return values
    matrix, upper = np.zeros(full), np.triu_indices(n_sensors)
    matrix[upper] = matrix.T[upper] = values
    return matrix


def _whole(archive: Archive, name: str) -> int:
    value = archive.number(name)
    if value is None or not value.is_integer() or value < 1:
        raise InputError(f"{name} must be a whole number above 0")
    return int(value)


def _flattened(options: MethodOptions) -> dict[str, Scalar]:
    """Return the options, as ``stage.name``, that differ from the defaults of this version."""
    found, usual = dict[str, Scalar](), asdict(MethodOptions())
    for name, value in asdict(options).items():
        if isinstance(value, Mapping):
            changed = {key: entry for key, entry in value.items() if entry != usual[name][key]}
            found |= {f"{name}.{key}": entry for key, entry in changed.items()}
        elif value != usual[name]:
            found[name] = value
    return found


def _options(stored: Mapping[str, Scalar]) -> MethodOptions:
    """Restore options; `TypeError` or `InputError` if they are not those of a method."""
    options, parts = MethodOptions(), dict[str, dict[str, Any]]()
    for key, value in stored.items():
        stage, _, name = key.rpartition(".")
        parts.setdefault(stage, {})[name] = value
    whole = parts.pop("", {})
    for stage, changed in parts.items():
        part = getattr(options, stage, None)
        if not is_dataclass(part) or isinstance(part, type):
            raise InputError(f"there is no option {stage}")
        whole[stage] = replace(part, **changed)
    return replace(options, **whole)
