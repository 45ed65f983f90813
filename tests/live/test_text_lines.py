"""Lines of text as frames."""

import itertools
import tracemalloc

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from anisomap.live.batches import Batch, Names, Notice
from anisomap.live.sources.lines import MAX_LINE, LineParser

CONTENT = st.binary(max_size=400) | st.text(max_size=200).map(str.encode)


def parsed(*parts: bytes, complete=False):
    parser = LineParser()
    return [
        *(item for part in parts for item in parser.feed(part, complete=complete)),
        *parser.end(),
    ]


def readings(items):
    return [row for item in items if isinstance(item, Batch) for row in item.readings.tolist()]


@given(content=CONTENT, cuts=st.lists(st.integers(0, 400), max_size=4))
def test_any_bytes_give_the_same_frames_however_they_are_cut(content, cuts):
    ends = sorted({min(cut, len(content)) for cut in cuts} | {0, len(content)})
    parts = [content[a:b] for a, b in itertools.pairwise(ends)]
    whole, pieces = parsed(content + b"\n"), parsed(*parts, b"\n")
    np.testing.assert_equal(readings(pieces), readings(whole))
    names = [[item for item in items if isinstance(item, Names)] for items in (whole, pieces)]
    assert names[0] == names[1]
    for item in parsed(content, complete=True):
        assert isinstance(item, Batch | Names | Notice)
        if isinstance(item, Batch):
            assert item.readings.ndim == 2
            assert item.readings.shape[1] >= 2


HEADER = "ms,T0_0,T0_1\n"
FRAMES = [f"{20 * i},{i * i % 7},{i % 5}.5\n" for i in range(60)]


@pytest.mark.parametrize("start", [HEADER, f"Skin v1.3 boot\n{HEADER}", f"3.5\n{HEADER}"])
@pytest.mark.parametrize("clock", ["", "14:02:11.{:03} -> "])
def test_a_header_names_the_sensors_and_the_time(start, clock):
    lines = [*start.splitlines(keepends=True), *FRAMES]
    lines[30:30] = ["WARN: i2c timeout\n", "1,2\n"]
    text = "".join(clock.format(i) + line for i, line in enumerate(lines))
    items = parsed(text.encode())
    assert Names(("T0_0", "T0_1")) in items
    batches = [item for item in items if isinstance(item, Batch)]
    assert readings(items) == [[i * i % 7, i % 5 + 0.5] for i in range(60)]
    times = np.concatenate([batch.times for batch in batches])
    assert (np.diff(times) > 0).all()
    if not clock:
        np.testing.assert_allclose(times, 0.02 * np.arange(60))
    assert any("without a frame" in item.text for item in items if isinstance(item, Notice))


def test_an_object_gives_the_time_and_the_order_of_its_first_names():
    lines = [f'{{"t": {i}, "a": {i * i % 7}, "b": {i * i % 5}}}\n' for i in range(20)]
    items = parsed("".join(lines).encode(), b'{"t": 20, "b": 4, "a": 3}\n')
    assert items[0] == Names(("a", "b"))
    assert readings(items)[-1] == [3, 4]
    assert items[-1].times[-1] == 20


@pytest.mark.parametrize("start", ["", "\ufeff", "n,a0,a1,a2\n"])
@pytest.mark.parametrize("end", ["\n", "\r", "\r\n"])
@pytest.mark.parametrize("n_counted", [16, 100, 256])
def test_a_counter_that_starts_again_is_no_sensor(start, end, n_counted):
    rows = np.random.default_rng(0).integers(0, 999, (120, 3)).tolist()
    lines = [f"{(i - 5) % n_counted},{','.join(map(str, row))}\n" for i, row in enumerate(rows)]
    assert readings(parsed("".join([start, *lines]).replace("\n", end).encode())) == rows


def test_what_is_no_sensor_is_left_out_as_of_files():
    rows = "".join(f"{i},1,2,3,{i},5\n" for i in range(60))
    notice, names, *batches = parsed(f"ms,p0 [N],p1 [N],p2 [N],load [kg],acc_x\n{rows}".encode())
    assert notice.text.endswith("(load: not in N; acc_x: an inertial unit)")
    assert names == Names(("p0", "p1", "p2"))
    assert readings(batches) == [[1, 2, 3]] * 60


@pytest.mark.parametrize(
    "line", ["hello", "1", "[1]", '["a", "b"]', '{"a": "b"}', "1e999,x", "1_0,2"]
)
def test_what_is_no_frame_is_a_notice_and_the_next_line_is_read(line):
    items = parsed(b"1,2\n" * 30, f"{line}\n3,4\n".encode())
    assert readings(items) == [[1, 2]] * 30 + [[3, 4]]
    assert sum(isinstance(item, Notice) for item in items) == 1


def test_a_line_without_end_takes_no_memory():
    parser = LineParser()
    for _ in range(3):
        assert not list(parser.feed(b"1," * (MAX_LINE // 2 + 1)))
    items = [*parser.feed(b"1,2\n3,4\n"), *parser.end()]
    assert readings(items) == [[3, 4]]
    assert sum(isinstance(item, Notice) for item in items) == 1


def test_a_board_that_starts_again_with_other_names_is_read_anew():
    rows = [f"{i},{i * i % 7},{i % 5},{i * 3 % 11}\n" for i in range(60)]
    for head, names in (("a,b,c,d\n", "wxyz"), ("", "abcd")):
        first = [head or "a,b,c,d\n", *rows]
        again = ["w,x,y,z\n", *rows] if head else [f"a=1,b=2,c=3,d={i}\n" for i in range(60)]
        items = parsed("".join([*first, *again]).encode())
        found = [item.names for item in items if isinstance(item, Names)]
        assert found[-1] == tuple(names)
        assert len(readings(items)) == 120
        said = [item.text for item in items if isinstance(item, Notice)]
        assert any(text.startswith("lines of another kind begin") for text in said)


@given(size=st.integers(1, 450), n_first=st.integers(30, 200))
def test_other_names_apply_from_their_line_on_however_lines_are_cut(size, n_first):
    drawn = np.random.default_rng(1).integers(0, 999, (400, 4)).tolist()
    rows = [",".join(map(str, row)).encode() + b"\n" for row in drawn]
    lines = [b"a,b,c,d\n", *rows[:n_first], b"w,x,y,z\n", *rows[n_first:]]
    items = parsed(*(b"".join(lines[i : i + size]) for i in range(0, len(lines), size)))
    begins = [i for i, item in enumerate(items) if isinstance(item, Names)]
    assert [items[i].names for i in begins] == [tuple("abcd"), tuple("wxyz")]
    assert readings(items[: begins[1]]) == drawn[:n_first]
    assert readings(items[begins[1] :]) == drawn[n_first:]


@pytest.mark.parametrize("size", [1, 2, 50])
def test_numbers_for_missing_readings_are_missing_however_lines_are_cut(size):
    sent = np.random.default_rng(1).integers(0, 999, (300, 12)).astype(float)
    sent[[249, 251], 3] = 0  # at rest
    sent[[150, 220]], sent[250, 3] = 65535, 65535
    lines = [",".join(f"{x:g}" for x in row).encode() + b"\n" for row in sent]
    items = parsed(*(b"".join(lines[i : i + size]) for i in range(0, len(lines), size)))
    np.testing.assert_array_equal(readings(items), np.where(sent == 65535, np.nan, sent))
    (said,) = (item.text for item in items if isinstance(item, Notice))
    assert said.startswith("65535 stands for a missing reading in s0")
    assert "pandas" not in said


def test_comments_of_an_idle_board_take_no_memory():
    parser = LineParser()
    items = [*parser.feed(b"1,2,3\n" * 120)]
    tracemalloc.start()
    for _ in range(40):
        items += parser.feed(b"# idle\n" * 400)
    assert tracemalloc.get_traced_memory()[1] < 1 << 19
    tracemalloc.stop()
    items += parser.feed(b"4,5,6\n")
    assert readings(items) == [[1, 2, 3]] * 120 + [[4, 5, 6]]


def test_a_frame_that_does_not_end_is_a_notice_and_later_lines_are_read():
    parser = LineParser()
    items = [*parser.feed(b"[[1, 2],\n[3, 4]]\n" * 60)]
    for _ in range(3):
        items += parser.feed(b"[" + b"1, " * (MAX_LINE // 4) + b"\n")
    items += [*parser.end(), *parser.feed(b"5, 6\n" * 120)]
    assert readings(items) == [[1, 2, 3, 4]] * 60 + [[5, 6]] * 120
    assert any("do not end" in item.text for item in items if isinstance(item, Notice))


def test_rows_of_a_matrix_that_rests_at_first_are_noticed():
    walk = np.random.default_rng(2).normal(size=(400, 12)).cumsum(axis=0).round(2)
    rows = np.concatenate([np.zeros((40, 12)), walk]).reshape(-1, 4).tolist()
    lines = "".join(",".join(map(str, row)) + "\n" for row in rows)
    items = parsed(*(lines[i : i + 999].encode() for i in range(0, len(lines), 999)))
    said = [item.text for item in items if isinstance(item, Notice)]
    assert any(text.endswith("start again with --grid 3x4") for text in said)
    assert readings(items) == rows


def test_a_flag_that_changes_late_is_noticed():
    rows = np.random.default_rng(2).integers(0, 999, (600, 9))
    rows = np.column_stack([rows, np.arange(600) // 60 == 8]).tolist()
    *_, said = parsed(*(",".join(map(str, row)).encode() + b"\n" for row in rows))
    assert said.text == "columns unlike the others are read as sensors (column 10: only 2 values)"
