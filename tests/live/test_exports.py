"""Sessions written for viewers: the readings of a recording at the places of its map."""

import base64
import io
import json
from dataclasses import replace

import numpy as np
import pytest

import anisomap
from anisomap.errors import MissingExtraError
from anisomap.live.saving import MAX_RATE_HZ, SESSIONS, save_map, save_session
from skins import flat_skin

SKIN = flat_skin(n_frames=400)  # at 50 Hz
MAP = anisomap.SensorMap(SKIN.positions, names=SKIN.names, units="mm")


@pytest.fixture(scope="module")
def mcap(tmp_path_factory):
    """Return a reader of the session."""
    reader = pytest.importorskip("mcap.reader", reason="needs the extra 'mcap'")
    path = tmp_path_factory.mktemp("session") / "skin.mcap"
    save_session(MAP, SKIN, path)
    return reader.make_reader(io.BytesIO(path.read_bytes()))


def test_foxglove_shows_the_strongest_reading_of_each_interval_in_metres(mcap):
    found = {"/skin": [], "/names": []}
    for _, channel, message in mcap.iter_messages():
        found[channel.topic].append((message.log_time, json.loads(message.data)))
    assert found["/names"][0][1]["names"] == list(SKIN.names)
    times = np.array([time for time, _ in found["/skin"]]) / 1e9
    assert np.diff(times).min() == pytest.approx(1 / MAX_RATE_HZ)
    clouds = np.array(
        [
            np.frombuffer(base64.b64decode(cloud["data"]), "<f4").reshape(-1, 4)
            for _, cloud in found["/skin"]
        ]
    )
    np.testing.assert_allclose(clouds[0, :, :2] * 1000, MAP.positions, rtol=1e-5, atol=1e-5)
    pairs = SKIN.readings.reshape(-1, 2, SKIN.n_sensors).max(axis=1)
    np.testing.assert_allclose(clouds[..., 3], pairs / pairs.max(axis=0), atol=1e-5)


def described(schema):
    """Return the properties of a schema, as Foxglove reads them."""
    if schema["type"] == "object":
        return {key: described(item) for key, item in schema["properties"].items()}
    if schema["type"] == "array":
        return [described(schema["items"])]
    return schema.get("contentEncoding", schema["type"])


def test_schemas_describe_all_that_foxglove_reads(mcap):
    """The schema of point clouds is that of foxglove.dev, without descriptions and limits."""
    schemas = mcap.get_summary().schemas.values()
    found = {schema.name: described(json.loads(schema.data)) for schema in schemas}
    vector = dict.fromkeys("xyz", "number")
    assert found == {
        "foxglove.PointCloud": {
            "timestamp": {"sec": "integer", "nsec": "integer"},
            "frame_id": "string",
            "pose": {"position": vector, "orientation": vector | {"w": "number"}},
            "point_stride": "integer",
            "fields": [{"name": "string", "offset": "integer", "type": "integer"}],
            "data": "base64",
        },
        "anisomap.Names": {"names": ["string"]},
    }


def test_rerun_reads_the_session(tmp_path):
    pytest.importorskip("rerun", reason="needs the extra 'rerun'")
    save_session(replace(MAP, units="arbitrary"), SKIN, tmp_path / "skin.rrd")
    assert (tmp_path / "skin.rrd").read_bytes().startswith(b"RRF")


@pytest.mark.parametrize("suffix", SESSIONS)
def test_without_the_extra_no_file_is_left(tmp_path, monkeypatch, suffix):
    for module in ("mcap", "mcap.writer", "rerun"):
        monkeypatch.setitem(__import__("sys").modules, module, None)
    with pytest.raises(MissingExtraError, match=suffix[1:] if suffix == ".mcap" else "rerun"):
        save_session(MAP, SKIN, tmp_path / f"skin{suffix}")
    assert list(tmp_path.iterdir()) == []


def test_a_session_without_a_map_is_refused(tmp_path):
    with pytest.raises(anisomap.InputError, match="no checked map"):
        save_map(None, tmp_path / "x.mcap", recording=tmp_path / "skin.csv")
