"""Tubes: what is put is what is read, and nothing else is."""

from dataclasses import fields
from typing import Any

import msgpack
import numpy as np
import pytest
from hypothesis import given

from fleet_bus.messages import Audit, Cut, Label, ReachTube
from fleet_bus.messages.tube import ENCODING
from tests.fleet_bus.messages.examples import T0, a_tube, refusal, tubes


def same(a: ReachTube, b: ReachTube) -> bool:
    return all(np.array_equal(getattr(a, f.name), getattr(b, f.name)) for f in fields(ReachTube))


@given(tubes())
@pytest.mark.slow
def test_a_tube_survives_the_wire(tube: ReachTube) -> None:
    found = ReachTube.decode(tube.encode(), ENCODING)
    assert same(found, tube)
    assert found.audit == tube.audit
    assert found.cuts == tube.cuts
    assert found.label is tube.label


def test_sets_travel_as_single_precision_centers_and_areas_as_double() -> None:
    found = ReachTube.decode(a_tube(center=np.full((3, 4), 1e5 + 1e-9), generators=np.full((3, 4, 4), 0.1)).encode())
    assert (found.center == 1e5 + 1e-9).all()
    assert (found.generators == float(np.float32(0.1))).all()


def test_the_default_tube_is_small() -> None:
    tube = a_tube(
        times=T0 + np.arange(1, 11), center=np.zeros((10, 4)), generators=np.zeros((10, 4, 6)),
        hull=np.zeros((10, 2, 4)), outline=np.zeros((10, 12, 2)), area=np.zeros(10), area_free=np.zeros(10),
    )  # fmt: skip
    assert len(tube.encode()) <= 3072


def wire(**changes: Any) -> bytes:
    packed: bytes = msgpack.packb({**msgpack.unpackb(a_tube().encode()), **changes})
    return packed


NAN, INF = float("nan"), float("inf")


def bins(count: int, value: float = 0.0, dtype: str = "<f8") -> bytes:
    return np.full(count, value, dtype=dtype).tobytes()


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"v": "a/b"}, "fields"),
        ({"v": "svea1\n"}, "fields"),
        ({"v": b"svea1"}, "fields"),
        ({"e": -1}, "range"),
        ({"e": 1.0}, "fields"),
        ({"s": -1}, "range"),
        ({"t": 0}, "range"),
        ({"t": 2**63}, "range"),
        ({"t": True}, "fields"),
        ({"T": b""}, "shape"),
        ({"T": b"\0" * 25}, "shape"),
        ({"T": bins(1001)}, "shape"),
        ({"T": bins(2)}, "shape"),
        ({"x": []}, "fields"),
        ({"x": ["a"] * 33}, "fields"),
        ({"x": ["x", "y", "yaw", 4]}, "fields"),
        ({"x": ["x", "y", "yaw"]}, "shape"),
        ({"p": [0]}, "fields"),
        ({"p": [0, 4]}, "range"),
        ({"p": [-1, 0]}, "range"),
        ({"p": [0.0, 1.0]}, "fields"),
        ({"l": "certain"}, "range"),
        ({"l": 1}, "fields"),
        ({"c": bins(11)}, "shape"),
        ({"c": bins(12, NAN)}, "not_finite"),
        ({"c": [0.0] * 12}, "fields"),
        ({"g": bins(49, dtype="<f4")}, "shape"),
        ({"g": bins(48, INF, "<f4")}, "not_finite"),
        ({"h": bins(12, dtype="<f4")}, "shape"),
        ({"h": bins(24, NAN, "<f4")}, "not_finite"),
        ({"o": bins(25, dtype="<f4")}, "shape"),
        ({"o": bins(24, NAN, "<f4")}, "not_finite"),
        ({"a": bins(2)}, "shape"),
        ({"a": bins(3, INF)}, "not_finite"),
        ({"af": bins(4)}, "shape"),
        ({"k": ["abcd"]}, "fields"),
        ({"k": [["lot", "P", 1]]}, "fields"),
        ({"k": [["lot", "P", 1, INF]]}, "fields"),
        ({"k": [["lot", "P", b"1", 2]]}, "fields"),
        ({"k": [["lot", "P", True, 2]]}, "fields"),
        ({"k": [[{}, "P", 1, 2]]}, "fields"),
        ({"n": [1]}, "fields"),
        ({"n": [["nested"]]}, "fields"),
        ({"vd": {"safe": 1}}, "fields"),
        ({"vd": {b"safe": "yes"}}, "fields"),
        ({"au": [1, 1]}, "fields"),
        ({"au": [1, 1, 0.0]}, "fields"),
        ({"au": [INF, 1, 0.0, 0, 0, 0]}, "fields"),
        ({"au": [1, 1, "0", 0, 0, 0]}, "fields"),
        ({"au": [1, 1, 0.0, 1, 1, 0.5]}, "fields"),
        ({"au": [1, 2, 0.0, 0, 0, 0]}, "range"),
        ({"au": [-1, -1, 0.0, 0, 0, 0]}, "range"),
        ({"au": [1, 1, -1.0, 0, 0, 0]}, "range"),
        ({"au": [1, 1, 0.0, 2, 1, 0]}, "range"),
        ({"au": [3, 3, 0.0, 2, 3, 0]}, "range"),
        ({"au": [3, 3, 0.0, 2, 2, -1]}, "range"),
        ({"au": [1, 1, NAN, 0, 0, 0]}, "not_finite"),
        ({"sv": None}, "fields"),
        ({"se": -1}, "range"),
        ({"ct": -0.1}, "range"),
        ({"ct": INF}, "not_finite"),
        ({"ct": "fast"}, "fields"),
        ({"m": None}, "fields"),
        ({"m": "magic"}, "range"),
    ],
)
def test_each_refusal_has_its_reason(changes: dict[str, Any], reason: str) -> None:
    assert refusal(ReachTube.decode, wire(**changes)) == reason


def test_an_integer_may_stand_for_a_duration() -> None:
    found = ReachTube.decode(wire(ct=0, au=[2, 1, 0, 2, 1, 0]))
    assert (found.compute_seconds, found.audit) == (0.0, Audit(2, 1, 0.0, 2, 1))


def test_labels_are_the_four_that_are_documented() -> None:
    assert [str(label) for label in Label] == ["guaranteed", "calibrated", "uncovered", "contradicted"]


def test_cuts_keep_their_steps() -> None:
    cuts = (Cut("lot", "P.x1", 1, 2), Cut("lot", "O", 3, 3))
    assert ReachTube.decode(a_tube(cuts=cuts).encode()).cuts == cuts
