"""Figures and animations of simulated scenes."""

import numpy as np
import pytest
from PIL import Image

from anisomap.drawing.figures import scenes
from anisomap.errors import FileError, InputError
from anisomap.simulation import BODIES, SCENARIOS, run_simulation
from anisomap.simulation.physics import mujoco_viewer
from reports import small_scene

pytest.importorskip("matplotlib", reason="needs the extra 'report'")


def test_the_figure_shows_the_busiest_frame_with_axes_in_units():
    figure = scenes.scene_figure(small_scene())
    space, body, raster = figure.axes[:3]
    assert space.get_title() == "Frame 4 of 6, 0.20 s"
    assert (space.get_xlabel(), space.get_zlabel()) == ("x (m)", "z (m)")
    assert (raster.get_xlabel(), raster.get_ylabel()) == ("time (s)", "sensor")
    assert "reading (m)" in {axes.get_ylabel() for axes in figure.axes}
    shape = np.array([np.ptp(getattr(body, f"get_{name}lim")()) for name in "xyz"])
    np.testing.assert_allclose(body._box_aspect / body._box_aspect.max(), shape / shape.max())
    for frame in (-1, 6):
        with pytest.raises(InputError, match=f"frame must be from 0 to 5, got {frame}"):
            scenes.scene_figure(small_scene(), frame)


@pytest.mark.parametrize("scenario", SCENARIOS)
@pytest.mark.filterwarnings("ignore::anisomap.AnisomapWarning")  # sensors that nothing touches
def test_every_scenario_can_be_drawn(scenario):
    pytest.importorskip("mujoco")
    body = next(name for name in BODIES if SCENARIOS[scenario].accepts(BODIES[name]()))
    scene = run_simulation(body, scenario, n_frames=10).scene
    assert scene.n_frames == 10
    assert scene.sensors.shape[1:] == (scene.readings.shape[1], 3)
    assert {prop.role for prop in scene.props} >= {"body"}
    space, *_ = scenes.scene_figure(scene, 9).axes
    assert any(len(drawn.get_facecolor()) > 10 for drawn in space.collections)


def test_an_animation_has_one_picture_per_frame(tmp_path):
    path, shares = tmp_path / "run.gif", []
    scenes.save_animation(small_scene(), path, n_frames=4, progress=shares.append)
    with Image.open(path) as moving:
        assert moving.n_frames == 4
    assert shares[-1] == 1
    assert [entry.name for entry in tmp_path.iterdir()] == ["run.gif"]


def test_rendered_images_are_saved_as_picture_or_animation(tmp_path):
    rng = np.random.default_rng(0)
    images = [rng.integers(0, 255, (40, 60, 3), dtype=np.uint8) for _ in range(3)]
    scenes.save_pixels(tmp_path / "one.png", images[:1])
    with Image.open(tmp_path / "one.png") as picture:
        np.testing.assert_array_equal(np.asarray(picture), images[0])
    scenes.save_pixels(tmp_path / "more.gif", images)
    with Image.open(tmp_path / "more.gif") as moving:
        assert moving.n_frames == 3
    with pytest.raises(FileError, match=r"must end in \.gif"):
        scenes.save_pixels(tmp_path / "more.png", images)


def test_mp4_without_ffmpeg_is_rejected(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(FileError, match=r"needs the program ffmpeg.*\.gif does not need it"):
        scenes.check_animation(tmp_path / "run.mp4")


def test_mujoco_renders_scenes():
    pytest.importorskip("mujoco")
    scene = run_simulation("hexagon", n_frames=3).scene
    try:
        images = mujoco_viewer.render(scene, [0, 2], width=120, height=90)
    except mujoco_viewer.NoScreenError as error:
        pytest.skip(str(error))
    assert [image.shape for image in images] == [(90, 120, 3)] * 2
    assert all(len(np.unique(image.reshape(-1, 3), axis=0)) > 20 for image in images)
    assert not np.array_equal(*images)
