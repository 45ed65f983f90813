"""The page of a session: a small web server for one person, on this computer.

Readings, maps and the status are sent as server-sent events (HTML Living Standard, section 9.2),
which browsers reconnect automatically; actions are posted. The page loads nothing from other hosts.
"""

from __future__ import annotations

import ipaddress
import json
import logging
import re
import secrets
import sys
import threading
import time
from collections.abc import Callable
from http import HTTPStatus
from http.cookies import CookieError, SimpleCookie
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.parse import SplitResult, parse_qs, quote, unquote, urlsplit

from anisomap.errors import AnisomapError, InputError
from anisomap.live.page import STATIC, act, map_snapshot, readings_snapshot, status_snapshot
from anisomap.live.session import LiveSession

logger = logging.getLogger(__name__)

_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; img-src data:; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
_TYPES = {".html": "text/html", ".css": "text/css", ".js": "text/javascript"}  # on any system
_BYTES = {"errors": "surrogateescape"}  # of file names
_STATUS_S = 0.5  # between two updates of slowly changing values
_KEEP_S = 2.0  # for browsers to load the page at the end
# Address or name, port.
_HOST = re.compile(r"(?:\[([0-9a-fA-F:.]+)\]|([0-9A-Za-z.-]+))(?::\d{1,5})?")
_TIMEOUT_S = 20.0  # of a connection that accepts no data
_MAX_BODY = 1 << 23
_MAX_DIGITS = 20  # of a length, as in 64-bit numbers
_MAX_VIEWERS = 16
_TOKEN = "token"  # noqa: S105 (the name of a cookie)
_POST_HEADER = "X-Anisomap"  # other sites cannot send it without a preflight request


class Server(ThreadingHTTPServer):
    """Serves the page of a session in separate threads, until the end of its context.

    host: Address to listen on. Unless it is the loopback address, the page requires a token.
    port: 0 for any free port.
    url: Address of the page, with the token if there is one.
    """

    daemon_threads = True
    block_on_close = False
    allow_reuse_address = True

    def __init__(self, session: LiveSession, host: str = "127.0.0.1", port: int = 8765) -> None:
        self.session = session
        self.closing = threading.Event()
        self.viewers = threading.BoundedSemaphore(_MAX_VIEWERS)
        self.written: dict[str, Path] = {}
        self.end: Path | None = None
        self.is_watched = False
        self.kept = threading.Event()
        try:
            super().__init__((host, port), _Handler)
        except (OSError, OverflowError) as error:
            reason = getattr(error, "strerror", None) or error
            problem = f"cannot show the page on {host}:{port}: {reason}"
            raise InputError(f"{problem}; choose another --port") from error
        self.token = "" if _is_loopback(host) else secrets.token_urlsafe(16)
        self.port = int(self.server_address[1])
        shown = f"[{host}]" if ":" in host else host
        query = f"?{_TOKEN}={self.token}" if self.token else ""
        self.url = f"http://{shown}:{self.port}/{query}"
        self._thread = threading.Thread(target=self.serve_forever, daemon=True)
        self._thread.start()

    def keep(self, page: Path) -> None:
        """Serve the final page, which browsers show when they reload the address."""
        self.end = page
        if self.is_watched:
            self.kept.wait(_KEEP_S)

    def __exit__(self, *_: object) -> None:
        self.closing.set()
        self.shutdown()
        self.server_close()
        self._thread.join()

    def handle_error(self, *_: object) -> None:
        """Ignore errors of a connection, such as a closed browser; log defects."""
        error = sys.exception()
        if not isinstance(error, OSError):
            logger.error("the page failed to answer a request", exc_info=error)


class _Handler(BaseHTTPRequestHandler):
    server: Server
    protocol_version = "HTTP/1.1"
    server_version = "anisomap"
    sys_version = ""
    timeout = _TIMEOUT_S

    def log_message(self, *_: object) -> None:
        """Do not log requests."""

    def do_GET(self) -> None:
        """Answer a request for a file, an event stream or a download."""
        address = _split(self.path)
        if self.server.closing.is_set():  # a connection may still be open
            self.close_connection = True
            return
        if not self._allowed(address.query):
            return
        page = STATIC / (address.path[1:] or "index.html")
        if page.parent == STATIC and page.suffix in _TYPES and page.is_file():
            self._send(page.read_bytes(), f"{_TYPES[page.suffix]}; charset=utf-8")
        elif address.path == "/events":
            self._send_events()
        elif address.path == "/end" and self.server.end is not None:
            self._send(self.server.end.read_bytes(), "text/html; charset=utf-8")
            self.server.kept.set()
        elif address.path.startswith("/files/"):
            self._send_file(unquote(address.path.removeprefix("/files/"), **_BYTES))
        else:
            self._refuse(HTTPStatus.NOT_FOUND, "there is no such page")

    def do_POST(self) -> None:
        """Perform an action."""
        if not self._allowed(""):
            return
        length = self.headers.get("Content-Length", "")
        if self.headers.get(_POST_HEADER) is None or self.path != "/act":
            self._refuse(HTTPStatus.FORBIDDEN, "actions are posted by the page only")
            return
        # Beyond 4300 digits, Python refuses to convert a number.
        if not length.isdecimal() or len(length) > _MAX_DIGITS or int(length) > _MAX_BODY:
            self._refuse(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, f"at most {_MAX_BODY} bytes")
            return
        try:
            request = json.loads(self.rfile.read(int(length)))
            if not isinstance(request, dict):
                raise InputError("an action must be an object")
            done = act(self.server.session, request)
        except AnisomapError as error:
            self._send_json({"ok": False, "text": str(error)})
            return
        except (ValueError, RecursionError):
            self._refuse(HTTPStatus.BAD_REQUEST, "an action must be JSON")
            return
        self.server.written |= {path.name: path for path in done.files}
        links = [
            {"name": path.name, "url": f"/files/{quote(path.name, **_BYTES)}"}
            for path in done.files
        ]
        self._send_json({"ok": True, "text": done.text, "files": links})

    def _allowed(self, query: str) -> bool:
        """Check the host name (DNS rebinding), the origin and the token of a request."""
        host = self.headers.get("Host", "")
        origin = self.headers.get("Origin")
        if origin is not None and origin != f"http://{host}":
            self._refuse(HTTPStatus.FORBIDDEN, "requests of other sites are refused")
            return False
        token = self.server.token
        if not token:
            name = _HOST.fullmatch(host)
            if name and _is_loopback(name[1] or name[2]):
                return True
            self._refuse(HTTPStatus.FORBIDDEN, "open the page by the address that was printed")
            return False
        given = parse_qs(query).get(_TOKEN, [""])[-1]
        if given and secrets.compare_digest(given.encode(), token.encode()):
            self.send_response(HTTPStatus.SEE_OTHER)
            self.send_header("Location", "/")
            self.send_header("Set-Cookie", f"{_TOKEN}={token}; HttpOnly; SameSite=Strict; Path=/")
            self.send_header("Content-Length", "0")
            self.end_headers()
            return False
        if secrets.compare_digest(self._cookie().encode(), token.encode()):
            return True
        self._refuse(HTTPStatus.FORBIDDEN, "open the page by the address with the token")
        return False

    def _cookie(self) -> str:
        try:
            found = SimpleCookie(self.headers.get("Cookie", "")).get(_TOKEN)
        except CookieError:
            return ""
        return "" if found is None else found.value

    def _send_events(self) -> None:
        server = self.server
        if not server.viewers.acquire(blocking=False):
            self._refuse(HTTPStatus.SERVICE_UNAVAILABLE, f"at most {_MAX_VIEWERS} pages")
            return
        try:
            self._start(HTTPStatus.OK, "text/event-stream")
            self.send_header("Connection", "close")
            self.end_headers()
            server.is_watched = True
            _stream(server, self._send_event)
        finally:
            self.close_connection = True
            server.viewers.release()

    def _send_event(self, kind: str, data: object) -> None:
        text = json.dumps(data, separators=(",", ":"), allow_nan=False)
        self.wfile.write(f"event: {kind}\ndata: {text}\n\n".encode())
        self.wfile.flush()

    def _send_file(self, name: str) -> None:
        path = self.server.written.get(name)
        if path is None or not path.is_file():
            self._refuse(HTTPStatus.NOT_FOUND, "there is no such file")
            return
        shown = f"attachment; filename*=UTF-8''{quote(name, **_BYTES)}"
        self._send(path.read_bytes(), "application/octet-stream", disposition=shown)

    def _send_json(self, data: object) -> None:
        self._send(json.dumps(data, allow_nan=False).encode(), "application/json")

    def _refuse(self, status: HTTPStatus, text: str) -> None:
        self.close_connection = True
        self._send(f"{text}\n".encode(), "text/plain; charset=utf-8", status)

    def _send(
        self, content: bytes, kind: str, status: HTTPStatus = HTTPStatus.OK, disposition: str = ""
    ) -> None:
        self._start(status, kind)
        if disposition:
            self.send_header("Content-Disposition", disposition)
        self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        self.wfile.write(content)

    def _start(self, status: HTTPStatus, kind: str) -> None:
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Security-Policy", _POLICY)
        self.send_header("X-Content-Type-Options", "nosniff")
        self.send_header("Referrer-Policy", "no-referrer")
        self.send_header("Cache-Control", "no-store")


def _stream(server: Server, send: Callable[[str, object], None]) -> None:
    """Send the state of a session repeatedly; a slow reader misses states except the last."""
    session, has_end = server.session, False
    shown: tuple[object, object] = (None, None)
    tick, told = -1, 0.0
    while not server.closing.is_set():
        with session.changed:
            session.changed.wait(_STATUS_S)
        maps = session.maps.quick, session.maps.checked
        if maps != shown and (found := map_snapshot(session)) is not None:
            send("map", found)
            shown = maps
        if session.tick != tick:
            tick = session.tick
            send("readings", readings_snapshot(session))
        if time.monotonic() - told >= _STATUS_S:
            told = time.monotonic()
            send("status", status_snapshot(session))
        if server.end is not None and not has_end:
            has_end = True
            send("end", server.end.name)


def _split(address: str) -> SplitResult:
    """Split an address; an invalid address, such as ``//[``, has no parts."""
    try:
        return urlsplit(address)
    except ValueError:
        return SplitResult("", "", "", "", "")


def _is_loopback(host: str) -> bool:
    if host.lower() == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False
