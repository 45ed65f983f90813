"""Pictures of a session.

::

    python -m benchmarks.live.film -o film --seconds 90 -- --simulate sphere --coached

A session runs with a headless Chromium as its viewer. Screenshots are taken at the beginning, in
the middle and at the end, each in two sizes, and a film (WebP) of all of it. Arguments after ``--``
are those of ``anisomap live``. The command fails if the page reports an error of a script.
"""

from __future__ import annotations

import argparse
import base64
import io
import json
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.request import urlopen

SIZES = ((1280, 800), (390, 844))
MOMENTS = ("beginning", "middle", "end")
_FILM_SIZE = (720, 450)
_QUALITY = 40  # of 100
_FRAME_MS = 250
_BROWSERS = ("chromium", "chromium-browser", "google-chrome", "chrome")
_START_S = 60.0


def find_chromium() -> str | None:
    """Return the path of an installed Chromium, or None."""
    return next((path for name in _BROWSERS if (path := shutil.which(name))), None)


class Page:
    """A page in a headless browser, which its DevTools protocol drives.

    errors: Errors of scripts, of the content security policy, and of requests that failed.
    """

    def __init__(self, connection: Any) -> None:
        self.errors: list[str] = []
        self._connection, self._number = connection, 0
        for domain in ("Page", "Runtime", "Log"):
            self.send(f"{domain}.enable")

    def send(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Call a method of the protocol and return its result."""
        self._number += 1
        self._connection.send(
            json.dumps({"id": self._number, "method": method, "params": parameters})
        )
        while True:
            message = json.loads(self._connection.recv(timeout=_START_S))
            self._note(message)
            if message.get("id") == self._number:
                if "error" in message:
                    raise RuntimeError(f"{method}: {message['error']['message']}")
                found: dict[str, Any] = message["result"]
                return found

    def open(self, url: str) -> None:
        """Open an address."""
        self.send("Page.navigate", url=url)

    def evaluate(self, expression: str) -> Any:
        """Return the value of an expression."""
        found = self.send("Runtime.evaluate", expression=expression, returnByValue=True)
        return found["result"].get("value")

    def wait_for(self, expression: str, timeout_s: float = 120.0) -> None:
        """Wait until an expression is true."""
        end = time.monotonic() + timeout_s
        while not self.evaluate(expression):
            if time.monotonic() > end:
                raise TimeoutError(expression)
            time.sleep(0.1)

    def press(self, key: str) -> None:
        """Press and release a key."""
        for kind in ("keyDown", "keyUp"):
            self.send("Input.dispatchKeyEvent", type=kind, key=key)

    def resize(self, width: int, height: int) -> None:
        """Set the size of the page in pixels."""
        self.send(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=1,
            mobile=False,
        )

    def screenshot(self, path: Path | None = None, *, whole: bool = False) -> bytes:
        """Take a picture of the page as PNG."""
        found = self.send("Page.captureScreenshot", captureBeyondViewport=whole)
        content = base64.b64decode(found["data"])
        if path is not None:
            path.write_bytes(content)
        return content

    def _note(self, message: dict[str, Any]) -> None:
        method, parameters = message.get("method"), message.get("params", {})
        if method == "Runtime.exceptionThrown":
            self.errors.append(str(parameters["exceptionDetails"]))
        elif method == "Log.entryAdded" and parameters["entry"]["level"] == "error":
            self.errors.append(parameters["entry"]["text"])
        elif method == "Runtime.consoleAPICalled" and parameters["type"] in ("error", "assert"):
            self.errors.append(str(parameters["args"]))


@contextmanager
def browser(path: str) -> Iterator[Page]:
    """Start a browser at the path that `find_chromium` found, and end it with the block."""
    from websockets.sync.client import connect  # noqa: PLC0415 (an extra)

    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        process = subprocess.Popen(  # noqa: S603
            [
                path,
                "--headless=new",
                "--no-sandbox",
                "--disable-gpu",
                "--disable-dev-shm-usage",
                "--no-first-run",
                "--disable-background-networking",
                "--remote-debugging-port=0",
                "--remote-allow-origins=*",
                f"--user-data-dir={folder}",
                "about:blank",
            ],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        try:
            port = _port(Path(folder) / "DevToolsActivePort", process)
            with urlopen(f"http://127.0.0.1:{port}/json/list") as answer:
                pages = json.load(answer)
            target = next(page for page in pages if page["type"] == "page")
            with connect(target["webSocketDebuggerUrl"], max_size=None) as connection:
                yield Page(connection)
        finally:
            process.terminate()
            process.wait()


def _port(path: Path, process: subprocess.Popen[bytes]) -> int:
    end = time.monotonic() + _START_S
    while time.monotonic() < end and process.poll() is None:
        lines = path.read_text().split() if path.exists() else []
        if len(lines) > 1:
            return int(lines[0])
        time.sleep(0.05)
    raise RuntimeError("the browser did not start")


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
