"""The page itself: template, style and scripts put together. Needs jinja2 and plotly."""

from __future__ import annotations

import base64
import hashlib
from functools import cache
from importlib.resources import files
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from plotly.offline import get_plotlyjs


def render(*, scene: list[dict[str, Any]], figure_png: bytes | None, **content: Any) -> str:
    """Fill the template; see `anisomap.drawing.report.render_report` for what goes in."""
    # A script ends at the first "</script" whatever surrounds it, so its text must hold none: that
    # of plotly and our own do not (there is a test), and the data is escaped by tojson.
    scripts = [get_plotlyjs(), _text("report.js")] if scene else [_text("report.js")]
    return (
        _environment()
        .get_template("report.html")
        .render(
            **content,
            scene=scene,
            picture=None if figure_png is None else base64.b64encode(figure_png).decode("ascii"),
            style=_text("report.css"),
            scripts=scripts,
            policy=_policy(scripts),
        )
    )


def _policy(scripts: list[str]) -> str:
    """Forbid the browser whatever the page does not need: any request, and any foreign script.

    plotly compiles its 3D drawing code when it runs, which takes 'unsafe-eval'.
    """
    hashes = [base64.b64encode(hashlib.sha256(text.encode()).digest()) for text in scripts]
    allowed = " ".join(f"'sha256-{digest.decode('ascii')}'" for digest in hashes)
    return (
        f"default-src 'none'; script-src {allowed} 'unsafe-eval'; "
        "style-src 'unsafe-inline'; img-src data: blob:; base-uri 'none'; form-action 'none'"
    )


@cache
def _environment() -> Environment:
    environment = Environment(
        loader=PackageLoader("anisomap.drawing.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    # NaN is no JSON: to find that out here is better than in a reader's browser.
    environment.policies["json.dumps_kwargs"] = {"allow_nan": False, "separators": (",", ":")}
    return environment


def _text(name: str) -> str:
    return files("anisomap.drawing.report").joinpath("templates", name).read_text(encoding="utf-8")
