"""Wrapping of angles."""

import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from vehicle_agent.angles import wrap


@given(st.floats(-1e4, 1e4))
def test_wrap_is_in_range_and_the_same_direction(angle: float) -> None:
    wrapped = float(wrap(angle))
    assert -math.pi < wrapped <= math.pi
    assert math.isclose(math.cos(wrapped), math.cos(angle), abs_tol=1e-9)
    assert math.isclose(math.sin(wrapped), math.sin(angle), abs_tol=1e-9)


@given(st.floats(-math.pi, math.pi, exclude_min=True))
def test_angles_in_range_are_left_alone(angle: float) -> None:
    assert float(wrap(angle)) == angle


def test_the_ends_of_the_range() -> None:
    just_above = np.nextafter(np.pi, 4)
    np.testing.assert_array_equal(wrap([np.pi, -np.pi, 3 * np.pi]), [np.pi] * 3)
    assert -np.pi < wrap(just_above) <= np.pi
