"""Modules of a skin: by numbers, by lists and by templates."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from anisomap import SensorMap, io
from anisomap.errors import FileError, InputError
from anisomap.placement import NO_MODULE, modules_by_name, modules_by_size

TACTILE = (0, 1, 2, 3, 4, 5, 7, 8, 9, 11)  # of the 12 numbers of a triangle of the iCub


@given(st.sampled_from([0, 1]), st.sets(st.integers(0, 30), min_size=1), st.randoms())
def test_numbers_divide_sensors_into_modules(first, blocks, random):
    names = [f"taxel{12 * block + pad + first}" for block in sorted(blocks) for pad in TACTILE]
    random.shuffle(names)
    modules = modules_by_size(names, 12)
    assert modules.n_modules == len(blocks)
    for name, index, pad in zip(names, modules.index, modules.pads, strict=True):
        number = int(name.removeprefix("taxel")) - first
        assert (sorted(blocks)[index], pad) == divmod(number, 12)
    for module in range(len(blocks)):
        members = modules.members(module)
        assert modules.pads[members].tolist() == list(TACTILE)


def test_sensors_without_a_number_are_on_no_module():
    modules = modules_by_size(["a", "s0", "s1", "s2"], 2, first=0)
    assert modules.index.tolist() == [NO_MODULE, 0, 0, 1]
    assert modules.pads.tolist() == [NO_MODULE, 0, 1, 0]
    assert modules.labels == ("0-1", "2-3")


def test_a_template_gives_the_offsets_by_the_numbers_of_its_pads():
    template = SensorMap([[2.0, 0], [0, 1]], names=("P2", "P0"), units="mm")
    modules = modules_by_size(["x", "s0", "s2", "s5"], 3, first=0).with_template(template)
    np.testing.assert_array_equal(modules.offsets, [[np.nan, np.nan], [0, 1], [2, 0], [2, 0]])
    assert modules.units == "mm"
    with pytest.raises(InputError, match="pad 1 of module 0-2, but the template has no such pad"):
        modules_by_size(["s0", "s1"], 3, first=0).with_template(template)
    with pytest.raises(InputError, match="must have a unit of length"):
        modules.with_template(SensorMap([[1.0, 2]]))


def test_lists_of_modules_are_read(tmp_path):
    path = tmp_path / "modules.csv"
    path.write_text("sensor,module,pad\nb,left,1\na,left,0\nc,right,0\nunknown,right,1\n")
    modules = io.read_modules(path, ["a", "b", "c", "d"])
    assert modules.index.tolist() == [0, 0, 1, NO_MODULE]
    assert modules.pads.tolist() == [0, 1, 0, NO_MODULE]
    assert modules.labels == ("left", "right")
    path.write_text("sensor,module\nb,left\na,left\n")
    assert io.read_modules(path, ["a", "b"]).pads.tolist() == [1, 0]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "must have a header with the columns sensor, module"),
        ("sensor,pad\na,0\n", "must have a header with the columns sensor, module"),
        ("sensor,module,pad\na,left\n", "line 2 has 2 fields, not 3"),
        ("sensor,module,pad\na,left,-1\n", "line 2: pad '-1' must be a whole number from 0"),
        ("sensor,module\na,left\na,right\n", "line 3: sensor 'a' is listed twice"),
        ("sensor,module,pad\na,left,0\nb,left,0\n", "2 sensors share pad 0 of module left"),
        ("sensor,module\nx,left\n", "no sensor of the list of modules is among the sensors"),
    ],
)
def test_damaged_lists_are_reported_with_their_place(tmp_path, text, message):
    path = tmp_path / "modules.csv"
    path.write_text(text)
    with pytest.raises(FileError, match=message):
        io.read_modules(path, ["a", "b"])


def test_ambiguous_and_impossible_divisions_are_refused():
    with pytest.raises(InputError, match="may start at number 0 or 1"):
        modules_by_size(["s1", "s2"], 3)
    with pytest.raises(InputError, match="no name has one"):
        modules_by_size(["a", "b"], 3)
    with pytest.raises(InputError, match="several sensors have the number 1"):
        modules_by_size(["a1", "b1"], 3)
    with pytest.raises(InputError, match="at least 2 pads, got 1"):
        modules_by_size(["a1"], 1)
    with pytest.raises(InputError, match="a pad for all sensors, or for none"):
        modules_by_name(["a"], {"a": ("left", None), "b": ("left", 1)})
