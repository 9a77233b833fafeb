"""Bounded correction."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from vehicle_agent.correction import correct, published_bound, sensor_bound


@given(
    truth=st.floats(-1e3, 1e3),
    error=st.floats(-1, 1),
    estimate=st.floats(-1e6, 1e6),
    bound=st.floats(1e-3, 10),
    kappa=st.floats(0, 3),
)
def test_the_published_error_is_bounded_whatever_the_estimate(
    truth: float, error: float, estimate: float, bound: float, kappa: float
) -> None:
    b = np.array([bound])
    measured = np.array([truth + error * bound])
    published = correct(measured, np.array([estimate]), b, kappa)
    assert (np.abs(published - truth) <= published_bound(b, kappa) + 1e-12).all()


def test_the_factor_is_reached() -> None:
    b, kappa = np.array([0.1]), 0.5
    published = correct(np.array([0.1]), np.array([9.0]), b, kappa)
    np.testing.assert_allclose(published, published_bound(b, kappa), rtol=1e-8)


def test_an_estimate_near_by_is_published_and_no_correction_means_the_measurement() -> None:
    z, e, b = np.array([1.0, 2.0]), np.array([1.01, 1.98]), np.array([0.1, 0.1])
    np.testing.assert_allclose(correct(z, e, b, 0.5), e)
    np.testing.assert_array_equal(correct(z, e, b, 0.0), z)


def test_the_two_bounds_are_inverse() -> None:
    np.testing.assert_allclose(published_bound(sensor_bound([0.3, 0.0], 0.7), 0.7), [0.3, 0.0])
