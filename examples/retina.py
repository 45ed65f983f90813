"""Map a retina: a square of pixels that moves over photographs.

Run ``python examples/retina.py``; it writes ``retina.png``. Requires anisomap[report]. The paper's
methods are compared; the default method maps these recordings, too.
"""

import argparse
from pathlib import Path

import numpy as np
from scipy.ndimage import gaussian_filter
from sklearn.datasets import load_sample_image

import anisomap
from anisomap.drawing.figures import map_figure, save_figure

METHODS = ("r-anisomap", "i-anisomap", "information-distance", "isomap")
PHOTOGRAPHS = ("china.jpg", "flower.jpg")  # included in scikit-learn
PIXELS_PER_SIDE = 10
SPACING = 3  # pixels of the photograph between neighbouring pixels of the retina
STEP = 6.0  # standard deviation of the movement between frames, pixels of the photograph


def record_retina(n_frames: int, seed: int) -> anisomap.Recording:
    """Record the brightness of 10 x 10 pixels during a random walk over the photographs."""
    rng = np.random.default_rng(seed)
    side = SPACING * np.arange(PIXELS_PER_SIDE)
    rows, columns = (grid.ravel() for grid in np.meshgrid(side, side, indexing="ij"))
    readings = []
    for name, frames in zip(PHOTOGRAPHS, np.array_split(np.arange(n_frames), 2), strict=True):
        grey = load_sample_image(name).mean(axis=2)
        image = gaussian_filter(grey, SPACING / 2)
        room = np.array(image.shape) - side[-1] - 1
        walk = np.cumsum(rng.normal(0, STEP, (len(frames), 2)), axis=0) + rng.uniform(0, room)
        corner = np.abs((walk + room) % (2 * room) - room).astype(int)  # reflected at the edges
        readings.append(image[corner[:, :1] + rows, corner[:, 1:] + columns])
    return anisomap.Recording(
        np.vstack(readings),
        positions=np.column_stack([columns, -rows]),
        units="pixels",
        source=f"retina moving over {' and '.join(PHOTOGRAPHS)}, seed {seed}",
    )


def main() -> None:
    """Map the retina by several methods, and draw the map of the last one."""
    parser = argparse.ArgumentParser(description="Map a retina that moves over photographs.")
    parser.add_argument("--frames", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--output", type=Path, default=Path("retina.png"))
    arguments = parser.parse_args()

    recording = record_retina(arguments.frames, arguments.seed)
    for method in METHODS:
        sensor_map = anisomap.reconstruct(recording, method, dimensions=2)
        score = anisomap.score(sensor_map, recording.positions, units=recording.units)
        print(f"{method:<20} Mantel r {score.mantel.r:.3f}")
    save_figure(map_figure(sensor_map, score), arguments.output)
    print(f"wrote {arguments.output}")


if __name__ == "__main__":
    main()
