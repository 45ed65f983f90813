"""Small data sets for examples and tests, included in the package."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from sklearn.utils import Bunch

from anisomap.io import read

_DATA = Path(__file__).parent / "data"

_EKMAN = """Similarities of 14 colours.

31 persons compared pairs of coloured lights, of the wavelengths in `names`, from 0 (no similarity)
to 4 (identical). The dissimilarity is 1 minus a quarter of the mean. The configuration is a circle.

Ekman (1954), Journal of Psychology 38: 467-474, doi:10.1080/00223980.1954.9712953. Measured values
of a publication, free to use.
"""

_EURODIST = """Road distances between 21 cities of Europe, in km.

Known from the documentation of R's ``cmdscale``. Roads wind, and two values are evidently wrong, so
that they fit no map exactly. From a table in The Cambridge Encyclopaedia. Facts, free to use.
"""

_SIMULATED = """Simulated recording of {n} sensors {where}.

The readings of ``anisomap.simulate({body!r}, {scenario!r}, n_frames={frames}, seed=1)``, rounded to
8 bits. {touched} The true positions are in metres.

Made by the anisomap developers; BSD-3-Clause, the licence of anisomap.
"""


def load_sphere() -> Bunch:
    """Load a recording of a sphere, hit by elastic balls.

    Returns
    -------
    sklearn.utils.Bunch
        `recording`, a `Recording` of 2,000 frames of 60 sensors with true positions; `DESCR`, how
        it was made, and the licence.

    Examples
    --------
    >>> import anisomap
    >>> recording = load_sphere().recording
    >>> sensor_map = anisomap.reconstruct(recording)
    >>> anisomap.score(sensor_map, recording, permutations=0).mantel.r > 0.99
    True
    """
    touched = "Elastic balls bounce off the sphere, as in the paper."
    return _recording("sphere", "on a sphere", "bombardment", touched)


def load_hexagon() -> Bunch:
    """Load a recording of a flat patch of six triangles, rubbed by a palm.

    Returns
    -------
    sklearn.utils.Bunch
        `recording`, a `Recording` of 1,500 frames of 60 sensors with true positions; `DESCR`, how
        it was made, and the licence.
    """
    touched = "A palm rubs the patch along lines and circles."
    return _recording("hexagon", "on six triangles around a vertex", "rubbing", touched)


def load_hand() -> Bunch:
    """Load a recording of a hand, rubbed by a palm.

    Returns
    -------
    sklearn.utils.Bunch
        `recording`, a `Recording` of 2,000 frames of 160 sensors with true positions; `DESCR`, how
        it was made, and the licence.
    """
    touched = "A palm rubs the hand along lines and circles."
    return _recording("hand", "on a hand with a palm and five fingers", "rubbing", touched)


def load_ekman() -> Bunch:
    """Load the dissimilarities of 14 colours.

    Returns
    -------
    sklearn.utils.Bunch
        `dissimilarities`, shape (14, 14); `names`; `DESCR`, the source and the licence.

    Examples
    --------
    >>> from anisomap import Anisomap
    >>> ekman = load_ekman()
    >>> fitted = Anisomap(metric="precomputed", method="mds").fit(ekman.dissimilarities)
    >>> round(fitted.stress_, 3)
    0.132
    """
    return _dissimilarities("ekman", _EKMAN)


def load_eurodist() -> Bunch:
    """Load the road distances between 21 cities of Europe.

    Returns
    -------
    sklearn.utils.Bunch
        `dissimilarities` in km, shape (21, 21); `names`; `DESCR`, the source and the licence.
    """
    return _dissimilarities("eurodist", _EURODIST)


def _dissimilarities(name: str, description: str) -> Bunch:
    lines = (_DATA / f"{name}.csv").read_text().splitlines()
    names, cells = zip(*(line.split(",", 1) for line in lines), strict=True)
    values = np.zeros((len(names), len(names)))
    values[np.tril_indices(len(names))] = ",".join(cells).split(",")
    return Bunch(dissimilarities=values + values.T, names=names, DESCR=description)


def _recording(name: str, where: str, scenario: str, touched: str) -> Bunch:
    recording = read(_DATA / f"{name}.npz")
    size = {"n": recording.n_sensors, "frames": recording.n_frames}
    facts = {"body": name, "where": where, "scenario": scenario, "touched": touched}
    return Bunch(recording=recording, DESCR=_SIMULATED.format(**facts, **size))
