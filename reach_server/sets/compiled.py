"""Numba behind a typed door: what the loops of linear programming need and NumPy cannot give."""

from collections.abc import Callable
from typing import ParamSpec, TypeVar, cast

import numba
import numpy as np

from reach_server.sets.arrays import Array

P = ParamSpec("P")
T = TypeVar("T")


def compiled(function: Callable[P, T]) -> Callable[P, T]:
    """``function`` compiled at its first call; the machine code is cached beside the source, or in the user's cache.

    The cache looks at the function's own file only: after a change in a kernel that kernels of other modules call,
    delete their ``__pycache__``.
    """
    return cast(Callable[P, T], numba.njit(cache=True, error_model="numpy")(function))


def stacked(array: Array, own: int, batch: tuple[int, ...], size: int) -> Array:
    """``array`` (..., own axes) with its batch axes in one: (size, own axes), or (1, own axes) where all share it.

    Contiguous and read-only, so that a kernel is compiled for one kind of array only.
    """
    split = array.ndim - own
    lead, tail = array.shape[:split], array.shape[split:]
    if not lead:
        flat = array[None]
    elif lead == batch:
        flat = array.reshape((size, *tail))
    elif all(axis == 1 for axis in lead):
        flat = array.reshape((1, *tail))
    else:
        flat = np.broadcast_to(array, batch + tail).reshape((size, *tail))
    flags = flat.flags
    if flags.c_contiguous and not flags.writeable:
        return flat
    flat = np.ascontiguousarray(flat).view()
    flat.flags.writeable = False
    return flat
