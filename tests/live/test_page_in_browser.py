"""The page in a browser: no error of a script, everything by the keyboard, at two sizes."""

import itertools
import time

import numpy as np
import pytest
from benchmarks.live.film import browser, find_chromium

from anisomap.live import ExaminationOptions, LiveSession
from anisomap.live.batches import Batch
from anisomap.live.page import save_page
from anisomap.live.page.server import Server
from live_processes import Given
from skins import flat_skin

CHROMIUM = find_chromium()
pytest.importorskip("websockets", reason="the browser is driven by websockets")
pytestmark = [pytest.mark.slow, pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium")]
SKIN = flat_skin(n_frames=8000)
EVIL = "<img src=x onerror=\"document.title='evil'\">"
SIZES = ((1280, 800), (390, 844))


class Rubbed(Given):
    """A skin that is rubbed at 100 Hz, without end."""

    description, names = EVIL, (EVIL, *SKIN.names[1:])

    def receive(self):
        time.sleep(0.01)
        return super().receive()


def element(name):
    return f"document.getElementById('{name}')"


def test_a_session_in_the_browser(tmp_path):
    """The first maps have 3 dimensions, those after a checked map of the flat skin 2."""
    options = ExaminationOptions(method="r-anisomap")
    rubbed = (Batch(row[None]) for row in itertools.cycle(SKIN.readings.astype(float)))
    with browser(CHROMIUM) as page:
        with (
            LiveSession(Rubbed(rubbed), tmp_path / "r.csv", options) as session,
            Server(session, port=0) as server,
        ):
            page.open(server.url)
            page.wait_for(f"{element('which')}.textContent.startsWith('quick map')")
            for width, height in SIZES:
                page.resize(width, height)
                page.wait_for(f"window.innerWidth === {width}")
                page.wait_for("document.documentElement.scrollWidth <= window.innerWidth")
                assert page.screenshot(tmp_path / f"{width}.png").startswith(b"\x89PNG")
            page.press("ArrowRight")
            page.wait_for(f"{element('selected')}.textContent.startsWith('selected: <img')")
            assert not page.evaluate(f"{element('trace')}.hidden")
            page.press("n")
            page.wait_for(f"{element('names')}.ariaPressed === 'true'")
            page.open(server.url)
            page.wait_for(f"{element('selected')}.textContent.startsWith('selected: <img')")
            page.wait_for(f"{element('names')}.ariaPressed === 'true'")
            page.press("d")
            page.wait_for(f"{element('dropped')}.textContent.includes('<img')")
            assert session.maps.options.drop == (EVIL,)
            page.press("p")
            page.wait_for("document.body.dataset.state === 'paused'")
            page.wait_for(f"{element('coach')}.textContent.startsWith('Paused')")
            before = session.recorder.n_frames
            page.press("p")
            page.wait_for(f"{element('state')}.textContent === 'running'")
            page.wait_for(f"+{element('frames')}.textContent > {before}")
            page.wait_for(f"{element('notices')}.textContent.includes('have 2 dimensions')")
            page.wait_for(f"!{element('show')}.disabled")
            page.press("m")
            page.wait_for(f"{element('which')}.textContent.startsWith('checked map')")
            page.press("s")
            page.wait_for(f"{element('files')}.children.length === 2")
            assert page.errors == []
            session.stop()
            written = save_page(session, tmp_path / "end.html", [tmp_path / "r.csv"])
            server.keep(written)
        page.wait_for(f"!{element('disconnected')}.hidden")
        # The page at the end needs no session, and survives a reload, also of the address.
        for url in (written.as_uri(), written.as_uri(), server.url):
            page.open(url)
            page.wait_for(f"{element('coach')}.textContent.startsWith('The session is over')")
            page.wait_for(f"{element('files')}.children.length === 1")
            assert not page.evaluate(f"{element('pause')}.offsetParent")
            assert page.evaluate("document.documentElement.scrollWidth <= window.innerWidth")
        assert all("CONNECTION" in error for error in page.errors)
    assert (tmp_path / "r.report.html").exists()
    assert (tmp_path / "r.csv").read_bytes().count(b"\n") > session.recorder.n_frames
    assert np.isfinite(session.map_age)
