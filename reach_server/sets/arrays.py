"""Checks of array arguments: shapes, finite numbers, read-only results."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fleet_bus.errors import UsageError

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


class SetError(UsageError, ValueError):
    """An argument of a set operation has the wrong shape or holds NaN or an infinity."""


def checked(value: ArrayLike, name: str, tail: tuple[int | None, ...], *, infinite: bool = False) -> Array:
    """``value`` as a read-only float array whose last axes are ``tail`` (None: any length).

    Raises ``SetError`` naming the argument, the shape that came and the shape expected.
    """
    try:
        array = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise SetError(f"{name} must be an array of numbers: {error}") from None
    axes = array.shape[array.ndim - len(tail) :] if array.ndim >= len(tail) else None
    if axes is None or any(want is not None and got != want for got, want in zip(axes, tail, strict=True)):
        expected = ", ".join("…" if want is None else str(want) for want in tail)
        raise SetError(f"{name} has shape {array.shape}, expected (..., {expected})")
    if np.isnan(array).any() or not (infinite or np.isfinite(array).all()):
        raise SetError(f"{name} holds NaN{'' if infinite else ' or an infinity'}")
    if array.flags.writeable:
        array = array.view()
        array.flags.writeable = False
    return array


def batch_shape(*arrays: tuple[Array, int]) -> tuple[int, ...]:
    """Common batch shape of arrays given with their number of own axes; raise ``SetError`` if there is none."""
    shapes = [array.shape[: array.ndim - own] for array, own in arrays]
    try:
        return np.broadcast_shapes(*shapes)
    except ValueError:
        raise SetError(f"batch axes {shapes} do not go together") from None


def stack_columns(*blocks: Array) -> Array:
    """Matrices (..., n, g_i) side by side, batch axes broadcast."""
    batch = np.broadcast_shapes(*(block.shape[:-2] for block in blocks))
    return np.concatenate([np.broadcast_to(b, (*batch, *b.shape[-2:])) for b in blocks], axis=-1)


def block_diagonal(first: Array, second: Array) -> Array:
    """Block diagonal matrix (..., n1 + n2, g1 + g2) of two matrices, batch axes broadcast."""
    batch = np.broadcast_shapes(first.shape[:-2], second.shape[:-2])
    (n1, g1), (n2, g2) = first.shape[-2:], second.shape[-2:]
    result = np.zeros((*batch, n1 + n2, g1 + g2))
    result[..., :n1, :g1] = first
    result[..., n1:, g1:] = second
    return result
