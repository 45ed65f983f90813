"""Compare methods on a recording with known positions.

Run ``python examples/compare.py recording.npz``; without a file, a skin is simulated. Each line
states the Mantel r and the error of a map, in spacings of neighbouring sensors. All methods of
anisomap are compared with Isomap of scikit-learn on the correlations of the same sensors.
"""

import argparse
import warnings

import numpy as np
from sklearn.manifold import Isomap

import anisomap

MIN_TOUCHES = 5  # sensors that are touched in fewer frames ruin the maps of all others


def isomap_on_r(recording: anisomap.Recording, dimensions: int) -> anisomap.SensorMap:
    """Map sensors by Isomap on sqrt(2 (1 - r)), with 8 neighbours."""
    distances = np.sqrt(2 * np.maximum(0, 1 - np.corrcoef(recording.readings.T)))
    isomap = Isomap(n_neighbors=8, n_components=dimensions, metric="precomputed")
    return anisomap.SensorMap(isomap.fit_transform(distances), names=recording.names)


def main() -> None:
    """Map the recording by every method, and score the maps."""
    parser = argparse.ArgumentParser(description="Compare methods on a recording.")
    parser.add_argument("recording", nargs="?")
    parser.add_argument("--dimensions", type=int, default=2)
    given = parser.parse_args()
    whole = anisomap.simulate("plane", "rubbing", n_frames=1000, seed=1)
    if given.recording:
        whole = anisomap.read(given.recording)
    moved = np.count_nonzero(whole.readings != np.median(whole.readings, axis=0), axis=0)
    recording = whole.select(moved >= MIN_TOUCHES)
    warnings.simplefilter("ignore", anisomap.AnisomapWarning)
    maps = {m: anisomap.reconstruct(recording, m, given.dimensions) for m in anisomap.METHODS}
    maps["isomap-on-r"] = isomap_on_r(recording, given.dimensions)
    for name, sensor_map in maps.items():
        found = anisomap.score(sensor_map, recording, permutations=0)
        print(f"{name:<22} Mantel r {found.mantel.r:.3f}, error {found.rms_in_spacings:.2f}")


if __name__ == "__main__":
    main()
