"""The page on troubleshooting quotes messages that the program contains."""

import ast
import re
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs/how-to/troubleshooting.md").read_text("utf-8")


def quotations() -> list[str]:
    prose = re.sub(r"```.*?```", "", PAGE, flags=re.DOTALL)
    return sorted(set(re.findall(r'"([^"]+)"', prose)))


@cache
def messages() -> list[str]:
    """Return every string of the package in lower case, f-strings without their values."""
    found = []
    for path in (ROOT / "src/anisomap").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.JoinedStr):
                parts = [part.value for part in node.values if isinstance(part, ast.Constant)]
                found.append("".join(parts).lower())
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                found.append(node.value.lower())
    return found


def contains(message: str, parts: list[str]) -> bool:
    """Return whether a message contains all parts, in this order."""
    for part in parts:
        _, found, message = message.partition(part)
        if not found:
            return False
    return True


@pytest.mark.parametrize("quotation", quotations())
def test_a_quoted_message_exists(quotation):
    parts = [part for words in quotation.lower().split("…") if (part := words.strip())]
    assert any(contains(message, parts) for message in messages())
