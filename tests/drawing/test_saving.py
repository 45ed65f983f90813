"""Files of pictures, animations and reports: refused names, and old files that are kept."""

import numpy as np
import pytest
from matplotlib.artist import Artist
from PIL import Image

from anisomap.drawing import figures, report
from anisomap.drawing.figures import scenes
from anisomap.errors import FileError, InputError
from reports import example, small_scene

MAP, _ = example(None)
FIGURE = figures.map_figure(MAP)
KINDS = {
    "picture": (
        figures.check_writable,
        lambda path: figures.save_figure(FIGURE, path),
        ("map.png", "map.SVG", "map.pdf"),
        ("map.jpg", "map", "png"),
    ),
    "report": (
        report.check_writable,
        lambda path: report.write_report(path, MAP),
        ("map.html", "map.HTM"),
        ("map.pdf", "map", "html"),
    ),
    "animation": (
        scenes.check_animation,
        lambda path: scenes.save_animation(small_scene(), path),
        ("run.gif", "run.GIF"),
        ("run.webm", "run", "gif"),
    ),
}


@pytest.mark.parametrize("kind", KINDS)
def test_files_that_cannot_be_written_are_rejected(tmp_path, kind):
    check, write, good, bad = KINDS[kind]
    for try_it in (check, write):
        for name in bad:
            with pytest.raises(FileError, match=r"must end in \..*\b(pdf|htm|mp4)$"):
                try_it(tmp_path / name)
        with pytest.raises(FileError, match="does not exist"):
            try_it(tmp_path / "nowhere" / good[0])
    with pytest.raises(FileError, match="it is a folder"):
        check(tmp_path)
    for name in good:
        check(tmp_path / name)
    assert not list(tmp_path.iterdir()), "the check writes nothing"


class Undrawable(Artist):
    def draw(self, renderer):
        raise MemoryError


def undrawable():
    figure = figures.map_figure(MAP)
    figure.add_artist(Undrawable())
    return figure


def interrupt(share):
    if share > 0.5:
        raise KeyboardInterrupt


@pytest.mark.parametrize(
    ("name", "write", "error"),
    [
        ("map.png", lambda path: figures.save_figure(undrawable(), path), MemoryError),
        ("map.html", lambda path: report.write_report(path, MAP, figure_png="text"), TypeError),
        (
            "run.gif",
            lambda path: scenes.save_animation(small_scene(), path, progress=interrupt),
            KeyboardInterrupt,
        ),
    ],
)
def test_a_failure_keeps_the_old_file(tmp_path, name, write, error):
    path = tmp_path / name
    path.write_bytes(b"old")
    with pytest.raises(error):
        write(path)
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_unknown_formats_are_rejected():
    with pytest.raises(InputError, match="gif"):
        figures.figure_bytes(FIGURE, "gif")


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
