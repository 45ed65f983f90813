"""Other senses: what a retina sees that moves over photographs, and what a cochlea hears."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, signal
from sklearn.datasets import load_sample_image

from anisomap.recording import Recording

PHOTOGRAPHS = ("china.jpg", "flower.jpg")
"""Sample images that scikit-learn ships."""

PIXELS_A_SIDE = 10
BANDS = 32

_APART = 3  # pixels of the photograph between those of the retina
_STEP = 6.0  # pixels that the eye moves from frame to frame, standard deviation

_RATE = 16_000  # samples a second
_FRAME = 320  # samples between frames: 20 ms
_WINDOW = 512
_LOWEST, _HIGHEST = 100.0, 7000.0  # Hz
_SOUND = 0.25  # seconds, mean
_AT_ONCE = 4
_FLOOR = 1e-6  # of the greatest energy


def retina(n_frames: int, seed: int) -> Recording:
    """Let a square of pixels wander over photographs.

    Parameters
    ----------
    n_frames : int
    seed : int
        Of the way that it wanders.

    Returns
    -------
    Recording
        Brightness of 10 x 10 pixels, 3 pixels of the photograph apart, blurred to that; as many
        frames from one photograph as from the other. Positions in pixels.
    """
    rng = np.random.default_rng(seed)
    side = _APART * np.arange(PIXELS_A_SIDE)
    rows, columns = (grid.ravel() for grid in np.meshgrid(side, side, indexing="ij"))
    seen = []
    for name, share in zip(PHOTOGRAPHS, np.array_split(np.arange(n_frames), 2), strict=True):
        grey = load_sample_image(name).mean(axis=2)
        image = ndimage.gaussian_filter(grey, _APART / 2)
        room = np.array(image.shape) - side[-1] - 1
        walk = np.cumsum(rng.normal(0, _STEP, (len(share), 2)), axis=0) + rng.uniform(0, room)
        corner = np.abs((walk + room) % (2 * room) - room).astype(int)  # turned back at the edges
        seen.append(image[corner[:, :1] + rows, corner[:, 1:] + columns])
    return Recording(
        np.vstack(seen),
        positions=np.column_stack([columns, -rows]),
        units="pixels",
        source=f"pixels wandering over {' and '.join(PHOTOGRAPHS)}, seed {seed}",
    )


def cochlea(n_frames: int, seed: int) -> Recording:
    """Let a bank of filters hear sounds that are made here.

    Parameters
    ----------
    n_frames : int
        Of 20 ms each.
    seed : int
        Of the sounds.

    Returns
    -------
    Recording
        Logarithm of the energy in 32 bands, evenly spaced on the ERB-number scale (Glasberg &
        Moore 1990, Hearing Research 47: 103-138, doi:10.1016/0378-5955(90)90170-T); positions are
        that number, on a line.
    """
    rng = np.random.default_rng(seed)
    n_samples = n_frames * _FRAME + _WINDOW
    sound = np.sum([sounds(n_samples, rng) for _ in range(_AT_ONCE)], axis=0)
    frequencies, _, spectra = signal.stft(
        sound, _RATE, nperseg=_WINDOW, noverlap=_WINDOW - _FRAME, boundary=None, padded=False
    )
    energy = _bands(frequencies) @ np.abs(spectra[:, :n_frames]) ** 2
    readings = np.log10(energy + _FLOOR * energy.max()).T
    places = _places()
    return Recording(
        readings,
        positions=np.column_stack([places, np.zeros(BANDS)]),
        units="ERB",
        rate_hz=_RATE / _FRAME,
        source=f"{BANDS} bands of synthesised sounds, seed {seed}",
    )


def sounds(n_samples: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Make voice-like sounds, one after the other: half have a pitch, half are noise.

    Each lasts about a quarter of a second, and is shaped by three resonances at random
    frequencies; all swell and fade.
    """
    parts: list[NDArray[np.float64]] = []
    while sum(map(len, parts)) < n_samples:
        length = int(_RATE * rng.uniform(0.4, 1.6) * _SOUND)
        parts.append(rng.lognormal(0, 0.7) * _sound(length, rng))
    return np.concatenate(parts)[:n_samples]


def erb_number(frequency: float) -> float:
    """Give the place of a frequency (Hz) on the ERB-number scale."""
    return 21.4 * math.log10(1 + 0.00437 * frequency)


def _places() -> NDArray[np.float64]:
    return np.linspace(erb_number(_LOWEST), erb_number(_HIGHEST), BANDS)


def _sound(length: int, rng: np.random.Generator) -> NDArray[np.float64]:
    source = rng.standard_normal(length)
    if rng.random() < 0.5:
        pitch = (
            80 * 5 ** rng.random() * (1 + 0.1 * np.sin(np.linspace(0, rng.uniform(0, 6), length)))
        )
        phase = np.cumsum(pitch / _RATE)
        source = 4.0 * (np.diff(np.floor(phase), prepend=0) > 0) + 0.05 * source
    for _ in range(3):
        centre = _LOWEST * (_HIGHEST / _LOWEST) ** rng.random()
        radius = np.exp(-np.pi * rng.uniform(0.1, 0.3) * centre / _RATE)
        poles = [1, -2 * radius * np.cos(2 * np.pi * centre / _RATE), radius**2]
        source = source + 2 * signal.lfilter([1 - radius], poles, source)
    return np.asarray(source * np.hanning(length) / np.sqrt(np.mean(source**2)))


def _bands(frequencies: NDArray[np.float64]) -> NDArray[np.float64]:
    """Power that each band lets through, shape (bands, frequencies): gammatone filters."""
    centres = (10 ** (_places() / 21.4) - 1) / 0.00437
    widths = 1.019 * 24.7 * (1 + 0.00437 * centres)
    away = (frequencies - centres[:, None]) / widths[:, None]
    return np.asarray((1 + away**2) ** -4.0)
