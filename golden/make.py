"""Make the stored recordings that are missing: ``python -m golden.make [NAME ...]``.

Physics differs between machines, so a recording that exists is made again only if it is named.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from benchmarks.skins.footprints import FOOTPRINTS
from benchmarks.verdicts.faults import sized

from anisomap.recording import Recording
from anisomap.simulation import SCENARIOS, find_body, inject, simulate
from golden.cases import FOLDER, SOURCES, Source

RATE_HZ = 20.0


def made(source: Source, seed: int) -> Recording:
    """Simulate a recording of sensors in random order."""
    rng = np.random.default_rng(seed)
    body = find_body(source.body, source.n_sensors)
    skins = []
    for _ in range(source.skins):
        if source.stimulus in SCENARIOS:
            one = simulate(body, source.stimulus, n_frames=source.n_frames, seed=rng)
        else:
            places = np.array(body.positions)
            readings = FOOTPRINTS[source.stimulus](places, source.n_frames, rng)
            one = Recording(readings, positions=places, units=body.units)
        skins.append(one)
    readings = np.zeros((source.n_frames * source.skins, sum(one.n_sensors for one in skins)))
    first = 0
    for number, one in enumerate(skins):
        frames = slice(number * source.n_frames, (number + 1) * source.n_frames)
        readings[frames, first : first + one.n_sensors] = one.readings
        first += one.n_sensors
    positions = np.vstack([np.asarray(one.positions) for one in skins])
    order = rng.permutation(len(positions))
    recording = Recording(readings[:, order], positions=positions[order], rate_hz=RATE_HZ)
    for fault in filter(None, source.fault.split("+")):
        recording = inject(recording, sized(fault, recording), rng=seed)
    return replace(recording, units=skins[0].units)


def main(names: Sequence[str]) -> None:
    """Make the named recordings, or all that are missing."""
    for seed, (name, source) in enumerate(SOURCES.items(), start=1):
        path = FOLDER / "readings" / f"{name}.npz"
        if name in names or (not names and not path.exists()):
            recording = made(source, seed)
            times: dict[str, Any] = {} if recording.times is None else {"times": recording.times}
            np.savez_compressed(
                path,
                readings=recording.readings.astype(source.dtype),
                positions=np.asarray(recording.positions, dtype=np.float32),
                rate_hz=RATE_HZ,
                units=recording.units,
                **times,
            )
            print(f"{name}: {recording}, {path.stat().st_size / 1024:.0f} kB")


if __name__ == "__main__":
    main(sys.argv[1:])
