"""Wires of opposite polarity, and wires that were exchanged during a recording."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anisomap.health.recording_faults import Found, agree_more
from anisomap.health.recording_faults.stimulation import one_period
from anisomap.health.sensors import MIN_CONTACTS
from anisomap.numerics.graph.neighbour_graphs import greatest_of_rows
from anisomap.numerics.neighbours import tree_edges
from anisomap.numerics.precision import Reals
from anisomap.numerics.reliability.sampling_noise import FALSE_ALARMS, block_length
from anisomap.numerics.signals import (
    MAX_FRAMES,
    Signals,
    count_contacts,
    normal_maximum,
    some_sensors,
    standardised,
    unit_rows,
)
from anisomap.numerics.similarity.rest import ranks_of_depths
from anisomap.recording import Recording

_MIN_SKEWNESS = 0.5  # magnitude of the skewness of sensors that are touched occasionally; by hand
_MIN_SKEWED = 0.8  # share of sensors that must have this skewness; chosen by hand
_MIN_AGREEMENT = 0.7  # share of the strongest correlations whose sign must be explained; by hand
_MAX_UNSKEWED = 0.4  # share of the smaller part of sensors without skewness; chosen by hand
_MIN_CROSSING = 0.5  # strongest correlations between parts, relative to random pairs; by hand
_N_COUNTED = 4
_MIN_COUNTED = 0.2  # magnitude of correlations whose sign counts; chosen by hand


def find_inverted(recording: Recording) -> Iterator[Found]:
    """Find sensors on which contact has the opposite sign.

    Sensors are at rest most of the time, so readings are skewed to the side of contact. Two parts
    of opposite skewness are reported only if correlations agree: the strongest correlations must be
    negative between the parts, and positive within them. If most readings are not skewed or do not
    rest, as of sensors that are often in contact, the signs of correlations along a maximum
    spanning tree determine the parts, which must then be mixed. Sensors with fewer than 5 contacts,
    or that resemble no other sensor, are not judged, since their signs may be due to chance. If the
    strongest correlation of a suspect is positive and with such a sensor, it is not inverted.
    Sensors are mirrored only if they have 10 contacts on average, 5 in each half of the recording,
    and then resemble the others in both halves. Sines of one period can have any sign.
    """
    if one_period(recording):
        return
    judged = np.flatnonzero(_often_touched(recording))
    readings = recording.readings[:: -(-recording.n_frames // MAX_FRAMES)][:, judged]
    standard = standardised(readings)
    skewness = np.einsum("ti,ti,ti->i", standard, standard, standard) / len(standard)
    skewed = np.abs(skewness) >= _MIN_SKEWNESS
    if judged.size < 3 or (np.mean(skewed) >= _MIN_SKEWED and _are_equal(skewness[skewed] > 0)):
        return
    correlation = _clear_correlations(recording, judged, readings, standard)
    related = correlation.any(axis=1)
    if np.count_nonzero(related) < 3:
        return
    judged, skewness, skewed = judged[related], skewness[related], skewed[related]
    skewed_apart = np.mean(skewed) >= _MIN_SKEWED
    if skewed_apart and _are_equal(skewness[skewed] > 0):
        return
    skewed_apart &= np.mean(recording.signals.rest.known[judged]) >= _MIN_SKEWED
    kept = np.flatnonzero(related)
    if skewed_apart:
        kept, judged, skewness = kept[skewed], judged[skewed], skewness[skewed]
    correlation = correlation[np.ix_(kept, kept)]
    signs = np.sign(skewness) if skewed_apart else _signs_along_tree(correlation)
    lowered = signs * np.sign(signs @ skewness or 1) < 0
    if not skewed_apart and not _mixed(correlation, lowered):
        return
    fewer = lowered if 2 * np.count_nonzero(lowered) <= judged.size else ~lowered
    found = judged[_confirmed(correlation, fewer)]
    if found.size:
        found = found[~_rise_with_others(recording, found)]
    if found.size:
        mended = _mirrored(recording, found)
        known = recording.signals.contacts[found].mean() >= 2 * MIN_CONTACTS
        known &= agree_more(recording.readings, mended.readings, found)
        values = {"n_sensors": recording.n_sensors}
        mend = (lambda recording: _mirrored(recording, found)) if known else None
        yield Found(found, found.size / recording.n_sensors, values, mend)


def _rise_with_others(recording: Recording, suspects: NDArray[np.intp]) -> NDArray[np.bool_]:
    """Return whether suspects have their strongest correlation, above 0, with another sensor."""
    rows = unit_rows(recording.readings[:: -(-recording.n_frames // MAX_FRAMES)])
    correlation = rows[suspects] @ rows.T
    correlation[np.arange(suspects.size), suspects] = 0
    strongest = np.abs(correlation).argmax(axis=1)
    positive = correlation[np.arange(suspects.size), strongest] > 0
    return np.asarray(positive & ~np.isin(strongest, suspects))


def _are_equal(raised: NDArray[np.bool_]) -> bool:
    return bool(raised.all() or not raised.any())


def _often_touched(recording: Recording) -> NDArray[np.bool_]:
    """Return whether sensors have enough contacts, and readings beyond rest, for a sign, (N,)."""
    beyond = np.count_nonzero(recording.signals.touched, axis=0)
    few = recording.signals.contacts < MIN_CONTACTS
    return np.asarray((beyond >= _enough(recording)) & ~few)


def _enough(recording: Recording) -> float:
    """Return how many times an event of probability 1/2 must recur to exclude chance.

    With probability 2^-k, k readings of noise have the same sign, and k contacts of a sensor
    coincide with no contact of a sensor that is touched half of the time. For the number returned,
    at most `FALSE_ALARMS` of N sensors are expected to do so.
    """
    return math.log2(recording.n_sensors / FALSE_ALARMS)


def _clear_correlations(
    recording: Recording,
    sensors: NDArray[np.intp],
    readings: NDArray[Any],
    values: NDArray[np.float32],
) -> NDArray[np.float32]:
    """Correlate sensors, (n, n); 0 where the sign may be chance.

    readings, values (t, n): Readings in some frames, and standardised readings.

    Noise causes correlations of either sign. If few contacts of a sensor never coincide with those
    of another one, r is negative, but at least - m_i m_j, where m is the mean distance from rest in
    standard deviations, since the mean product of two distances is at least 0.
    """
    correlation = values.T @ values / np.float32(len(values))
    np.fill_diagonal(correlation, 0)
    by_chance = normal_maximum(len(correlation) ** 2 / 2) / math.sqrt(len(values))
    rest, contacts = recording.signals.rest.select(sensors), recording.signals.contacts[sensors]
    distance = np.abs(readings.mean(axis=0, dtype=np.float64) - rest.value)
    m = distance / np.maximum(readings.std(axis=0, dtype=np.float64), 1e-300)
    m[~rest.known | (contacts >= _enough(recording))] = 0
    clear = np.abs(correlation) >= max(_MIN_COUNTED, by_chance)
    clear &= (correlation > 0) | (correlation < -np.outer(m, m) - by_chance)
    return np.where(clear, correlation, np.float32(0))


def _mirrored(recording: Recording, sensors: NDArray[np.intp]) -> Recording:
    """Mirror the readings of sensors about rest."""
    readings = np.array(recording.readings)
    rest = recording.signals.rest.value[sensors].astype(readings.dtype)
    readings[:, sensors] = 2 * rest - readings[:, sensors]
    return replace(recording, readings=readings)


def _signs_along_tree(correlation: NDArray[np.float32]) -> NDArray[np.float64]:
    """Multiply the signs of correlations along a maximum spanning tree of their magnitudes."""
    signs = np.ones(len(correlation))
    for new, joined in tree_edges(np.abs(correlation)):
        signs[new] = signs[joined] if correlation[joined, new] >= 0 else -signs[joined]
    return signs


def _mixed(correlation: NDArray[np.float32], lowered: NDArray[np.bool_]) -> bool:
    """Return whether the strongest correlations join both parts as often as random pairs do.

    If a signal changes sign across the skin, such as bending or the field of a source, the parts
    are halves of the skin, and the strongest correlations are within the parts. Such parts cannot
    be distinguished from inverted sensors.
    """
    sizes = np.count_nonzero(lowered), np.count_nonzero(~lowered)
    if min(sizes) > _MAX_UNSKEWED * lowered.size:
        return False
    crossing = np.count_nonzero(lowered[np.abs(correlation).argmax(axis=1)] != lowered)
    expected = 2 * sizes[0] * sizes[1] / max(1, lowered.size - 1)
    return bool(crossing > 0 and crossing >= _MIN_CROSSING * expected)


def _confirmed(correlation: NDArray[np.float32], suspects: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Mark suspects whose strongest correlations have the signs that an inversion causes.

    Only correlations between the parts are evidence: correlations within parts may all be positive
    without an inversion.
    """
    if not suspects.any() or suspects.size < 3:
        return np.zeros_like(suspects)
    strength = np.abs(correlation)
    counted = greatest_of_rows(strength, min(_N_COUNTED, suspects.size - 1)) & (strength > 0)
    same = suspects[:, None] == suspects
    explained = counted & ((correlation > 0) == same)
    n_across, n_explained = np.count_nonzero(counted & ~same), explained.sum(axis=1)
    if not 0 < _MIN_AGREEMENT * n_across <= np.count_nonzero(explained & ~same):
        return np.zeros_like(suspects)
    enough = n_explained >= _MIN_AGREEMENT * counted.sum(axis=1)
    return np.asarray(suspects & (n_explained > 0) & enough)


_MAX_BLOCKS = 16  # of a recording, an even number; it may change after every second one
_MIN_FRAMES = 640  # with fewer, real insoles without a change are reported
_MAX_COMPARED = 8192  # frames whose ranks are correlated
_MIN_CONTACTS = 3  # minimum contacts of a sensor in each compared part, for a correlation
_MIN_SENSORS = 8  # minimum number of sensors with these contacts
_MIN_REPEATED = 0.7  # minimum median agreement of parts of blocks in random order
_MIN_KEPT, _LOST = 2 / 3, 1 / 2  # shares of this agreement below which sensors count, and are named
_MAX_REACH = 2.0  # ratio of the numbers of similar sensors: folding a skin doubles it at most
_N_TYPICAL, _N_PERMUTATIONS = 9, 199  # orders of blocks: of the typical agreement, and of the test
# Minimum ratio of the loss to the loss in all orders, since places are not touched in random order;
# and minimum loss, of half a sensor.
_MARGIN, _LEAST_LOSS = 1.25, 0.3


def find_change(recording: Recording) -> Iterator[Found]:
    """Find sensors that resemble other sensors from some frame on.

    Wires were exchanged, or the body took another posture. Blocks of a recording are divided into
    an earlier and a later part. The agreement of a sensor is the correlation of its similarities
    in both parts; its loss is the deficit relative to two thirds of the agreement for blocks in
    random order. The loss, summed over sensors, must clearly exceed the loss for each of 199 random
    orders. Depths are relative to rest in each eighth of the recording, since rest differs between
    wires. Recordings with clearly larger contacts in one part, in which sensors resemble many more
    others, are not judged.
    """
    chosen = some_sensors(recording.n_sensors)
    step = -(-recording.n_frames // _MAX_COMPARED)
    readings = recording.readings[::step][:, chosen]
    # Blocks that share contacts are more similar than blocks in random order.
    n_blocks = 2 * (min(_MAX_BLOCKS, len(readings) // block_length(readings)) // 2)
    if recording.n_frames < _MIN_FRAMES or n_blocks < 4:
        return
    moments, contacts = _of_blocks(readings, n_blocks)
    rng = np.random.default_rng(0)
    best: tuple[float, int, NDArray[np.intp]] | None = None
    for division in range(2, n_blocks - 1, 2):
        sums = np.array([part.sum(axis=0) for part in np.split(contacts, [division])])
        judged = np.flatnonzero(sums.min(axis=0) >= _MIN_CONTACTS)
        if judged.size < _MIN_SENSORS:
            continue
        agreements = partial(_agreements, moments, judged)
        (found,) = agreements([np.arange(n_blocks) < division])
        least = _LEAST_LOSS if best is None else max(_LEAST_LOSS, best[0] * judged.size)
        if _loss(found, 1.0) < least:  # the typical agreement is 1 at most
            continue
        orders = [rng.permutation(n_blocks) < division for _ in range(_N_PERMUTATIONS)]
        # The median of all orders is at most the maximum of more than half of them.
        some = agreements(orders[: _N_TYPICAL // 2 + 1])
        highest = some.max(axis=0)
        if _loss(found, highest) < least or np.median(highest) < _MIN_REPEATED:
            continue
        others = agreements(orders[len(some) : _N_TYPICAL])
        typical = np.median(np.concatenate([some, others]), axis=0)
        lost = judged[found < _LOST * typical]
        if lost.size < 2:  # no sensor has lost all its neighbours: another posture
            lost = judged[found < _MIN_KEPT * typical]
        loss = _loss(found, typical)
        unclear = lost.size < 2 or loss < least or np.median(typical) < _MIN_REPEATED
        if unclear or _ratio_of_reach(moments, judged, division) > _MAX_REACH:
            continue
        if all(
            loss > _MARGIN * _loss(agreements([one])[0], typical) for one in orders[_N_TYPICAL:]
        ):
            best = loss / judged.size, division, lost
    if best is not None:
        _, division, lost = best
        frame = division * recording.n_frames // n_blocks
        where = {"frame": frame, "n_frames": recording.n_frames}
        yield Found(chosen[lost], lost.size / chosen.size, where)


def _of_blocks(readings: NDArray[Any], n_blocks: int) -> tuple[Reals, NDArray[np.intp]]:
    """Return sums of products of ranks, (blocks, n + 1, n + 1), and contacts, (blocks, n).

    readings (T, n). A column of ones turns products into sums and counts as well.
    """
    moments, contacts = [], []
    for piece in np.array_split(readings, n_blocks // 2):
        signals = Signals(piece)
        ranks = ranks_of_depths(piece, signals.rest, single=True)
        values = np.column_stack([ranks - ranks.mean(axis=0), np.ones(len(ranks), ranks.dtype)])
        moments += [block.T @ block for block in np.array_split(values, 2)]
        contacts += [count_contacts(block) for block in np.array_split(signals.touched, 2)]
    return np.array(moments), np.array(contacts)


def _agreements(
    blocks: Reals, sensors: NDArray[np.intp], orders: Sequence[NDArray[np.bool_]]
) -> Reals:
    """Correlate similarities of n sensors in some blocks and in all others, (orders, n)."""
    found = []
    shares = np.array(orders, blocks.dtype) @ blocks.reshape(len(blocks), -1)
    total = blocks.sum(axis=0)
    for earlier in shares.reshape(-1, *total.shape):
        parts = [_correlation(one, sensors) for one in (earlier, total - earlier)]
        sums = [one.sum(axis=1) for one in parts]
        before, product, after = (
            np.einsum("ij,ij->i", parts[i], parts[j]) - sums[i] * sums[j] / (sensors.size - 1)
            for i, j in ((0, 0), (0, 1), (1, 1))
        )
        found.append(product / np.sqrt(np.maximum(before * after, 1e-24)))
    return np.array(found)[:, sensors]


def _ratio_of_reach(blocks: Reals, sensors: NDArray[np.intp], division: int) -> float:
    """Return the ratio of the numbers of similar sensors of a sensor in two parts."""
    parts = (_correlation(one.sum(axis=0), sensors) for one in np.split(blocks, [division]))
    similar = [np.median((np.maximum(r[sensors], 0) ** 2).sum(axis=1)) for r in parts]
    return float(max(similar) / max(min(similar), 1e-12))


def _loss(agreement: Reals, typical: Reals | float) -> float:
    return float(np.maximum(_MIN_KEPT * typical - agreement, 0).sum())


def _correlation(moments: Reals, sensors: NDArray[np.intp]) -> Reals:
    """Correlate some sensors, given sums of products; 0 for other pairs and the diagonal."""
    sums, count = moments[-1, :-1], moments[-1, -1]
    found = moments[:-1, :-1] - np.outer(sums, sums / count)
    scale = np.zeros_like(sums)
    scale[sensors] = 1 / np.sqrt(np.maximum(np.diag(found)[sensors], 1e-9 * count))
    found *= scale[:, None]
    found *= scale
    np.fill_diagonal(found, 0)
    return np.asarray(found)
