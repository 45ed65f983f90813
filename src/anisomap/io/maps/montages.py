"""Montages of electrodes: ASA ``.elc`` and BESA ``.sfp`` files, and montages of MNE.

They hold the placed sensors of a map with a scale and one component, in its frame: fiducials are
not known. Blanks in names become underscores.

Sources: the readers of MNE-Python (``mne.channels.read_custom_montage``).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from anisomap.errors import import_extra
from anisomap.io.parsing.naming import distinct_names
from anisomap.placement import Taxels, to_taxels
from anisomap.sensor_map import SensorMap

_MILLIMETRES = 1e3


def write_elc(sensor_map: SensorMap, path: Path) -> None:
    """Write positions in millimetres, then labels."""
    electrodes = to_taxels(sensor_map, "an .elc file")
    lines = [
        "# ASA electrode file",
        "ReferenceLabel\tavg",
        "UnitPosition\tmm",
        f"NumberPositions=\t{len(electrodes.names)}",
        "Positions",
        *_rows(electrodes, _MILLIMETRES),
        "Labels",
        *_labels(electrodes, path),
    ]
    path.write_text("\n".join([*lines, ""]), encoding="utf-8")


def write_sfp(sensor_map: SensorMap, path: Path) -> None:
    """Write one line per sensor: its label and position in metres, separated by tabs."""
    electrodes = to_taxels(sensor_map, "an .sfp file")
    pairs = zip(_labels(electrodes, path), _rows(electrodes), strict=True)
    path.write_text("".join(f"{label}\t{row}\n" for label, row in pairs), encoding="utf-8")


def to_montage(sensor_map: SensorMap) -> Any:
    """Convert a map to a montage of MNE.

    Parameters
    ----------
    sensor_map : SensorMap
        With a scale, and one connected component.

    Returns
    -------
    mne.channels.DigMontage
        Positions in metres in the frame of the map, which is "unknown" to MNE. Align the map with
        anchors first (`anisomap.placement.place`) to have them in the frame of a head.

    Raises
    ------
    InputError
        If the map has no scale, or several components.
    MissingExtraError
        If mne is not installed.
    """
    electrodes = to_taxels(sensor_map, "a montage")
    mne = import_extra("mne", "a montage", "mne")
    places = dict(zip(electrodes.names, electrodes.positions, strict=True))
    return mne.channels.make_dig_montage(places, coord_frame="unknown")


def _rows(electrodes: Taxels, factor: float = 1.0) -> list[str]:
    return ["\t".join(map(repr, row)) for row in (electrodes.positions * factor).tolist()]


def _labels(electrodes: Taxels, path: Path) -> tuple[str, ...]:
    return distinct_names(path, ["_".join(name.split()) for name in electrodes.names])
