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
from anisomap.evidence import SIMILARITIES
from anisomap.files import atomic_write, check_target
from anisomap.io.npz import NUMBERS, Archive, open_archive, to_json, write_arrays
from anisomap.io.parsing.facts import check_encodable
from anisomap.io.parsing.naming import distinct_names
from anisomap.io.parsing.source import file_errors
from anisomap.methods import find_method
from anisomap.options import MethodOptions
from anisomap.recording import Scalar
from anisomap.tracking import Evidence
from anisomap.tracking.pair_sums import PairSums

SUFFIX = ".statistics.npz"
"""End of the name of the file beside a map."""

_KIND = "anisomap statistics 1"
_SYMMETRIC = ("products", "weights", "precision")
_LARGEST = 1e150  # of sums, and of the inverse of weights: products of two do not overflow
_NON_NEGATIVE = ("squares", "weights", "precision")


def statistics_beside(path: str | os.PathLike[str]) -> Path:
    """Return the path of the statistics of a map: ``skin.statistics.npz`` of ``skin.csv``."""
    file = Path(path)
    return file.with_name(f"{file.stem if file.suffix else file.name}{SUFFIX}")


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
        "names": np.array(evidence.names, dtype=str),
        "method": evidence.method,
        "dimensions": evidence.dimensions,
        "options": to_json(_flattened(evidence.options)),
        "frames": evidence.n_frames,
        "recordings": np.array(evidence.recordings, dtype=str),
        "single_contacts": int(evidence.single_contacts),
    }
    for key, sums in evidence.sums.items():
        for field in fields(sums):
            matrix = getattr(sums, field.name)
            arrays[f"{key}.{field.name}"] = matrix[upper] if field.name in _SYMMETRIC else matrix
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
        archive.require("kind", "statistics of a map")
        if archive.text("kind") != _KIND:
            raise FileError(
                f"{file} holds statistics of another version of anisomap; make the map again"
            )
        for name in ("names", "method", "dimensions", "options", "frames", "recordings"):
            archive.require(name, "statistics of a map")
        names = distinct_names(file, archive.texts("names"))
        try:
            return Evidence(
                names=names,
                sums=_read_sums(archive, len(names)),
                method=_known_method(archive.text("method")),
                dimensions=_whole(archive, "dimensions"),
                options=_options(archive.mapping("options")),
                n_frames=_whole(archive, "frames"),
                recordings=tuple(sorted(archive.texts("recordings"))),
                single_contacts=bool(archive.number("single_contacts")),
            )
        except TypeError as error:
            raise FileError(
                f"{file} has options that this version of anisomap does not know ({error}); make "
                "the map again"
            ) from error
        except InputError as error:
            raise FileError(f"{file} is damaged: {error}") from error


def _read_sums(archive: Archive, n_sensors: int) -> dict[str, PairSums]:
    found = {}
    for key in SIMILARITIES:
        if f"{key}.products" not in archive.names:
            continue
        for field in fields(PairSums):
            archive.require(f"{key}.{field.name}", "statistics of a map")
        found[key] = PairSums(
            *(_matrix(archive, key, field.name, n_sensors) for field in fields(PairSums))
        )
    if not found:
        raise InputError("it holds no sums of pairs of sensors")
    return found


def _matrix(archive: Archive, key: str, name: str, n_sensors: int) -> NDArray[np.float64]:
    full = (n_sensors, n_sensors)
    shape = (n_sensors * (n_sensors + 1) // 2,) if name in _SYMMETRIC else full
    label = f"{key}.{name}"
    if archive.shape(label, NUMBERS) != shape:
        raise InputError(f"array {label} must have shape {shape}")
    values = np.asarray(archive.required(label, NUMBERS), dtype=np.float64)
    valid = np.abs(values) < _LARGEST
    if name in _NON_NEGATIVE:
        valid &= (values == 0) | (values > 1 / _LARGEST)
    if not valid.all():
        raise InputError(f"array {label} has values that no recording gives")
    if name not in _SYMMETRIC:
        return values
    matrix = np.zeros(full)
    upper = np.triu_indices(n_sensors)
    matrix[upper] = values
    matrix.T[upper] = values
    return matrix


def _known_method(name: str) -> str:
    find_method(name)
    return name


def _whole(archive: Archive, name: str) -> int:
    value = archive.number(name)
    if value is None or not value.is_integer() or value < 1:
        raise InputError(f"{name} must be a whole number above 0")
    return int(value)


def _flattened(options: MethodOptions) -> dict[str, Scalar]:
    """Return the options that differ from the defaults, those of a stage as ``stage.name``.

    Defaults are left out, so that the file can be read by versions with other options.
    """
    found: dict[str, Scalar] = {}
    usual = asdict(MethodOptions())
    for name, value in asdict(options).items():
        if isinstance(value, Mapping):
            changed = {key: entry for key, entry in value.items() if entry != usual[name][key]}
            found |= {f"{name}.{key}": entry for key, entry in changed.items()}
        elif value != usual[name]:
            found[name] = value
    return found


def _options(stored: Mapping[str, Scalar]) -> MethodOptions:
    """Restore options; `TypeError` or `InputError` if they are not those of a method."""
    options = MethodOptions()
    whole: dict[str, Any] = {key: value for key, value in stored.items() if "." not in key}
    for name in {key.partition(".")[0] for key in stored if "." in key}:
        part = getattr(options, name, None)
        if part is None or not is_dataclass(part) or isinstance(part, type):
            raise InputError(f"there is no option {name}")
        own = {k.partition(".")[2]: v for k, v in stored.items() if k.startswith(f"{name}.")}
        whole[name] = replace(part, **own)
    return replace(options, **whole)
