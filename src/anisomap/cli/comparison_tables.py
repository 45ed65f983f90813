"""Tables of comparisons of methods: Markdown for documents, CSV for numbers."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence
from html import escape

from anisomap.comparison import Comparison, MethodScore
from anisomap.evaluation.rivals import RIVALS
from anisomap.io.parsing.delimited import guard_formula
from anisomap.wording import printable

_LEGEND = (
    "Each cell holds Mantel r and, in brackets, the RMS error in spacings of neighbouring sensors. "
    "All methods of a row are scored on the same sensors. Bold marks the best method of anisomap "
    "and the best stock method."
)


def to_markdown(comparisons: Sequence[Comparison]) -> str:
    """Format comparisons of the same methods as a Markdown table, followed by its losses."""
    methods = [s.method for s in comparisons[0].scores]
    lines = [["recording", "sensors x frames", "map", "scored", *methods]]
    lines.append(["---"] * len(lines[0]))
    for comparison in comparisons:
        best = [comparison.best(stock=stock) for stock in (False, True)]
        lines.append(
            [
                escape(printable(comparison.name), quote=False).replace("|", "\\|"),
                f"{comparison.n_sensors} x {comparison.n_frames}",
                f"{comparison.dimensions}D",
                str(len(comparison.sensors)),
                *(
                    f"**{_cell(s)}**" if any(s is one for one in best) else _cell(s)
                    for s in comparison.scores
                ),
            ]
        )
    table = "\n".join(f"| {' | '.join(line)} |" for line in lines)
    stock = "; ".join(f"{m}: {RIVALS[m].summary}" for m in methods if m in RIVALS)
    said = [*sentences(comparisons), *([f"Stock methods: {stock}."] if stock else [])]
    return "\n\n".join([table, _LEGEND, *(escape(text, quote=False) for text in said)]) + "\n"


def columns(methods: Sequence[str]) -> list[str]:
    """Return the columns of `to_csv`."""
    errors = [f"{method}: error" for method in methods]
    facts = ["recording", "sensors x frames", "map", "scored"]
    return [*facts, *methods, *errors, "best stock", "best stock r", "margin"]


def to_csv(comparisons: Sequence[Comparison]) -> str:
    """Format comparisons of the same methods as CSV, one line per recording.

    The columns are named after the methods (Mantel r), after the methods with ``: error`` (RMS
    error in spacings), and ``best stock``, ``best stock r`` and ``margin``: Mantel r of the first
    method of anisomap minus that of the best stock method.
    """
    methods = [s.method for s in comparisons[0].scores]
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(columns(methods))
    for comparison in comparisons:
        stock = comparison.best(stock=True)
        table.writerow(
            [
                guard_formula(printable(comparison.name)),
                f"{comparison.n_sensors} x {comparison.n_frames}",
                f"{comparison.dimensions}D",
                len(comparison.sensors),
                *(_number(s.mantel_r) for s in comparison.scores),
                *(_number(s.rms_in_spacings) for s in comparison.scores),
                stock.method if stock else "-",
                _number(stock.mantel_r if stock else math.nan),
                _margin(comparison.margin),
            ]
        )
    return text.getvalue()


def sentences(comparisons: Sequence[Comparison]) -> list[str]:
    """Say on which recordings a stock method is better, and which methods have no score and why."""
    said = []
    judged = [c for c in comparisons if not math.isnan(c.margin)]
    if judged:
        own = judged[0].judged.method if judged[0].judged else ""
        losses = [_loss(c) for c in judged if round(c.margin, 3) < 0]
        named = f": {', '.join(losses)}" if losses else ""
        count = f"{len(losses)} of {len(judged)} maps"
        said.append(f"A stock method is better than {own} on {count}{named}.")
    reasons: dict[tuple[str, str], list[str]] = {}
    for comparison in comparisons:
        for s in comparison.scores:
            if s.reason:
                reasons.setdefault((s.method, s.reason), []).append(_title(comparison))
    for (method, reason), names in reasons.items():
        everywhere = "" if len(names) == len(comparisons) else f" on {', '.join(names)}"
        said.append(f"No score of {method}{everywhere}: {printable(reason)}.")
    return said


def _loss(comparison: Comparison) -> str:
    stock = comparison.best(stock=True)
    own = math.nan if comparison.judged is None else comparison.judged.mantel_r
    against = f"{stock.mantel_r:.3f} of {stock.method}" if stock else "-"
    return (
        f"{_title(comparison)} ({'no map' if math.isnan(own) else f'{own:.3f}'} against {against})"
    )


def _title(comparison: Comparison) -> str:
    return f"{printable(comparison.name)} in {comparison.dimensions}D"


def _cell(s: MethodScore) -> str:
    return "-" if math.isnan(s.mantel_r) else f"{s.mantel_r:.3f} ({s.rms_in_spacings:.2f})"


def _number(value: float) -> str:
    return "-" if math.isnan(value) else f"{value:.4f}"


def _margin(value: float) -> str:
    return "-" if math.isnan(value) else f"{value:+.3f}"
