"""Exceptions and warnings, and import of optional libraries on first use.

Every message contains the problem, its place (file, line, sensor or frame) and the expected input.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

from anisomap.base.wording import printable, shortened

MAX_CHARACTERS = 300
"""Maximum length of an error message; names in files may have any length."""

_MAX_REASON = 200


class AnisomapError(Exception):
    """Base class of all errors that anisomap raises.

    Parameters
    ----------
    problem : str
        The problem in one sentence; it is shortened in the middle to `MAX_CHARACTERS`.
    hint : str
        The remedy; interfaces may replace it.
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
    """A required optional dependency is not installed.

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
    """Return the command that installs an extra from the source of the installed package.

    The installer records the source beside the package, unless it is an index:
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
        drive = path[2:3] == ":"  # a Windows path such as /C:/skin
        wanted = f"{path[1:] if drive else path}[{extra}]"
    elif url:
        system = source.get("vcs_info", {}).get("vcs", "")
        wanted += f" @ {system}+{url}" if system else f" @ {url}"
    return f"pip install {'-e ' if editable else ''}{shlex.quote(wanted)}"


def import_extra(module: str, purpose: str, extra: str) -> Any:
    """Import an optional library of an extra; typed as Any, since it may be absent.

    purpose: Subject of the error message, such as ``"reading HDF5"``.
    """
    try:
        return import_module(module)
    except ImportError as error:
        raise MissingExtraError(purpose, extra) from error
