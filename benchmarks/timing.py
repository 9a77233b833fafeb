"""Medians of repeated calls."""

import time
from collections.abc import Callable, Sequence
from typing import TypeVar

import numpy as np

S = TypeVar("S")
T = TypeVar("T")


def median_seconds(work: Callable[[], object], repeats: int) -> float:
    """Median time of one call, after one that does not count."""
    work()
    return float(np.median([seconds(work)[0] for _ in range(repeats)]))


def seconds(work: Callable[[], T]) -> tuple[float, T]:
    """Time and result of one call."""
    began = time.perf_counter()
    result = work()
    return time.perf_counter() - began, result


def median_call(work: Callable[[S], T], arguments: Sequence[S]) -> tuple[float, list[T]]:
    """Median time of a call over the arguments, and the results; the first is called once more before, not counted."""
    work(arguments[0])
    times, results = [], []
    for argument in arguments:
        began = time.perf_counter()
        result = work(argument)
        times.append(time.perf_counter() - began)
        results.append(result)
    return float(np.median(times)), results
