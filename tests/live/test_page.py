"""The page: what it sends and does, and whom it refuses."""

import base64
import http.client
import json
from types import SimpleNamespace
from urllib.parse import urlsplit

import numpy as np
import pytest

import anisomap
from anisomap.live import ExaminationOptions, LiveSession
from anisomap.live.batches import Batch, Names, Notice
from anisomap.live.page import save_page
from anisomap.live.page.server import Server
from anisomap.map_verdict import LEVELS, UNKNOWN
from live_processes import LONGEST_S, Given, wait_for_maps
from skins import flat_skin

NAME = "<img src=x onerror=alert(1)>"


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    skin = flat_skin(n_frames=800)
    names = (NAME, *skin.names[1:])
    source = Given([Names(names), Notice("hello \x1b[2J"), Batch(skin.readings.astype(float))])
    folder = tmp_path_factory.mktemp("live")
    options = ExaminationOptions(method="r-anisomap")
    with (
        LiveSession(source, folder / "r.csv", options) as session,
        Server(session, port=0) as server,
    ):
        # Maps are in 3D until a checked map shows that the skin is flat.
        wait_for_maps(session, lambda maps: maps.quick and maps.quick.positions.shape[1] == 2)
        yield SimpleNamespace(session=session, server=server, folder=folder, skin=skin)


def ask(server, path, method="GET", body=None, **headers):
    connection = http.client.HTTPConnection("127.0.0.1", server.port, timeout=LONGEST_S)
    headers = {name.replace("_", "-"): value for name, value in headers.items()}
    connection.request(method, path, body, headers)
    answer = connection.getresponse()
    content = answer.read()
    connection.close()
    return answer, content


def act(server, do, **request):
    body = json.dumps({"do": do, **request})
    answer, content = ask(server, "/act", "POST", body, X_Anisomap="1")
    assert answer.status == 200
    return json.loads(content)


def events(server, count):
    connection = http.client.HTTPConnection("127.0.0.1", server.port, timeout=LONGEST_S)
    connection.request("GET", "/events")
    answer = connection.getresponse()
    found = []
    while len(found) < count:
        kind, data = answer.readline().decode(), answer.readline().decode()
        assert answer.readline() == b"\n"
        found.append(
            (kind.removeprefix("event: ").strip(), json.loads(data.removeprefix("data: ")))
        )
    connection.close()
    return found


@pytest.mark.parametrize("path", ["/", "/live.js", "/live.css", "/map_view.js", "/charts.js"])
def test_the_page_loads_nothing_from_elsewhere(page, path):
    answer, content = ask(page.server, path)
    assert answer.status == 200
    policy = answer.getheader("Content-Security-Policy")
    assert "default-src 'none'" in policy
    assert "script-src 'self'" in policy
    assert "unsafe" not in policy
    assert not any(word in content for word in (b"http://", b"https://", b"innerHTML"))


def test_events_hold_the_map_the_readings_and_the_status(page):
    found = dict(events(page.server, 6))
    assert set(found) == {"map", "readings", "status"}
    made, status = found["map"], found["status"]
    assert made["names"][0] == NAME
    assert made["dimensions"] == made["checked_dimensions"] == 2
    assert any("flat: maps have 2 dimensions" in text for _, text in status["notices"])
    assert len(made["contacts"]) == 42
    assert status["frames"] == 800
    assert status["level"] in (*LEVELS, UNKNOWN)
    assert status["notices"][0][1] == r"hello \x1b[2J"
    assert status["recording"] == str(page.folder / "r.csv")
    # Both maps are of the same method and frames; the checked one is turned onto the quick one.
    quick, checked = (
        np.frombuffer(base64.b64decode(made[key]), "<f4").reshape(42, 2)
        for key in ("positions", "checked")
    )
    np.testing.assert_allclose(checked, quick, atol=1e-3)  # of an RMS radius of 1


def test_buttons(page):
    server, session = page.server, page.session
    session.recorder.arrived_at -= 5
    for on, state in ((True, "paused"), (False, "running")):
        assert act(server, "pause", on=on)["ok"]
        assert session.state == state
    session.recorder.put(Batch(np.ones((1, 42))))
    assert not any("no frame for" in note.text for note in session.notices)
    assert act(server, "drop", sensors=["s3"])["text"] == "left out: s3"
    assert session.maps.options.drop == ("s3",)
    assert not act(server, "drop", sensors=["nobody"])["ok"]
    assert act(server, "drop", sensors=[])["ok"]
    saved = act(server, "save")
    assert saved["ok"], saved
    assert [file["name"] for file in saved["files"]] == ["r.map.csv", "r.report.html"]
    assert anisomap.read_map(page.folder / "r.map.csv").n_sensors == 42
    assert NAME not in (page.folder / "r.report.html").read_text()
    _, content = ask(server, saved["files"][0]["url"])
    assert content == (page.folder / "r.map.csv").read_bytes()
    assert not act(server, "anything")["ok"]


def test_the_page_at_the_end_is_one_file_with_the_map_and_links(page):
    path = save_page(page.session, page.folder / "end.html", [page.folder / "r #1%.csv"])
    text = path.read_text()
    assert not any(
        word in text
        for word in ("http://", "https://", "innerHTML", '<link rel="style', "<script src")
    )
    assert NAME not in text
    shown = json.loads(text.partition('type="application/json">')[2].partition("</script>")[0])
    assert shown["map"]["names"][0] == NAME
    assert shown["status"]["frames"] == page.session.recorder.n_frames >= 800
    assert shown["files"] == [{"name": "r #1%.csv", "url": "r%20%231%25.csv"}]


@pytest.mark.parametrize(
    ("path", "method", "headers"),
    [
        ("/act", "POST", {}),
        ("/act", "POST", {"X_Anisomap": "1", "Origin": "http://elsewhere"}),
        ("/act", "POST", {"X_Anisomap": "1", "Host": "elsewhere"}),
        ("/files/r.csv", "GET", {}),
        ("/../../etc/passwd", "GET", {}),
        ("/", "GET", {"Host": "[::1].evil.com"}),
        ("/", "GET", {"Host": "localhost", "Origin": "null"}),
    ],
)
def test_others_are_refused(page, path, method, headers):
    body = json.dumps({"do": "end"}) if method == "POST" else None
    answer, content = ask(page.server, path, method, body, **headers)
    assert answer.status in (403, 404)
    assert b"Traceback" not in content
    assert not page.session.wanted_end.is_set()


@pytest.mark.parametrize("host", ["LOCALHOST:8765", "[::1]:8765"])
def test_the_page_answers_on_every_name_of_this_computer(page, host):
    assert ask(page.server, "/", Host=host, Origin=f"http://{host}")[0].status == 200


@pytest.mark.parametrize(
    ("body", "length"), [("[]", "2"), ("[" * 100_000, "100000"), (None, "8388609"), (None, "\xb2")]
)
def test_a_request_that_is_no_action_is_refused(page, body, length):
    headers = {"X-Anisomap": "1", "Content-Length": length}
    answer, content = ask(page.server, "/act", "POST", body, **headers)
    assert answer.status in (400, 413) or json.loads(content)["ok"] is False


def test_a_page_for_others_needs_the_token(page):
    with Server(page.session, "0.0.0.0", 0) as server:  # noqa: S104
        for path, headers in (("/", {}), ("/", {"Cookie": "token=wrong"}), ("/?token=wrong", {})):
            assert ask(server, path, **headers)[0].status == 403
        answer, _ = ask(server, f"/?{urlsplit(server.url).query}")
        assert answer.status == 303
        cookie = answer.getheader("Set-Cookie")
        assert "HttpOnly" in cookie
        assert "SameSite=Strict" in cookie
        assert ask(server, "/", Cookie=cookie.partition(";")[0])[0].status == 200
        assert len(server.token) >= 20
