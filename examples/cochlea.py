"""Map a cochlea: the frequency bands of synthesised sounds.

Run ``python examples/cochlea.py``; it writes ``cochlea.png``. Requires anisomap[report].
"""

import argparse
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import signal

import anisomap
from anisomap.drawing.figures import map_figure, save_figure

METHODS = ("r-anisomap", "i-anisomap", "information-distance", "isomap")
BANDS = 32
MIN_HZ, MAX_HZ = 100.0, 7000.0
RATE = 16_000  # samples per second
FRAME, WINDOW = 320, 512  # samples; frames of 20 ms
SOUND_SECONDS = 0.25  # mean duration of a sound
VOICES = 4  # simultaneous sounds
FLOOR = 1e-6  # of the largest energy


def record_cochlea(n_frames: int, seed: int) -> anisomap.Recording:
    """Record the log energy of 32 bands; positions are ERB numbers on a line.

    Glasberg & Moore (1990), Hearing Research 47: 103-138, doi:10.1016/0378-5955(90)90170-T.
    """
    rng = np.random.default_rng(seed)
    n_samples = n_frames * FRAME + WINDOW
    sound = np.sum([voice(n_samples, rng) for _ in range(VOICES)], axis=0)
    frequencies, _, spectra = signal.stft(
        sound, RATE, nperseg=WINDOW, noverlap=WINDOW - FRAME, boundary=None, padded=False
    )
    low, high = (21.4 * math.log10(1 + 0.00437 * hz) for hz in (MIN_HZ, MAX_HZ))
    erb_numbers = np.linspace(low, high, BANDS)
    centres = (10 ** (erb_numbers / 21.4) - 1) / 0.00437
    bandwidths = 1.019 * 24.7 * (1 + 0.00437 * centres)
    gammatone = (1 + ((frequencies - centres[:, None]) / bandwidths[:, None]) ** 2) ** -4.0
    energy = gammatone @ np.abs(spectra[:, :n_frames]) ** 2
    return anisomap.Recording(
        np.log10(energy + FLOOR * energy.max()).T,
        positions=np.column_stack([erb_numbers, np.zeros(BANDS)]),
        units="ERB",
        rate_hz=RATE / FRAME,
        source=f"{BANDS} bands of synthesised sounds, seed {seed}",
    )


def voice(n_samples: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Synthesise a sequence of sounds with three random resonances each; half have a pitch."""
    parts: list[NDArray[np.float64]] = []
    while sum(map(len, parts)) < n_samples:
        length = int(RATE * rng.uniform(0.4, 1.6) * SOUND_SECONDS)
        gain = rng.lognormal(0, 0.7)
        source = rng.standard_normal(length)
        if rng.random() < 0.5:
            pitch = 80 * 5 ** rng.random()
            pitch = pitch * (1 + 0.1 * np.sin(np.linspace(0, rng.uniform(0, 6), length)))
            phase = np.cumsum(pitch / RATE)
            source = 4.0 * (np.diff(np.floor(phase), prepend=0) > 0) + 0.05 * source
        for _ in range(3):
            centre = MIN_HZ * (MAX_HZ / MIN_HZ) ** rng.random()
            radius = np.exp(-np.pi * rng.uniform(0.1, 0.3) * centre / RATE)
            poles = [1, -2 * radius * np.cos(2 * np.pi * centre / RATE), radius**2]
            source = source + 2 * signal.lfilter([1 - radius], poles, source)
        parts.append(gain * source * np.hanning(length) / np.sqrt(np.mean(source**2)))
    return np.concatenate(parts)[:n_samples]


def main() -> None:
    """Map the cochlea by several methods, and draw the map of the last one."""
    parser = argparse.ArgumentParser(description="Map the frequency bands of synthesised sounds.")
    parser.add_argument("--frames", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--output", type=Path, default=Path("cochlea.png"))
    arguments = parser.parse_args()

    recording = record_cochlea(arguments.frames, arguments.seed)
    for method in METHODS:
        sensor_map = anisomap.reconstruct(recording, method, dimensions=2)
        score = anisomap.score(sensor_map, recording.positions, units=recording.units)
        print(f"{method:<20} Mantel r {score.mantel.r:.3f}")
    # Loud sounds excite all bands alike, so that even distant bands are correlated.
    evened = replace(recording, readings=recording.readings - recording.readings.mean(1)[:, None])
    score_evened = anisomap.score(
        anisomap.reconstruct(evened, "r-anisomap", dimensions=2), recording.positions
    )
    print(f"{'r-anisomap, evened':<20} Mantel r {score_evened.mantel.r:.3f}")
    save_figure(map_figure(sensor_map, score), arguments.output)
    print(f"wrote {arguments.output}")


if __name__ == "__main__":
    main()
