"""A rubbed skin in random order, damage to it, and the kinds of what is found."""

from collections.abc import Iterable
from dataclasses import replace
from functools import cache

import numpy as np
from benchmarks.skins.independent import damaged
from numpy.typing import NDArray

from anisomap import Recording
from anisomap.health.findings import Finding
from skins import lattice, rubbed


@cache
def wired_at_random(seed: int = 0, n_frames: int = 1500) -> Recording:
    """Return a rubbed skin of 72 sensors whose channels are in random order."""
    positions = np.random.default_rng(seed).permutation(lattice(8, 9))
    readings = rubbed(positions, n_frames, seed=seed, reach=1.5).astype(np.float32)
    return Recording(readings, positions=positions, rate_hz=50)


def spoilt(recording: Recording, damage: str, seed: int = 0) -> Recording:
    """Damage a recording as `benchmarks.skins.independent.damaged` does."""
    return damaged(recording, damage, np.random.default_rng(seed))


def spoilt_in_part(
    recording: Recording, damage: str, share: float
) -> tuple[Recording, NDArray[np.intp]]:
    """Damage some sensors in a way that is otherwise of all; return the damaged ones as well."""
    rng = np.random.default_rng(0)
    some = rng.permutation(recording.n_sensors)[: round(share * recording.n_sensors)]
    readings = np.array(recording.readings)
    readings[:, some] = damaged(recording, damage, rng).readings[:, some]
    return replace(recording, readings=readings), some


def kinds(findings: Iterable[Finding]) -> set[str]:
    """Return the kinds of findings."""
    return {finding.kind for finding in findings}
