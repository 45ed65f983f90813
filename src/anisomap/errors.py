"""Exceptions and warnings.

Every message states the problem, its place (file, line, sensor or frame) and what is expected.

Import of optional libraries, on first use.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

from anisomap.base.wording import printable, shortened

MAX_CHARACTERS = 300
"""Maximum length of the message of an error; names from files may be of any length."""

_MAX_REASON = 200


class AnisomapError(Exception):
    """Base class of all errors that anisomap raises.

    Parameters
    ----------
    problem : str
        What is wrong, in one sentence; the middle of one longer than `MAX_CHARACTERS` is left out.
    hint : str
        What to do; callers of their own interface replace it.
    """

    def __init__(self, problem: str = "", hint: str = "") -> None:
        super().__init__(shortened("; ".join(filter(None, (problem, hint))), MAX_CHARACTERS))
        self.problem = problem


class InputError(AnisomapError, ValueError):
    """Data or an argument is invalid."""


class FileError(InputError):
    """A file is missing, damaged, of an unexpected format, or cannot be written."""


class DamagedError(FileError):
    """A file is damaged after its first bytes; the data before the damage may be readable."""


class MissingExtraError(AnisomapError, ImportError):
    """An optional dependency that the call needs is not installed.

    Parameters
    ----------
    purpose : str
        Subject of the message, such as ``"simulating a recording"``.
    extra : str
        Extra that installs the dependency, such as ``"simulation"``.
    """

    def __init__(self, purpose: str, extra: str) -> None:
        super().__init__(f"{purpose} needs an extra: {install_command(extra)}")
        self.purpose, self.extra = purpose, extra

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.purpose, self.extra)


class AnisomapWarning(UserWarning):
    """A result is less reliable than it appears; the message gives the reason."""


def error_reason(error: BaseException) -> str:
    """Return the message of an exception on one line, shortened to printable characters."""
    text = " ".join(str(error).split()) or type(error).__name__
    return printable(shortened(text, _MAX_REASON))


def install_command(extra: str) -> str:
    """Return the command that installs an extra from where the package was installed.

    The installer leaves the source beside the package, unless it was an index:
    https://packaging.python.org/en/latest/specifications/direct-url.
    """
    import json  # noqa: PLC0415
    import shlex  # noqa: PLC0415
    from importlib.metadata import PackageNotFoundError, distribution  # noqa: PLC0415
    from urllib.parse import unquote, urlsplit  # noqa: PLC0415

    try:
        source = json.loads(distribution("anisomap").read_text("direct_url.json") or "{}")
    except (PackageNotFoundError, ValueError):
        source = {}
    url, wanted = source.get("url", ""), f"anisomap[{extra}]"
    editable = source.get("dir_info", {}).get("editable", False)
    if url.startswith("file:"):
        path = unquote(urlsplit(url).path)
        drive = path[2:3] == ":"  # of Windows, as in /C:/skin
        wanted = f"{path[1:] if drive else path}[{extra}]"
    elif url:
        system = source.get("vcs_info", {}).get("vcs", "")
        wanted += f" @ {system}+{url}" if system else f" @ {url}"
    return f"pip install {'-e ' if editable else ''}{shlex.quote(wanted)}"


def import_extra(module: str, purpose: str, extra: str) -> Any:
    """Import a library that an extra installs, typed as Any, since it may be absent.

    purpose: Subject of the error message, such as ``"reading HDF5"``.
    """
    try:
        return import_module(module)
    except ImportError as error:
        raise MissingExtraError(purpose, extra) from error
