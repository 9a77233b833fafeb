"""Numba behind a typed door: loops over single sets that NumPy cannot give.

A number or flag that stands in a call between kernels has a type of its own, for which the called kernel, and all that
it calls, is compiled once more. ``ZERO``, ``ONE``, ``NO`` and ``YES`` have the types of variables.
"""

from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar, cast

import numba
import numpy as np

from reach_server.numeric.kernel_cache import keep
from reach_server.numeric.types import FloatArray

P = ParamSpec("P")
T = TypeVar("T")

ZERO, ONE = cast(int, np.int64(0)), cast(int, np.int64(1))
NO, YES = cast(bool, np.bool_(False)), cast(bool, np.bool_(True))


def kernel(function: Callable[P, T]) -> Callable[P, T]:
    """``function`` compiled at its first call; the machine code is kept for later runs (``kernel_cache``)."""
    return cast(Callable[P, T], keep(numba.njit(nogil=True, error_model="numpy")(function)))


def leaf_kernel(function: Callable[P, T]) -> Callable[P, T]:
    """Like ``kernel``, for what makes no arrays: it does not count the references to those that it is given, which
    takes longer than the work on small ones. Whoever calls keeps them alive."""
    # Numba's run time system, which counts, is an option that its types do not know.
    without: dict[str, Any] = {"_nrt": False}
    return cast(Callable[P, T], keep(numba.njit(nogil=True, error_model="numpy", **without)(function)))


def reduction_kernel(function: Callable[P, T]) -> Callable[P, T]:
    """Like ``kernel``, for what adds up many terms in any order: the processor then adds several at once.

    The order is fixed when the function is compiled: equal arguments give equal results. Not for sums that are rounded
    outwards term by term; and ``x - x`` becomes 0 whatever x is, which ``np.isfinite`` is made of: ``abs(x) < np.inf``
    is what tells there.
    """
    order_free = {"reassoc", "nsz"}
    return cast(Callable[P, T], keep(numba.njit(nogil=True, error_model="numpy", fastmath=order_free)(function)))


def leaf_reduction_kernel(function: Callable[P, T]) -> Callable[P, T]:
    """``reduction_kernel`` for what makes no arrays, ``leaf_kernel``."""
    options: dict[str, Any] = {"_nrt": False, "fastmath": {"reassoc", "nsz"}}
    return cast(Callable[P, T], keep(numba.njit(nogil=True, error_model="numpy", **options)(function)))


def inline(function: Callable[P, T]) -> Callable[P, T]:
    """A part of compiled functions: its text takes the place of each call, and is compiled as the caller is.

    For functions on sets of a few numbers, where a call takes as long as the work.
    """
    return cast(Callable[P, T], numba.njit(inline="always", error_model="numpy")(function))


def inline_reduction(function: Callable[P, T]) -> Callable[P, T]:
    """A sum that compiled functions call, ``reduction_kernel``. Compiled with each of them, which may take it in."""
    order_free = {"reassoc", "nsz"}
    return cast(Callable[P, T], numba.njit(nogil=True, error_model="numpy", fastmath=order_free)(function))


def stacked(array: FloatArray, own: int, batch: tuple[int, ...], size: int) -> FloatArray:
    """``array`` (..., own axes) with its batch axes in one: (size, own axes), or (1, own axes) where all share it.

    Contiguous and read-only.
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
    return read_only(flat)


def read_only(array: FloatArray) -> FloatArray:
    """The array in C order, not to be written to: a kernel is compiled for one kind of array only."""
    flags = array.flags
    if flags.c_contiguous and not flags.writeable:
        return array
    array = np.ascontiguousarray(array).view()
    array.flags.writeable = False
    return array
