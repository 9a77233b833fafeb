"""Bounded correction: how far a filter may move a measurement, and what that does to the bound of its error.

A Kalman estimate has a covariance but no bound. What is published is therefore

    y = z + clip(e - z, ±kappa b) ,

z the measurement, e the estimate, b the sensor's bound. Per component |z - x| ≤ b implies
|y - x| ≤ |z - x| + |y - z| ≤ (1 + kappa) b for the true state x, whatever e is. The factor cannot be improved
(z = x + b, e ≥ z + kappa b); kappa = 0 publishes the measurement.
"""

from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

#: kappa, where nothing else is said.
CORRECTION: Final = 0.5

# Leaves room for the rounding of the sum, for states up to a million times their bound.
_INWARD: Final = 1 - 1e-9


def correct(
    measured: NDArray[np.float64], estimate: NDArray[np.float64], bound: NDArray[np.float64], kappa: float
) -> NDArray[np.float64]:
    """Published state y (..., n) for measurement z, estimate e and the sensor's half-widths b (n)."""
    reach = _INWARD * kappa * bound
    return measured + np.clip(estimate - measured, -reach, reach)


def published_bound(sensor_bound: ArrayLike, kappa: float = CORRECTION) -> NDArray[np.float64]:
    """Half-widths (n) of the error of the published state, for those of the sensor (n); outer bound."""
    return (1 + kappa) * np.asarray(sensor_bound, dtype=np.float64)


def sensor_bound(published_bound: ArrayLike, kappa: float = CORRECTION) -> NDArray[np.float64]:
    """The sensor's half-widths (n) that ``published_bound`` (n) leaves room for."""
    return np.asarray(published_bound, dtype=np.float64) / (1 + kappa)
