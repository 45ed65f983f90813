"""``anisomap map``: from a recording to a map."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter
from cyclopts.validators import Number

from anisomap.cli import parameters as options
from anisomap.cli import pipeline, streams
from anisomap.evaluation import PERMUTATIONS
from anisomap.methods import DEFAULT_METHOD, MethodOptions
from anisomap.numerics.scaling.stress_minimisation import SmacofOptions
from anisomap.numerics.similarity.binning import DEFAULT_BINS


def map_recording(
    recordings: Annotated[
        list[Path], Parameter(help="File of a recording, or several of the same skin.")
    ],
    /,
    *,
    output: Annotated[
        list[Path] | None, Parameter(alias="-o", group=options.outputs_group, negative=())
    ] = None,
    picture: Annotated[Path | None, Parameter(group=options.outputs_group)] = None,
    report: Annotated[Path | None, Parameter(group=options.outputs_group)] = None,
    method: Annotated[
        str | None,
        Parameter(alias="-m", group=options.method_group, show_default=DEFAULT_METHOD),
    ] = None,
    dimensions: Annotated[
        int, Parameter(alias="-d", group=options.method_group, validator=Number(gte=1))
    ] = 3,
    drop: options.Drop = None,
    missing: options.Missing = "error",
    mu: Annotated[float, Parameter(group=options.method_group)] = MethodOptions.mu,
    bins: Annotated[int, Parameter(group=options.method_group)] = DEFAULT_BINS,
    n_neighbours: Annotated[int | None, Parameter(group=options.method_group)] = None,
    even_spacing: Annotated[bool, Parameter(group=options.method_group, negative=())] = False,
    tolerance: Annotated[float, Parameter(group=options.method_group)] = SmacofOptions.tolerance,
    max_iterations: Annotated[
        int, Parameter(group=options.method_group)
    ] = SmacofOptions.max_iterations,
    reading: options.Reading = options.AS_IT_COMES,
    confidence: Annotated[bool, Parameter(group=options.method_group)] = True,
    placing: options.Placing = options.AS_IT_IS,
    exclude: options.Exclude = None,
    permutations: options.Permutations = PERMUTATIONS,
    seed: options.Seed = 0,
    large: Annotated[
        streams.LargeOptions, Parameter(name="*", group=streams.large_group)
    ] = streams.AS_EVER,
) -> None:
    """Make a map from a recording, or one from several of the same skin.

    Sensors of several recordings are matched by name; some may be missing in some. Recordings too
    large for memory are gone through in blocks: then all must have all sensors.

    Parameters
    ----------
    output
        File to write the map to; its suffix chooses the format, and the option may be repeated.
        Without it, the map is written beside where you are, as NAME.map.csv.
    picture
        Draw the map: .png, .svg or .pdf.
    report
        Write all there is to know as one HTML file that works offline.
    method
        How to make the map: see `anisomap methods`.
    dimensions
        Of the space to map into: 2 for flat skins, 3 for bodies.
    mu
        Regularisation of ANISOMAP's reciprocal; 0 leaves unrelated pieces of skin apart.
    bins
        Bins a sensor for entropies.
    n_neighbours
        Neighbours per sensor in ISOMAP's graph; as few as connect everything unless given.
    even_spacing
        Declare that neighbouring sensors are evenly spaced; the map will say so.
    tolerance
        Stop scaling when an iteration lowers the stress by a smaller share.
    max_iterations
        Stop scaling after so many iterations.
    confidence
        Judge the map by maps of halves of the recording, which takes longer.
    """
    outputs = pipeline.Outputs(
        maps=tuple(output or [Path(f"{recordings[0].name.split('.')[0]}.map.csv")]),
        picture=picture,
        report=report,
    )
    outputs.check(*recordings)
    placing.check(outputs.maps)
    how = reading.checked()
    chosen = MethodOptions(
        mu=mu,
        bins=bins,
        n_neighbours=n_neighbours,
        even_spacing=even_spacing,
        smacof=SmacofOptions(tolerance, max_iterations),
    )
    by = large.method(method)
    found = None
    if large.asked_for or streams.too_large(recordings, how):
        examined, found = streams.examine(
            recordings,
            how,
            missing=missing,
            method=by,
            options=chosen,
            large=large,
            drop=drop,
            seed=seed,
        )
    else:
        examined = pipeline.examine_runs(pipeline.read_runs(recordings, how, missing))
    names = examined.recording.names
    pipeline.show_recording(examined)
    sensor_map = pipeline.make_map(
        examined,
        by,
        dimensions,
        options=chosen,
        drop=options.sensors(drop, names),
        with_confidence=confidence,
        gathered=found,
    )
    sensor_map = placing.applied(sensor_map)
    left_out = options.sensors(exclude, names)
    pipeline.finish(outputs, sensor_map, examined, permutations, seed, exclude=left_out)
