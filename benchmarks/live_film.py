"""Pictures of a session: ``python -m benchmarks.live_film -o film -- --simulate hand --coached``.

A session runs with a headless Chromium as its viewer. Screenshots are taken at the beginning, in
the middle and at the end, each in two sizes, and a film (WebP) of all of it. Arguments after ``--``
are those of ``anisomap live``. The command fails if the page reports an error of a script.
"""

from __future__ import annotations

import argparse
import io
import json
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.browser import Page, browser, find_chromium

SIZES = ((1280, 800), (390, 844))
MOMENTS = ("beginning", "middle", "end")
_FILM_SIZE = (720, 450)
_QUALITY = 40  # of 100
_FRAME_MS = 250


def main(arguments: Sequence[str] | None = None) -> None:
    """Run a session and write its pictures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, default=Path("film"))
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--images", type=int, default=40, help="of the film")
    parser.add_argument("session", nargs="+", help="arguments of anisomap live")
    given = parser.parse_args(arguments)
    path = find_chromium()
    if path is None:
        sys.exit("there is no Chromium")
    given.output.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder, browser(path) as page:
        command = [sys.executable, "-m", "anisomap", "live", *given.session]
        command += ["--port", "0", "--no-browser", "--json"]
        command += ["--recording", "skin.csv"]
        process = subprocess.Popen(  # noqa: S603
            command, cwd=folder, stdout=subprocess.PIPE, text=True
        )
        if process.stdout is None:
            raise RuntimeError("the session has no output")
        try:
            page.open(json.loads(process.stdout.readline())["url"])
            images = film(page, given.output, given.seconds, given.images)
        finally:
            process.send_signal(signal.SIGINT)
            process.communicate()
        errors = page.errors
    save(images, given.output / "live.webp")
    print(f"{len(images)} images, {len(errors)} errors of the page")
    if errors:
        sys.exit("\n".join(errors))


def film(page: Page, folder: Path, seconds: float, count: int) -> list[Any]:
    """Take screenshots at three moments, and images of a film in equal steps."""
    from PIL import Image  # noqa: PLC0415 (an extra)

    page.resize(*SIZES[0])
    page.wait_for("document.getElementById('which').textContent.startsWith('quick map')")
    images = []
    moments = {0: 0, count // 2: 1, count - 1: 2}
    for number in range(count):
        begun = time.monotonic()
        image = Image.open(io.BytesIO(page.screenshot())).convert("RGB")
        images.append(image.resize(_FILM_SIZE, Image.Resampling.LANCZOS))
        if number in moments:
            for width, height in SIZES:
                page.resize(width, height)
                time.sleep(0.5)
                page.screenshot(folder / f"{MOMENTS[moments[number]]}-{width}x{height}.png")
            page.resize(*SIZES[0])
            time.sleep(0.5)
        time.sleep(max(0.0, seconds / count - (time.monotonic() - begun)))
    return images


def save(images: Sequence[Any], path: Path) -> None:
    """Write images as a film that repeats."""
    images[0].save(
        path, save_all=True, append_images=images[1:], duration=_FRAME_MS, loop=0, quality=_QUALITY
    )


if __name__ == "__main__":
    main()
