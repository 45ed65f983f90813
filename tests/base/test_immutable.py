"""Frozen values are equal if their fields are, where NaN equals NaN, on each version of Python."""

import dataclasses

import pytest

from anisomap.base.immutable import Value
from anisomap.health import summary
from anisomap.map_verdict import Verdict

VALUES = sorted(Value.__subclasses__(), key=lambda kind: kind.__name__)


def filled(kind, number):
    value = object.__new__(kind)
    for one in dataclasses.fields(kind):
        object.__setattr__(value, one.name, (1, number))
    return value


def test_values_are_found():
    assert {Verdict, summary.RecordingSummary} <= {*VALUES}


@pytest.mark.parametrize("kind", VALUES, ids=lambda kind: kind.__name__)
def test_values_with_nan_are_equal(kind):
    one, other = filled(kind, float("nan")), filled(kind, float("nan"))
    assert one == other
    assert hash(one) == hash(other)
    assert len({one, other, filled(kind, 2.0)}) == 2
    assert one != filled(kind, 2.0)


def test_a_verdict_equals_no_other_kind():
    assert Verdict() == Verdict()
    assert Verdict() != dataclasses.replace(Verdict(), reasons=("short",))
    assert Verdict() != ()
