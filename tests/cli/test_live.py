"""Arguments of ``anisomap live`` that cannot work are refused before anything is written."""

import socket

import pytest


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "give either a source or --simulate BODY"),
        (["skin.csv", "--simulate", "hand"], "give either a source or --simulate BODY"),
        (["missing.csv"], "there is no file missing.csv, and it is no address"),
        (["tcp://127.0.0.1"], "needs a port"),
        (["udp://127.0.0.1:99999"], "is not an address"),
        (["--simulate", "nobody"], "there is no body"),
        (["skin.csv", "--recording", "old.csv"], "old.csv exists"),
        (["skin.csv", "--recording", "r.npz"], "must end in .csv"),
        (["skin.csv", "--recording", "skin.csv"], "skin.csv"),
        (["skin.csv", "--recording", "r.csv", "-o", "r.csv"], "r.csv"),
        (["skin.csv", "-o", "m.urdf"], "metres"),
        (["skin.csv", "--preset", "nobody"], "unknown preset 'nobody'; known presets: icub"),
        (["skin.csv", "-m", "magic"], "there is no method"),
        (["skin.csv", "--coached", "--headless"], "--coached is for a simulated hand"),
    ],
)
def test_arguments_that_cannot_work(run, skin_csv, tmp_path, arguments, message):
    (tmp_path / "old.csv").write_text("mine")
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    done = run("live", *arguments)
    assert done.code == 2
    assert message in done.err
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_a_port_in_use_is_an_error(run):
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        done = run("live", f"tcp-listen://127.0.0.1:{port}", "--headless")
    assert done.code == 2
    assert f"cannot listen on 127.0.0.1:{port}" in done.err


def test_a_port_of_the_page_in_use_is_an_error_before_anything_is_recorded(run, skin_csv, tmp_path):
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        done = run("live", skin_csv, "--port", port, "--no-browser", "--recording", "r.csv")
    assert done.code == 2
    assert f"cannot show the page on 127.0.0.1:{port}" in done.err
    assert not (tmp_path / "r.csv").exists()
