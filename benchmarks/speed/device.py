"""Times of the stages of exact maps on a GPU, of the second of two runs, and on the processor.

``python -m benchmarks.speed.device -o FOLDER`` prints the table of
``docs/development/device-table.md`` and writes it to the folder. ``--library numpy`` tries the
benchmark without a GPU.
"""

from __future__ import annotations

import importlib
import time
from collections.abc import Callable, Iterator
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from anisomap import score
from anisomap.large import device, reconstruct_on_device
from anisomap.numerics.graph.dissimilarity import regularised_reciprocal
from anisomap.numerics.graph.metric import metricise
from anisomap.numerics.precision import MIN_FLOAT32_SENSORS
from anisomap.numerics.scaling.multidimensional_scaling import Scaling, SmacofOptions, smacof
from anisomap.numerics.similarity.binning import DEFAULT_BINS
from anisomap.numerics.similarity.correlation import pearson, spearman
from anisomap.numerics.similarity.information import mutual_information
from benchmarks.harness import machine, markdown_table, options, quietly
from benchmarks.skins.inputs import directions, sphere_radius

_REACH = 4.0  # radius of a contact in sensor spacings; it covers 50 sensors
_STROKE = 15  # frames of a straight motion of a contact

Result = TypeVar("Result")


def main() -> None:
    """Measure and print."""
    parser = options(__doc__, "device", recordings=False)
    parser.add_argument("--library", default="cupy")
    parser.add_argument("--sizes", type=int, nargs="+", default=[1000, 5000, 20000])
    parser.add_argument("--frames", type=int, default=4000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--largest", type=int, default=5000, help="size that the processor maps")
    chosen = parser.parse_args()
    library = importlib.import_module(chosen.library)
    chosen.output.mkdir(parents=True, exist_ok=True)
    with quietly():
        for size in (
            device.MIN_DEVICE_POINTS,
            MIN_FLOAT32_SENSORS,
        ):  # compile kernels of both precisions
            list(_table(library, size, 500, chosen.seed, beside=True))
        rows = [
            row
            for n_sensors in chosen.sizes
            for row in _table(
                library, n_sensors, chosen.frames, chosen.seed, beside=n_sensors <= chosen.largest
            )
        ]
    header = ("sensors", "stage", "GPU, s", "processor, s", "ratio", "largest difference")
    text = [
        machine(f"{_device_name(library)}, {chosen.frames:,} frames of 8 bits, a sphere"),
        "",
        *markdown_table(header, rows, ("stage",)),
    ]
    path = chosen.output / "device-table.md"
    path.write_text("\n".join(text) + "\n", encoding="utf-8")
    print(path.read_text(encoding="utf-8"))


def _device_name(library: Any) -> str:
    if not hasattr(library, "cuda"):
        return "no GPU"
    name = library.cuda.runtime.getDeviceProperties(0)["name"].decode()
    return f"{name} with {library.__name__} {library.__version__}"


def _table(
    library: Any, n_sensors: int, n_frames: int, seed: int, *, beside: bool
) -> Iterator[tuple[object, ...]]:
    """Time the stages for one size, on the GPU and, if wanted, on the processor."""
    rng = np.random.default_rng(seed)
    sensors = sphere_radius(n_sensors) * directions(n_sensors, rng)
    readings = _touched(sensors, n_frames, rng)
    varying = np.ptp(readings, axis=0) > 0
    sensors, readings = sensors[varying], readings[:, varying]

    def row(
        stage: str, seconds: float, usual: Callable[[], Any] | None = None, found: Any = None
    ) -> tuple[object, ...]:
        print(f"{n_sensors} sensors, {stage}: {seconds:.3f} s", flush=True)
        if usual is None or not beside:
            return n_sensors, stage, f"{seconds:.3f}", "", "", ""
        expected, slow = _timed(usual)
        apart = _difference(found, expected)
        return n_sensors, stage, f"{seconds:.3f}", f"{slow:.3f}", f"{slow / seconds:.1f}", apart

    moved, seconds = _warm(lambda: library.asarray(readings))
    yield row("copy of the readings", seconds)
    found, seconds = _warm(lambda: device.spearman(moved))
    yield row("Spearman", seconds, lambda: spearman(readings), found)
    found, seconds = _warm(lambda: device.mutual_information(moved, DEFAULT_BINS))
    yield row("mutual information", seconds, lambda: mutual_information(readings), found)
    found, seconds = _warm(lambda: device.pearson(moved))
    yield row("Pearson", seconds, lambda: pearson(readings), found)
    lengths = device.regularised_reciprocal(found, 1.0)
    metric, seconds = _warm(lambda: device.metricise(lengths))
    if beside:
        usual_lengths = regularised_reciprocal(device.to_numpy(device.pearson(moved)))
        distances = device.to_numpy(metric)
    yield row("shortest paths", seconds, lambda: metricise(usual_lengths), metric)
    scaled, seconds = _warm(lambda: device.scale(metric, 3, SmacofOptions()))
    stage = "scaling (difference of Stress-1)" if beside else "scaling"
    yield row(stage, seconds, lambda: smacof(distances, dimensions=3), scaled)
    made, seconds = _warm(lambda: reconstruct_on_device(library.asarray(readings), dimensions=3))
    r = score(made, sensors, permutations=99, rng=0).mantel.r
    yield row(f"whole map by r-anisomap, r {r:.4f}", seconds)


def _touched(
    sensors: NDArray[np.float64], n_frames: int, rng: np.random.Generator
) -> NDArray[np.uint8]:
    """Read a sphere of sensors that one contact rubs in strokes."""
    radius, stroke = np.linalg.norm(sensors[0]), np.arange(n_frames) // _STROKE
    places = radius * directions(stroke[-1] + 1, rng)[stroke]
    headings = directions(stroke[-1] + 1, rng)[stroke]
    places = places + headings * (np.arange(n_frames) % _STROKE)[:, None]
    places *= radius / np.linalg.norm(places, axis=1, keepdims=True)
    apart = KDTree(places).sparse_distance_matrix(KDTree(sensors), _REACH, output_type="coo_matrix")
    readings = np.zeros((n_frames, len(sensors)), np.uint8)
    readings[apart.row, apart.col] = 255 * (1 - apart.data / _REACH)
    return readings


def _difference(found: Any, expected: Any) -> str:
    """Return the largest difference of matrices, relative to the largest value, or of Stress-1."""
    if isinstance(found, Scaling):
        return f"{abs(found.stress - expected.stress):.1e}"
    apart = np.abs(device.to_numpy(found) - expected).max() / np.abs(expected).max()
    return f"{float(apart):.1e}"


def _warm(run: Callable[[], Result]) -> tuple[Result, float]:
    """Time the second of two runs: the first compiles kernels and allocates memory."""
    run()
    return _timed(run)


def _timed(run: Callable[[], Result]) -> tuple[Result, float]:
    """Return the result of a function, and the seconds until it is in memory."""
    begin = time.perf_counter()
    found = run()
    if hasattr(found, "ndim"):
        device.to_numpy(cast("Any", found)[:1, :1])  # waits until the device has finished
    return found, time.perf_counter() - begin


if __name__ == "__main__":
    main()
