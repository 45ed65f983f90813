"""The HTML page: template, style and scripts combined."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Mapping
from functools import cache
from importlib.resources import files
from typing import Any

from anisomap.drawing.report.report_text import Touches
from anisomap.drawing.view import printable
from anisomap.extras import import_extra


def load_libraries() -> tuple[Any, Any]:
    """Import jinja2 and plotly.

    Raises
    ------
    MissingExtraError
        If one of them is not installed.
    """
    jinja2 = import_extra("jinja2", "a report", "report")
    return jinja2, import_extra("plotly.offline", "a report", "report")


def render(
    *,
    scene: list[dict[str, Any]],
    figure_png: bytes | None,
    touches: Touches | None,
    **content: Any,
) -> str:
    """Fill the template; see `anisomap.drawing.report.render_report` for the arguments."""
    _, plotly = load_libraries()
    # A script ends at the first "</script", wherever it occurs. The texts of plotly and of this
    # package contain none (tested), and tojson escapes the data.
    own = _text("report.js")
    scripts = [plotly.get_plotlyjs(), own] if scene else [own]
    shown = {
        "picture": figure_png,
        "touch_picture": None if touches is None else touches.map_png,
        "series_picture": None if touches is None else touches.series_png,
    }
    pictures = {
        name: None if png is None else base64.b64encode(png).decode("ascii")
        for name, png in shown.items()
    }
    page: str = (
        _environment()
        .get_template("report.html")
        .render(
            **content,
            scene=scene,
            **pictures,
            touches=None if touches is None else _printable(touches.facts),
            style=_text("report.css"),
            scripts=scripts,
            policy=_policy(scripts),
        )
    )
    return page


def _printable(facts: Mapping[str, str]) -> dict[str, str]:
    return {printable(name): printable(value) for name, value in facts.items()}


def _policy(scripts: list[str]) -> str:
    """Return a content security policy without network access and without foreign scripts.

    plotly compiles its 3D drawing code at run time, which needs 'unsafe-eval'.
    """
    hashes = [base64.b64encode(hashlib.sha256(text.encode()).digest()) for text in scripts]
    allowed = " ".join(f"'sha256-{digest.decode('ascii')}'" for digest in hashes)
    return (
        f"default-src 'none'; script-src {allowed} 'unsafe-eval'; "
        "style-src 'unsafe-inline'; img-src data: blob:; base-uri 'none'; form-action 'none'"
    )


@cache
def _environment() -> Any:
    jinja, _ = load_libraries()
    environment = jinja.Environment(
        loader=jinja.PackageLoader("anisomap.drawing.report"),
        autoescape=True,
        undefined=jinja.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    # JSON has no NaN: fail here rather than in the browser.
    environment.policies["json.dumps_kwargs"] = {"allow_nan": False, "separators": (",", ":")}
    return environment


def _text(name: str) -> str:
    return files("anisomap.drawing.report").joinpath("templates", name).read_text(encoding="utf-8")
