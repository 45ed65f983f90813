"""Dissimilarities in every form in which programs write them."""

import itertools

import numpy as np
import pytest

from anisomap import AnisomapError, io
from texts import table

RECTANGLE = np.array([[0, 3, 5, 4], [3, 0, 4, 5], [5, 4, 0, 3], [4, 5, 3, 0.0]])
NAMES = tuple("ABCD")
UNNAMED = ("s0", "s1", "s2", "s3")


def lower(*, diagonal):
    return [row[: i + diagonal] for i, row in enumerate(RECTANGLE)]


def upper(*, diagonal):
    return [row[i + (not diagonal) :] for i, row in enumerate(RECTANGLE)]


def pairs(*, delimiter=",", first="", names=NAMES):
    found = itertools.combinations(enumerate(names), 2)
    return first + "".join(
        f"{a}{delimiter}{b}{delimiter}{RECTANGLE[i, j]:g}\n" for (i, a), (j, b) in found
    )


def padded(cells, *, left):
    """Write a triangle as a table with empty cells."""
    lines = []
    for name, row in zip(NAMES, cells, strict=True):
        fields, empty = [f"{cell:g}" for cell in row], [""] * (4 - len(row))
        lines.append(",".join([name, *(empty + fields if left else fields + empty)]))
    return ",A,B,C,D\n" + "\n".join(lines) + "\n"


FORMS = {
    "square": (table(RECTANGLE), UNNAMED),
    "names in the first row": ("A,B,C,D\n" + table(RECTANGLE), NAMES),
    "names in both": ('"",A,B,C,D\n' + table(RECTANGLE, names=NAMES), NAMES),
    "write.table of R": ("A B C D\n" + table(RECTANGLE, " ", names=NAMES), NAMES),
    "numbers as names": (
        ",434,445,465,472\n" + table(RECTANGLE, names=("434", "445", "465", "472")),
        ("434", "445", "465", "472"),
    ),
    "decimal commas": (table(RECTANGLE, ";").replace("3", "3,0"), UNNAMED),
    "lower triangle": (table(lower(diagonal=True)), UNNAMED),
    "lower without diagonal": (table(lower(diagonal=False)[1:]), UNNAMED),
    "lower with names": (table(lower(diagonal=False), names=NAMES), NAMES),
    "dist as R prints it": (
        "  A B C\n" + table(lower(diagonal=False)[1:], " ", names="BCD"),
        NAMES,
    ),
    "lower half of a table": (padded(lower(diagonal=False), left=False), NAMES),
    "upper half of a table": (padded(upper(diagonal=True), left=True), NAMES),
    "upper triangle": (table(upper(diagonal=True)), UNNAMED),
    "upper without diagonal": (table(upper(diagonal=False)[:3]), UNNAMED),
    "list": (pairs(), NAMES),
    "list with a header": (pairs(delimiter="\t", first="from\tto\td\n"), NAMES),
    "list of numbers": (pairs(names=("1", "2", "3", "4")), ("1", "2", "3", "4")),
}


@pytest.mark.parametrize("form", FORMS)
def test_every_form_holds_the_same_matrix(form, tmp_path):
    text, names = FORMS[form]
    path = tmp_path / "d.csv"
    path.write_text(text)
    found = io.read_dissimilarities(path)
    np.testing.assert_array_equal(found.values, RECTANGLE)
    assert found.names == names
    if form == "list of numbers":
        with pytest.raises(AnisomapError, match="give --dissimilarities if"):
            io.find_dissimilarities(path)
    else:
        assert io.find_dissimilarities(path) is not None


def test_unknown_pairs_are_infinite(tmp_path):
    path = tmp_path / "d.csv"
    path.write_text("A,B,C,D\n0,NA,5,4\nNA,0,4,5\n5,,0,3\n4,5,3,0\n")
    found = io.read_dissimilarities(path).values
    expected = RECTANGLE.copy()
    expected[0, 1] = expected[1, 0] = np.inf
    np.testing.assert_array_equal(found, expected)


def test_an_array_is_read_as_well(tmp_path):
    np.save(tmp_path / "d.npy", RECTANGLE)
    np.testing.assert_array_equal(io.read_dissimilarities(tmp_path / "d.npy").values, RECTANGLE)
    assert io.find_dissimilarities(tmp_path / "d.npy") is not None
    np.save(tmp_path / "d.npy", RECTANGLE[:3])
    assert io.find_dissimilarities(tmp_path / "d.npy") is None
    (tmp_path / "d.npy").write_bytes((tmp_path / "d.npy").read_bytes()[:90])
    assert io.find_dissimilarities(tmp_path / "d.npy") is None


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("0,1,2\n1,0,3\n2,4,0\n", "s1 to s2 is 3, but s2 to s1 is 4"),
        ("0,1,2\n1,0,-3\n2,-3,0\n", "s1 and s2 is -3; it must be at least 0"),
        ("1,.5,.2\n.5,1,.3\n.2,.3,1\n", "itself is 1; it must be 0. Convert similarities"),
        ("0,1\n1,0\n2,3\n", "a square matrix, a triangle, or lines"),
        ("A,B,1\nB,A,2\nA,C,3\n", "is not symmetric: A to B is 1, but B to A is 2"),
        ("A,B,1\nA,B,2\nA,C,3\n", "two values for 'A' and 'B': 1 and 2"),
        ("0,1,2\n1,0,x\n2,3,0\n", "row 2 of the matrix: 'x' is not a number"),
    ],
)
def test_what_is_wrong_is_named(text, message, tmp_path):
    path = tmp_path / "d.csv"
    path.write_text(text)
    with pytest.raises(AnisomapError, match=message):
        io.read_dissimilarities(path)


def test_recordings_are_not_taken_for_dissimilarities(tmp_path):
    times = [f"12:00:0{i // 2},s{i % 2},{i}.5\n" for i in range(8)]
    (tmp_path / "long.csv").write_text("time,sensor,reading\n" + "".join(times))
    assert io.find_dissimilarities(tmp_path / "long.csv") is None
    readings = np.random.default_rng(0).random((5, 5))
    for name, values in {"random": readings, "tall": np.ones((40, 4))}.items():
        np.savetxt(tmp_path / f"{name}.csv", values, delimiter=",")
        assert io.find_dissimilarities(tmp_path / f"{name}.csv") is None


def test_weights_are_matched_by_name(tmp_path):
    path = tmp_path / "w.csv"
    path.write_text("C,A,0\nB,A,2\n")
    found = io.read_pair_weights(path, NAMES)
    assert (found[0, 2], found[0, 1], found[2, 3]) == (0, 2, 1)
    path.write_text("A,Z,1\n")
    with pytest.raises(AnisomapError, match="no object Z"):
        io.read_pair_weights(path, NAMES)


WHOLE = {
    "phylip": "4\n" + table(RECTANGLE, " ", names=NAMES),
    "phylip lower": "4\n" + table(lower(diagonal=False), " ", names=NAMES),
    "names in both": '"",A,B,C,D\n' + table(RECTANGLE, names=NAMES),
    "upper triangle": table(upper(diagonal=True)),
}


@pytest.mark.parametrize("kind", WHOLE)
def test_what_a_cut_file_lacks_is_never_guessed(put, kind: str) -> None:
    """Each line but the last has been cut off, or the file ends within it."""
    text = WHOLE[kind]
    for end in range(text.index("\n") + 1, text.rstrip("\n").rindex("\n") + 1):
        with pytest.raises(AnisomapError):
            io.read_dissimilarities(put("cut.txt", text[:end]))


def test_cut_vectors_are_refused(put, tmp_path) -> None:
    np.save(tmp_path / "vector.npy", RECTANGLE[np.triu_indices(4, 1)])
    content = (tmp_path / "vector.npy").read_bytes()
    for end in range(1, len(content)):
        with pytest.raises(AnisomapError):
            io.read_dissimilarities(put("cut.npy", content[:end]))
    for text in ("A,B,C", "0\n3,0\n5,", "1,2,x,4,5,6\n"):
        with pytest.raises(AnisomapError):
            io.read_dissimilarities(put("cut.txt", text))
