"""Lists of modules: a table with the columns sensor, module and optionally pad."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from anisomap.errors import FileError
from anisomap.io.parsing import delimited
from anisomap.io.parsing.source import file_errors, open_text, quote
from anisomap.io.parsing.table import LineError
from anisomap.placement.modules import Modules, modules_by_name

_SENSOR = ("sensor", "name", "taxel", "id")


def read_modules(path: str | os.PathLike[str], names: Sequence[str]) -> Modules:
    """Read which sensors are on which module.

    Parameters
    ----------
    path : path-like
        Delimited text with a header: ``sensor,module`` or ``sensor,module,pad``. Pads are numbered
        from 0; without them, the sensors of a module are its pads in the order of the file.
    names : sequence of str
        Names of the sensors; others in the file are left out.

    Returns
    -------
    Modules
        Without a template.

    Raises
    ------
    FileError
        If the file is missing, damaged, lacks a column, names a sensor twice, or has none of
        `names`.
    """
    file = Path(path)
    with file_errors(file):
        with open_text(file) as stream:
            lines = list(stream)
        rows = list(delimited.records(lines, delimited.find_delimiter(lines)))
        header = [field.strip().lower() for field in rows[0][1]] if rows else []
        sensor = next((header.index(word) for word in _SENSOR if word in header), None)
        if sensor is None or "module" not in header:
            raise FileError(f"{file} must have a header with the columns sensor, module (and pad)")
        module = header.index("module")
        pad = header.index("pad") if "pad" in header else None
        assigned: dict[str, tuple[str, int | None]] = {}
        for line, fields in rows[1:]:
            if len(fields) != len(header):
                raise LineError(file, line, f" has {len(fields)} fields, not {len(header)}")
            name = fields[sensor].strip()
            if name in assigned:
                raise LineError(file, line, f": sensor {quote(name)} is listed twice")
            text = None if pad is None else fields[pad].strip()
            if text is not None and not (text.isascii() and text.isdigit() and len(text) < 10):
                raise LineError(file, line, f": pad {quote(text)} must be a whole number from 0")
            assigned[name] = (fields[module].strip(), None if text is None else int(text))
        return modules_by_name(names, assigned)
