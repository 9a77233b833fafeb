"""Durations as people write them."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fleet_bus.units import canonical, seconds, size


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


SAME = (
    ("m/s^2", "m/s2", "m/s²", "m/s**2", "m s^-2", "m·s⁻²", "m*s^-2", "meters/sec^2", "m / s^2", "m/s/s"),
    ("m/s", "mps", "meter/second", "m s-1", "m*s**-1", "Metres/Sec"),
    ("rad", "radian", "Radians"),
    ("rad/s", "rads/sec", "rad s^-1", "rad·s⁻¹"),
    ("deg", "°", "degrees"),
    ("km/h", "kph", "kmh", "km/hr"),
    ("1", "-", "", "none"),
    ("%",),
    ("1/s", "s^-1", "s-1"),
    ("V", "volts?"),
    ("mV",), ("MV",), ("mm",), ("Mm",), ("m",), ("ms",), ("s",),
)  # fmt: skip


@pytest.mark.parametrize("spellings", SAME, ids=lambda spellings: spellings[0])
def test_spellings_of_one_unit_are_one_unit_and_no_other(spellings: tuple[str, ...]) -> None:
    ours = {canonical(text) for text in spellings}
    assert len(ours) == (2 if "volts?" in spellings else 1)
    others = {canonical(text) for group in SAME if group is not spellings for text in group}
    assert not ours & others
    assert {canonical(text) for text in ours} == ours


@pytest.mark.parametrize(
    ("unit", "expected"),
    [
        ("m", 1.0),
        ("km/h", 1 / 3.6),
        ("mm/s", 1e-3),
        ("deg/s", math.pi / 180),
        ("1", 1.0),
        ("m/s2", 1.0),
        ("cm^2", 1e-4),
    ],
)
def test_sizes_of_units(unit: str, expected: float) -> None:
    assert size(unit) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("unit", ["V", "%", "?", "m//s", "ticks", "km^999"])
def test_sizes_of_other_units_are_not_known(unit: str) -> None:
    assert size(unit) is None


@given(st.text(max_size=20))
def test_any_text_may_be_a_unit(text: str) -> None:
    assert canonical(canonical(text)) == canonical(text)
