"""Drift: the reading at rest changes slowly, as in electronics that warm up."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import betainc

from anisomap.health.recording_faults import Found
from anisomap.numerics.columns import centred_rows
from anisomap.recording import Recording

_N_BLOCKS = 20  # of frames, whose levels at rest are compared; chosen by hand
_N_AT_REST = 14  # the lowest blocks: contacts that last for whole blocks raise them less; by hand
_FALSE_DISCOVERIES = 0.01  # expected share of the sensors that are found by chance
# The same, for the test whether a recording drifts at all. Contacts longer than a block make levels
# dependent: of recordings of few sensors with such contacts, 1 % were accused (measured).
_FALSE_RECORDINGS = 5e-4
_MIN_BLOCK, _MAX_BLOCK = 20, 128  # frames of a block, and those that are used
_LEVEL = 0.25  # quantile that lies at rest even if a sensor is touched in most frames of a block
_MIN_SIZE = 0.1  # standard deviations of the readings; less changes no correlation; by hand


def find_drift(recording: Recording) -> Iterator[Found]:
    """Find sensors whose level at rest drifts.

    The level at rest of a block is the quartile of its readings opposite to contact. Without drift,
    the levels of the blocks are in random order; with drift, successive levels are similar. A press
    that lasts for one or two blocks also makes successive levels similar, but not the lowest ones.
    A recording therefore drifts only if the lowest 14 of the 20 levels of a sensor, in the order of
    time, are similar. In such a recording, sensors of which all 20 levels are similar drift as
    well. Sensors in which one value occurs often have no drift.
    """
    chosen = recording.signals.never_at_rest
    size = recording.n_frames // _N_BLOCKS
    if size < _MIN_BLOCK or not chosen.size:
        return
    readings, step = recording.readings, -(-size // _MAX_BLOCK)
    frames = np.arange(size * _N_BLOCKS).reshape(_N_BLOCKS, size)[:, ::step]
    values = centred_rows(readings[frames.ravel()][:, chosen])
    values *= _contact_side(readings, chosen)[:, None]
    values = values.reshape(chosen.size, *frames.shape)
    values.sort(axis=2)
    levels = values[:, :, round(_LEVEL * (values.shape[2] - 1))]
    left = (values - levels[:, :, None]).var(axis=2, dtype=np.float64).mean(axis=1) ** 0.5
    lowest = np.sort(np.argsort(levels, axis=1, kind="stable")[:, :_N_AT_REST], axis=1)

    def found(some: NDArray[np.float32], share: float) -> NDArray[np.bool_]:
        judged = some.std(axis=1) >= _MIN_SIZE * left
        return _discoveries(np.where(judged, _chances(some), 1), share)

    drifting = found(np.take_along_axis(levels, lowest, axis=1), _FALSE_RECORDINGS)
    if drifting.any():
        drifting |= found(levels, _FALSE_DISCOVERIES)
        drift = float(np.median((np.ptp(levels, axis=1) / np.maximum(left, 1e-300))[drifting]))
        yield Found(chosen[drifting], drift, {"n_sensors": recording.n_sensors})


def _chances(levels: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return p-values for the similarity of successive levels. levels (n, blocks) -> (n,).

    Von Neumann's ratio of ranks, a quarter of which is about beta distributed: Bartels (1982),
    Journal of the American Statistical Association 77: 40-46, doi:10.1080/01621459.1982.10477764.
    """
    n = levels.shape[1]
    one, other = levels[:, :, None], levels[:, None]
    ranks = (one > other).sum(axis=2) + ((one == other).sum(axis=2) + 1) / 2
    spread = np.maximum(n * ranks.var(axis=1), 1)
    ratios = (np.diff(ranks, axis=1) ** 2).sum(axis=1) / spread
    shape = 5 * n * (n + 1) * (n - 1) ** 2 / (2 * (n - 2) * (5 * n**2 - 2 * n - 9)) - 0.5
    return np.asarray(betainc(shape, shape, np.minimum(ratios / 4, 1)))


def _discoveries(chances: NDArray[np.float64], share: float) -> NDArray[np.bool_]:
    """Mark the p-values that are significant at a given false discovery rate, (n,).

    Benjamini & Hochberg (1995), Journal of the Royal Statistical Society B 57: 289-300,
    doi:10.1111/j.2517-6161.1995.tb02031.x.
    """
    ordered = np.sort(chances)
    below = ordered <= share * np.arange(1, ordered.size + 1) / ordered.size
    return np.asarray(chances <= ordered[below].max(initial=-1))


def _contact_side(readings: NDArray[Any], sensors: NDArray[np.intp]) -> NDArray[np.float32]:
    """Return the sign of the skewness of fast changes of some sensors: 1 or -1, shape (n,)."""
    from scipy.ndimage import uniform_filter1d  # noqa: PLC0415, slow to import

    values = centred_rows(readings[:: -(-len(readings) // 4096)][:, sensors])
    window = max(3, values.shape[1] // _N_BLOCKS) | 1
    values -= uniform_filter1d(values, window, axis=-1, mode="nearest")
    skewed_down = np.einsum("nt,nt,nt->n", values, values, values) < 0
    return np.where(skewed_down, np.float32(-1), np.float32(1))
