"""Times of repeated calls, their medians and quartiles."""

import gc
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

S = TypeVar("S")
T = TypeVar("T")


def median_seconds(work: Callable[[], object], repeats: int) -> float:
    """Median time of one call, after one that does not count."""
    return float(np.median(repeated(work, repeats)))


def seconds(work: Callable[[], T]) -> tuple[float, T]:
    """Time and result of one call."""
    began = time.perf_counter()
    result = work()
    return time.perf_counter() - began, result


def times_of_calls(work: Callable[[S], T], arguments: Sequence[S]) -> tuple[list[float], list[T]]:
    """Time of a call for each argument, and the results; the first is called once more before, not counted."""
    work(arguments[0])
    times, results = [], []
    for argument in arguments:
        began = time.perf_counter()
        result = work(argument)
        times.append(time.perf_counter() - began)
        results.append(result)
    return times, results


def repeated(work: Callable[[], object], repeats: int) -> list[float]:
    """Times of calls, after one that does not count."""
    work()
    return [seconds(work)[0] for _ in range(repeats)]


@contextmanager
def swept() -> Iterator[None]:
    """Garbage collections within look at what is made within: what others left in memory is no work of this one."""
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()


def spread(times: Sequence[float] | NDArray[np.float64], factor: float) -> tuple[float, float, float]:
    """Median and quartiles, times a factor."""
    middle, low, high = (float(q) * factor for q in np.quantile(times, (0.5, 0.25, 0.75)))
    return middle, low, high
