"""Dataclasses of arrays with one row per vehicle: taking rows, writing rows."""

from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import NDArray


def take_rows(data: Any, rows: Any) -> Any:
    """The rows of a dataclass of arrays."""
    return type(data)(**{f.name: getattr(data, f.name)[rows] for f in fields(data)})


def scatter_rows(store: Any, slots: NDArray[np.intp], new: Any) -> Any:
    """``store`` (None at first) with the rows of ``new`` written to ``slots``; it doubles when it is too small."""
    needed = int(slots.max()) + 1
    arrays = {}
    for f in fields(new):
        value = getattr(new, f.name)
        old = None if store is None else getattr(store, f.name)
        arrays[f.name] = grow_rows(old, needed, value)
        arrays[f.name][slots] = value
    return type(new)(**arrays)


def grow_rows(array: NDArray[Any] | None, rows: int, like: NDArray[Any]) -> NDArray[Any]:
    """``array`` with at least ``rows`` rows of the shape of those of ``like``, the new ones zero."""
    if array is not None and len(array) >= rows:
        return array
    held = 0 if array is None else len(array)
    grown = np.zeros((max(rows, 2 * held), *like.shape[1:]), dtype=like.dtype)
    if array is not None:
        grown[:held] = array
    return grown


def distinct(rows: NDArray[np.int64]) -> tuple[list[list[int]], NDArray[np.intp]]:
    """The different rows of (B, K), and which of them each row is (B,)."""
    if len(rows) == 1:
        return rows.tolist(), np.zeros(1, dtype=np.intp)
    if rows.shape[1] == 1:
        values, inverse = np.unique(rows[:, 0], return_inverse=True)
        return [[value] for value in values.tolist()], inverse
    cases, inverse = np.unique(rows, axis=0, return_inverse=True)
    return cases.tolist(), inverse.ravel()
