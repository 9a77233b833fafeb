"""Angles on the circle."""

import numpy as np
from numpy.typing import ArrayLike, NDArray


def wrap(angle: ArrayLike) -> NDArray[np.float64]:
    """Angles (...) in rad turned into (-pi, pi]; those already there come back bit by bit."""
    angle = np.asarray(angle, dtype=np.float64)
    turned = np.pi - np.mod(np.pi - angle, 2 * np.pi)
    # np.mod rounds up to the modulus itself for tiny negative arguments
    turned = np.where(turned <= -np.pi, np.pi, turned)
    return np.where((angle > -np.pi) & (angle <= np.pi), angle, turned)
