"""Durations as people write them."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fleet_bus.units import seconds


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (25, 25.0),
        (0.5, 0.5),
        ("25", 25.0),
        ("25 s", 25.0),
        ("250 ms", 0.25),
        (" 2min ", 120.0),
        ("1e-3 s", 0.001),
        (".5 s", 0.5),
        ("5. s", 5.0),
        ("-1 s", -1.0),
    ],
)
def test_a_duration_is_seconds(value: object, expected: float) -> None:
    assert seconds(value) == pytest.approx(expected, rel=1e-15)


@pytest.mark.parametrize(
    "value",
    ["", "s", "1 h", "1 sec", "1,5 s", "1 s s", "0x10", "1_000", "nan", "inf s", None, True, [], {"s": 1}, b"1"],
)
def test_what_is_no_duration_is_refused_by_value_with_what_to_write(value: object) -> None:
    with pytest.raises(ValueError, match="write a number of seconds, or one with ms, s or min"):
        seconds(value)


@pytest.mark.parametrize("value", [math.inf, -math.inf, math.nan, "1e400 s", "1e308 min", 10**400, -(10**400)])
def test_a_duration_without_end_is_refused(value: object) -> None:
    with pytest.raises(ValueError, match="not a finite duration"):
        seconds(value)


@given(st.floats(allow_nan=False, allow_infinity=False), st.sampled_from(("ms", "s", "min", "")))
def test_every_number_survives_its_text(number: float, unit: str) -> None:
    factor = {"ms": 1e-3, "s": 1.0, "min": 60.0, "": 1.0}[unit]
    if math.isfinite(number * factor):
        assert seconds(f"{number!r} {unit}") == number * factor


@given(st.text(max_size=40) | st.integers() | st.floats() | st.binary(max_size=8))
def test_anything_gives_a_finite_number_or_a_value_error(value: object) -> None:
    refused = ""
    try:
        assert math.isfinite(seconds(value))
    except ValueError as error:
        refused = str(error)
    assert len(refused) < 200
