"""The page on troubleshooting quotes messages that the program contains."""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs/how-to/troubleshooting.md").read_text("utf-8")


def quotations() -> list[str]:
    prose = re.sub(r"```.*?```", "", PAGE, flags=re.DOTALL)
    return sorted(set(re.findall(r'"([^"]+)"', prose)))


def messages() -> list[str]:
    """Return every string of the package, f-strings without their values."""
    found = []
    for path in (ROOT / "src/anisomap").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.JoinedStr):
                parts = [part.value for part in node.values if isinstance(part, ast.Constant)]
                found.append("".join(parts))
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                found.append(node.value)
    return found


MESSAGES = messages()


@pytest.mark.parametrize("quotation", quotations())
def test_a_quoted_message_exists(quotation):
    words = ".*".join(re.escape(part.strip()) for part in quotation.split("…"))
    assert any(re.search(words, message, re.IGNORECASE | re.DOTALL) for message in MESSAGES)
