"""When a scenario's side information asks for which predicate, read off its formula."""

from dataclasses import dataclass
from functools import reduce
from typing import Final

import numpy as np
from numpy.typing import NDArray

from reach_server.numeric.types import BoolArray
from side_info.documents.scenario import Scenario
from side_info.stl.nnf import Conjunction, Disjunction, Finally, Globally, Literal, Normal, Until

#: Samples up to which activity is followed.
MOST_STEPS: Final = 20_000


@dataclass(frozen=True, slots=True, eq=False)
class Activity:
    """What is asked for, sample by sample from time zero on.

    Attributes:
        sample_time: seconds.
        always: whether each way to fulfil the formula asks for the predicate at the sample (K, P).
        some: whether some way does, (K, P).
    """

    sample_time: float
    always: BoolArray
    some: BoolArray

    @property
    def cut_short(self) -> bool:
        """Whether the formula goes on after the last sample."""
        return len(self.some) == MOST_STEPS


def activity(scenario: Scenario, sample_time: float) -> Activity:
    """Activity of the side information of ``scenario`` on the samples of ``sample_time`` (s), from its first one on.

    Ways are those that the formula spells out, one for each operand of a disjunction and for each sample at which an
    eventuality comes true. That one of them contradicts another part of the formula is not looked at.
    """
    step_ns = round(sample_time * 1e9)
    count = min(scenario.end_ns // step_ns + 1, MOST_STEPS)
    always, some = _asked(scenario.side_information, step_ns, (count, len(scenario.predicates)))
    return Activity(sample_time, always, some)


def spans(active: BoolArray, sample_time: float) -> list[tuple[float, float]]:
    """Times (s) of the first and last sample of each run of true ones in ``active`` (K,)."""
    edges = np.flatnonzero(np.diff(np.concatenate(([0], active.astype(np.int8), [0]))))
    return [(float(a) * sample_time, float(b - 1) * sample_time) for a, b in edges.reshape(-1, 2)]


def _asked(formula: Normal, step_ns: int, shape: tuple[int, int]) -> tuple[BoolArray, BoolArray]:
    """What a formula asks for (K, P) from the sample on at which it holds: in every way to fulfil it, in some."""
    always, some = np.zeros(shape, dtype=bool), np.zeros(shape, dtype=bool)
    match formula:
        case Literal(predicate):
            always[0, predicate] = some[0, predicate] = True
        case Conjunction(operands) if operands:
            parts = [_asked(operand, step_ns, shape) for operand in operands]
            return reduce(np.logical_or, (a for a, _ in parts)), reduce(np.logical_or, (s for _, s in parts))
        case Disjunction(operands) if operands:
            parts = [_asked(operand, step_ns, shape) for operand in operands]
            return reduce(np.logical_and, (a for a, _ in parts)), reduce(np.logical_or, (s for _, s in parts))
        case Globally(start_ns, end_ns, operand):
            inner_always, inner_some = _asked(operand, step_ns, shape)
            first, last = _samples(start_ns, end_ns, step_ns, shape[0])
            return _any_shift(inner_always, first, last), _any_shift(inner_some, first, last)
        case Finally(start_ns, end_ns, operand):
            inner_always, inner_some = _asked(operand, step_ns, shape)
            first, last = _samples(start_ns, end_ns, step_ns, shape[0])
            return _each_shift(inner_always, first, last), _any_shift(inner_some, first, last)
        case Until(start_ns, end_ns, left, right):
            left_always, left_some = _asked(left, step_ns, shape)
            right_always, right_some = _asked(right, step_ns, shape)
            first, last = _samples(start_ns, end_ns, step_ns, shape[0])
            return (
                _any_shift(left_always, 0, first) | _each_shift(right_always, first, last),
                _any_shift(left_some, 0, last) | _any_shift(right_some, first, last),
            )
    return always, some


def _samples(start_ns: int, end_ns: int, step_ns: int, count: int) -> tuple[int, int]:
    """First and last sample of a window, none of them later than what is looked at."""
    return min(-(-start_ns // step_ns), count), min(end_ns // step_ns, count)


def _shifted(asked: BoolArray, first: int, last: int) -> NDArray[np.int64]:
    """At each sample, how many of the shifts from ``first`` to ``last`` samples bring a question there: (K, P)."""
    count = len(asked)
    sums = np.zeros((count + 1, asked.shape[1]), dtype=np.int64)
    np.cumsum(asked, axis=0, out=sums[1:])
    k = np.arange(count)
    return np.subtract(sums[np.clip(k - first + 1, 0, count)], sums[np.clip(k - last, 0, count)])


def _any_shift(asked: BoolArray, first: int, last: int) -> BoolArray:
    return _shifted(asked, first, last) > 0 if first <= last else np.zeros_like(asked)


def _each_shift(asked: BoolArray, first: int, last: int) -> BoolArray:
    return _shifted(asked, first, last) == last - first + 1 if first <= last else np.zeros_like(asked)
