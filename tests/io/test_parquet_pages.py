"""The end of a Parquet file is read as pyarrow reads it, or refused as damaged."""

from io import BufferedReader, BytesIO
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from anisomap.io.parsing.source import DamagedError
from anisomap.io.recordings.declared_sizes import column_chunks

arrow = pytest.importorskip("pyarrow")
parquet = pytest.importorskip("pyarrow.parquet")

MAGIC = b"PAR1"
TABLE = arrow.table({"a": np.arange(40), "b": [[1.0, 2.0]] * 40})


def written() -> bytes:
    stream = BytesIO()
    parquet.write_table(TABLE, stream, row_group_size=15)
    return stream.getvalue()


FILE = written()


def chunks_of(content: bytes):
    return column_chunks(Path("skin.parquet"), BufferedReader(BytesIO(content)))


def test_columns_of_every_row_group() -> None:
    metadata = parquet.ParquetFile(BytesIO(FILE)).metadata
    groups = [metadata.row_group(i) for i in range(metadata.num_row_groups)]
    expected = [[group.column(i).num_values for i in range(2)] for group in groups]
    assert [[chunk.n_values for chunk in group] for group in chunks_of(FILE)] == expected
    lengths = [[group.column(i).total_compressed_size for i in range(2)] for group in groups]
    assert [[chunk.length for chunk in group] for group in chunks_of(FILE)] == lengths


def check_read_or_refused(content: bytes) -> None:
    try:
        groups = chunks_of(content)
    except DamagedError:
        return
    assert all(chunk.n_values >= 0 and chunk.start >= 0 for group in groups for chunk in group)


@given(st.binary(max_size=80))
def test_any_end_is_read_or_refused(footer: bytes) -> None:
    check_read_or_refused(MAGIC + footer + len(footer).to_bytes(4, "little") + MAGIC)


@given(st.data())
def test_any_changed_byte_is_read_or_refused(data: st.DataObject) -> None:
    length = int.from_bytes(FILE[-8:-4], "little")
    at = data.draw(st.integers(len(FILE) - 8 - length, len(FILE) - 9))
    check_read_or_refused(FILE[:at] + bytes([data.draw(st.integers(0, 255))]) + FILE[at + 1 :])
