"""Files of pictures and reports: refused names, and old files that are kept."""

import pytest
from matplotlib.artist import Artist

from anisomap.drawing import figures, report
from anisomap.errors import FileError, InputError
from reports import example

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
}


@pytest.mark.parametrize("kind", KINDS)
def test_files_that_cannot_be_written_are_rejected(tmp_path, kind):
    check, write, good, bad = KINDS[kind]
    for try_it in (check, write):
        for name in bad:
            with pytest.raises(FileError, match=r"must end in \..*\b(pdf|htm)$"):
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


@pytest.mark.parametrize(
    ("name", "write", "error"),
    [
        ("map.png", lambda path: figures.save_figure(undrawable(), path), MemoryError),
        ("map.html", lambda path: report.write_report(path, MAP, summary="text"), AttributeError),
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
