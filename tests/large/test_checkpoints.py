"""Interrupted runs resume to the same result, and checkpoints of other data are refused."""

import io
import os
import subprocess
import sys
import time
import zipfile
from contextlib import suppress

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from anisomap.errors import FileError
from anisomap.large.map_reduce import Checkpoint, map_reduce
from anisomap.large.streaming import stream_similarity
from anisomap.method.options import MethodOptions
from anisomap.numerics.similarity.correlation import Moments
from dying import PowerCutError, failing
from skins import flat_skin

READINGS = np.round(flat_skin(n_frames=600).readings[:, :12] * 20).astype(np.float32)
PARTS = np.split(READINGS, 6)
OPTIONS = MethodOptions()

KILLED = """
import sys, time
from pathlib import Path
import numpy as np
from anisomap.large.map_reduce import Checkpoint, map_reduce
from anisomap.numerics.similarity.correlation import Moments

folder = Path(sys.argv[1])
parts = np.split(np.load(folder / "readings.npy"), 60)
def slowly():
    for part in parts:
        time.sleep(0.02)
        yield part

map_reduce(slowly, Moments.of, checkpoint=Checkpoint(folder / "counts.npz", "moments"))
"""


def similarity(parts, file=None, method="i-anisomap", options=OPTIONS, **more):
    chunks = parts if callable(parts) else lambda: iter(parts)
    return stream_similarity(chunks, method, options, checkpoint=file, **more).similarity


def cut_off(file, parts=PARTS, n_chunks=4, passes=2, **more):
    with pytest.raises(PowerCutError):
        similarity(failing(parts, n_chunks, passes), file, **more)


def test_killed_processes_resume_to_the_same_result(tmp_path):
    np.save(tmp_path / "readings.npy", READINGS)
    file, rng = tmp_path / "counts.npz", np.random.default_rng(0)
    for _ in range(2):
        program = [sys.executable, "-c", KILLED, str(tmp_path)]
        with subprocess.Popen(program) as process:
            before = file.stat().st_mtime_ns if file.exists() else 0
            while process.poll() is None and (
                not file.exists() or file.stat().st_mtime_ns == before
            ):
                time.sleep(0.005)
            time.sleep(rng.uniform(0, 0.1))
            process.kill()
    parts, processed = np.split(READINGS, 60), []
    progress = Checkpoint(file, "moments")
    done = progress.stages["total"].n_chunks
    assert done >= 2, "every run added to what was done"

    def moments(chunk):
        processed.append(1)
        return Moments.of(chunk)

    found = map_reduce(lambda: iter(parts), moments, checkpoint=progress)
    assert len(processed) == 60 - done, "no chunk is processed twice"
    expected = map_reduce(lambda: iter(parts), Moments.of)
    np.testing.assert_array_equal(found.comoment, expected.comoment)


@pytest.mark.parametrize("passes", [1, 2])
@pytest.mark.parametrize("n_chunks", [1, 4])
def test_interrupted_runs_resume_to_the_same_result(tmp_path, passes, n_chunks):
    file = tmp_path / "counts.npz"
    cut_off(file, PARTS, n_chunks, passes)
    np.testing.assert_array_equal(similarity(PARTS, file), similarity(PARTS))
    np.testing.assert_array_equal(similarity(PARTS, file), similarity(PARTS))


def changed(part, frame, sensor):
    other = part.copy()
    other[frame, sensor] += 1
    return other


OTHERS = {
    "one reading of the first frames": [changed(PARTS[0], 7, 3), *PARTS[1:]],
    "one reading of what was done last": [*PARTS[:3], changed(PARTS[3], 9, 0), *PARTS[4:]],
    "frames in another order": [part[::-1] for part in PARTS],
    "other chunks": np.split(READINGS, 5),
    "fewer frames": PARTS[:2],
    "more frames than when values were counted": [*PARTS, PARTS[0]],
    "values of late frames": [*PARTS[:5], changed(PARTS[5], 9, 0)],
}


@pytest.mark.parametrize("other", OTHERS)
def test_other_readings_are_refused(tmp_path, other):
    file = tmp_path / "counts.npz"
    cut_off(file)
    with pytest.raises(FileError, match="another computation"):
        similarity(OTHERS[other], file)


@pytest.mark.parametrize(
    "other",
    [
        {"method": "r-anisomap"},
        {"method": "spearman-anisomap"},
        {"options": MethodOptions(entropy_bins=5)},
        {"source": "another.npz"},
        {"missing": "drop-frames"},
    ],
)
def test_other_options_are_refused(tmp_path, other):
    file, holed = tmp_path / "counts.npz", [part.copy() for part in PARTS]
    holed[0][10:20, 4] = np.nan
    cut_off(file, holed, missing="interpolate")
    with pytest.raises(FileError, match="another computation"):
        similarity(holed, file, **{"missing": "interpolate", **other})


SMALL = [part[:, :3] for part in np.split(READINGS[:60], 4)]


@pytest.fixture(scope="module")
def held(tmp_path_factory):
    """Return a checkpoint of half of the frames, as bytes, and the result of all."""
    file = tmp_path_factory.mktemp("whole") / "counts.npz"
    cut_off(file, SMALL, 2)
    return file.read_bytes(), similarity(SMALL)


@given(data=st.data())
@settings(max_examples=30, deadline=None)
def test_damaged_files_are_refused_unless_the_damage_is_harmless(held, tmp_path_factory, data):
    content, expected = held
    damaged = bytearray(content)
    at = data.draw(st.integers(0, len(content) - 1))
    if data.draw(st.booleans()):
        del damaged[at:]
    else:
        for place in [at, *data.draw(st.lists(st.integers(0, len(content) - 1), max_size=5))]:
            damaged[place] = data.draw(st.integers(0, 255))
    file = tmp_path_factory.mktemp("damaged") / "counts.npz"
    file.write_bytes(damaged)
    with suppress(FileError):
        np.testing.assert_array_equal(similarity(SMALL, file), expected)


def rewritten(content, **changes):
    """Return the archive with other arrays."""
    with np.load(io.BytesIO(content)) as archive:
        arrays = {k: v for k, v in (dict(archive) | changes).items() if v is not None}
    stream = io.BytesIO()
    np.savez(stream, **arrays)
    return stream.getvalue()


def object_array(_):
    """Return an archive of a pickle, which must never be loaded."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive, archive.open("subject.npy", "w") as member:
        np.lib.format.write_array(member, np.array([print], dtype=object), allow_pickle=True)
    return stream.getvalue()


def compressed(content):
    """Return an archive that may expand to any size, which checkpoints may not."""
    stream = io.BytesIO()
    with np.load(io.BytesIO(content)) as archive:
        np.savez_compressed(stream, **archive)
    return stream.getvalue()


@pytest.mark.parametrize(
    "damage",
    [
        lambda _: b"",
        lambda content: content[:-200],
        lambda _: b"no archive at all",
        lambda _: b"PK\5\6" + bytes(18),
        object_array,
        compressed,
        lambda content: rewritten(content, **{"pairs/chunks": None}),
        lambda content: rewritten(content, **{"pairs/kind": np.array("Checkpoint")}),
        lambda content: rewritten(content, **{"pairs/counts": np.array(["a"])}),
        lambda content: rewritten(content, **{"values/counts sizes": np.array([1])}),
        lambda content: rewritten(content, **{"values/counts": None}),
    ],
)
def test_other_files_are_refused(tmp_path, held, damage):
    file, content = tmp_path / "counts.npz", damage(held[0])
    file.write_bytes(content)
    with pytest.raises(FileError, match="damaged or not a checkpoint"):
        similarity(SMALL, file)
    assert file.read_bytes() == content


def test_pipes_are_refused(tmp_path):
    if not hasattr(os, "mkfifo"):
        pytest.skip("named pipes need POSIX")
    os.mkfifo(tmp_path / "counts.npz")
    with pytest.raises(FileError, match="not a regular file"):
        similarity(PARTS, tmp_path / "counts.npz")
