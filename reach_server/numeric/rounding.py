"""Sums of numbers rounded outwards: no true value is lost to the last digit."""

import numpy as np
from numpy.typing import ArrayLike

from reach_server.numeric.types import FloatArray

#: The distance from 1 to the next floating-point number.
EPS = float(np.finfo(np.float64).eps)


def add_up(a: ArrayLike, b: ArrayLike) -> FloatArray:
    """``a + b`` rounded towards plus infinity; the sum itself where it is a floating-point number, or an operand
    infinite. Plus infinity for infinities of both signs, of whose sum nothing is known."""
    return _rounded(a, b, np.inf)


def add_down(a: ArrayLike, b: ArrayLike) -> FloatArray:
    """``a + b`` rounded towards minus infinity, as ``add_up`` does towards the other."""
    return _rounded(a, b, -np.inf)


def sum_up(values: FloatArray, axis: int = -1) -> FloatArray:
    """Sum of nonnegative numbers, rounded up by k ulps for k + 1 that are not zero; exact for one."""
    rounded = np.maximum((values != 0).sum(axis=axis) - 1, 0)
    return np.asarray(values.sum(axis=axis) * (1.0 + rounded * EPS))


def _rounded(a: ArrayLike, b: ArrayLike, towards: float) -> FloatArray:
    a, b = np.asarray(a, dtype=np.float64), np.asarray(b, dtype=np.float64)
    with np.errstate(all="ignore"):
        total = np.asarray(a + b)
        # What the sum has lost (Knuth); not finite where an infinity takes part or an overflow happens.
        back = total - a
        error = (a - (total - back)) + (b - back)
        beyond = np.nextafter(total, towards)
        found = np.where(error <= 0 if towards > 0 else error >= 0, total, beyond)
        unusual = ~np.isfinite(error)
        if unusual.any():
            stays = np.isinf(a) | np.isinf(b)
            met = stays & np.isnan(total) & ~np.isnan(a) & ~np.isnan(b)
            found = np.where(unusual, np.where(stays, total, beyond), found)
            found = np.where(met, towards, found)
    return np.asarray(found)
