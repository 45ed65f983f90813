"""Small data sets for examples and tests, in the package: nothing is downloaded."""

from __future__ import annotations

from importlib.resources import as_file, files

from sklearn.utils import Bunch

from anisomap.io import read_dissimilarities

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
    >>> fitted = Anisomap(metric="precomputed", method="ordinal").fit(ekman.dissimilarities)
    >>> round(fitted.stress_, 3)
    0.023
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
    with as_file(files(__package__) / "data" / f"{name}.csv") as path:
        found = read_dissimilarities(path)
    return Bunch(dissimilarities=found.values, names=found.names, DESCR=description)
