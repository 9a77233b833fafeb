"""Checks of array arguments: shapes, finite numbers, read-only results."""

from collections.abc import Sequence
from operator import index

import numpy as np
from numpy.typing import ArrayLike

from reach_server.numeric.types import FloatArray


class SetError(ValueError):
    """An argument of a set operation has the wrong shape or holds NaN or an infinity."""


def checked(value: ArrayLike, name: str, tail: tuple[int | None, ...], *, infinite: bool = False) -> FloatArray:
    """``value`` as a read-only float array whose last axes are ``tail`` (None: any length).

    Raises ``SetError`` naming the argument, the shape that came and the shape expected.
    """
    try:
        array = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise SetError(f"{name} must be an array of numbers: {error}") from None
    split = array.ndim - len(tail)
    fits = split >= 0
    # Every question passes here, so it is written for speed: no generator, one look at the numbers.
    for got, want in zip(array.shape[split:] if fits else (), tail, strict=False):
        fits = fits and (want is None or got == want)
    if not fits:
        expected = ", ".join("…" if want is None else str(want) for want in tail)
        raise SetError(f"{name} has shape {array.shape}, expected (..., {expected})")
    if not np.isfinite(array).all() and (not infinite or np.isnan(array).any()):
        raise SetError(f"{name} holds NaN{'' if infinite else ' or an infinity'}")
    if array.flags.writeable:
        array = array.view()
        array.flags.writeable = False
    return array


def batch_shape(*arrays: tuple[FloatArray, int]) -> tuple[int, ...]:
    """Common batch shape of arrays given with their number of own axes; raise ``SetError`` if there is none."""
    shapes = [array.shape[: array.ndim - own] for array, own in arrays]
    try:
        return np.broadcast_shapes(*shapes)
    except ValueError:
        raise SetError(f"batch axes {shapes} do not go together") from None


def checked_batch(array: FloatArray, own: int, name: str, batch: tuple[int, ...]) -> FloatArray:
    """``array``, if its batch axes (all but the last ``own``) go with those of the set; ``SetError`` otherwise."""
    axes = array.shape[: array.ndim - own]
    try:
        np.broadcast_shapes(axes, batch)
    except ValueError:
        raise SetError(f"{name} has batch axes {axes}, which do not go with {batch}, those of the set") from None
    return array


def checked_dimension(array: FloatArray, axis: int, name: str) -> FloatArray:
    """``array``, if that axis, the dimension of the set made of it, is not of length 0; ``SetError`` otherwise."""
    if array.shape[axis] == 0:
        raise SetError(f"{name} has shape {array.shape}: a set needs at least one dimension")
    return array


def checked_count(value: int, name: str) -> int:
    """``value`` as a whole number that is not negative; raise ``SetError`` naming the argument otherwise."""
    try:
        count = index(value)
    except TypeError:
        raise SetError(f"{name} is {value!r}, expected a whole number") from None
    if count < 0:
        raise SetError(f"{name} is {count}, expected no less than 0")
    return count


def checked_axes(axes: Sequence[int], dimension: int) -> list[int]:
    """Coordinates of a space of that dimension, counted from 0 (or, negative, from the end); ``SetError`` otherwise."""
    found = np.asarray(axes)
    if found.ndim != 1 or found.size == 0 or not np.issubdtype(found.dtype, np.integer):
        raise SetError(f"axes is {axes!r}, expected a sequence of at least one whole number")
    if (found < -dimension).any() or (found >= dimension).any():
        raise SetError(f"axes is {axes!r}, expected numbers from 0 to {dimension - 1}")
    return [int(axis) for axis in found]


def checked_bounds(
    bounds: tuple[ArrayLike, ArrayLike], name: str, tail: tuple[int | None, ...]
) -> tuple[FloatArray, FloatArray]:
    """A pair (lower, upper) of arrays whose last axes are ``tail``, infinite or not; ``SetError`` where they cross."""
    try:
        low, high = bounds
    except (TypeError, ValueError):
        raise SetError(f"{name} must be a pair (lower, upper)") from None
    lower = checked(low, f"{name}, lower", tail, infinite=True)
    upper = checked(high, f"{name}, upper", tail, infinite=True)
    batch_shape((lower, len(tail)), (upper, len(tail)))
    if (lower > upper).any():
        raise SetError(f"{name}: lower is greater than upper somewhere")
    return lower, upper


def stack_columns(*blocks: FloatArray) -> FloatArray:
    """Matrices (..., n, g_i) side by side, batch axes broadcast."""
    batch = np.broadcast_shapes(*(block.shape[:-2] for block in blocks))
    return np.concatenate([np.broadcast_to(b, (*batch, *b.shape[-2:])) for b in blocks], axis=-1)


def stack_rows(*blocks: FloatArray) -> FloatArray:
    """Matrices (..., n_i, g) one below the other, batch axes broadcast."""
    batch = np.broadcast_shapes(*(block.shape[:-2] for block in blocks))
    return np.concatenate([np.broadcast_to(b, (*batch, *b.shape[-2:])) for b in blocks], axis=-2)


def block_diagonal(first: FloatArray, second: FloatArray) -> FloatArray:
    """Block diagonal matrix (..., n1 + n2, g1 + g2) of two matrices, batch axes broadcast."""
    batch = np.broadcast_shapes(first.shape[:-2], second.shape[:-2])
    (n1, g1), (n2, g2) = first.shape[-2:], second.shape[-2:]
    result = np.zeros((*batch, n1 + n2, g1 + g2))
    result[..., :n1, :g1] = first
    result[..., n1:, g1:] = second
    return result
