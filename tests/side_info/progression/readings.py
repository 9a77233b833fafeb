"""Slow, obviously right readings of normal formulas, and random formulas, traces and signals to read."""

from collections.abc import Callable, Sequence
from random import Random

import numpy as np
from numpy.typing import NDArray

from side_info.progression import TRUE, Table
from side_info.stl.nnf import Conjunction, Constant, Disjunction, Finally, Globally, Literal, Normal, Until

Bools = NDArray[np.bool_]

#: Window bounds, start and end, in ns.
Bounds = Callable[[Random], tuple[int, int]]


def random_formula(rng: Random, depth: int, predicates: int, bounds: Bounds) -> Normal:
    """A formula nested to at most ``depth``."""

    def inner() -> Normal:
        return random_formula(rng, depth - 1, predicates, bounds)

    kind = rng.random()
    if depth == 0 or kind < 0.1:
        return Constant(rng.random() < 0.5) if rng.random() < 0.05 else Literal(rng.randrange(predicates))
    if kind < 0.25:
        return Conjunction(tuple(inner() for _ in range(rng.randint(2, 3))))
    if kind < 0.4:
        return Disjunction(tuple(inner() for _ in range(rng.randint(2, 3))))
    start, end = bounds(rng)
    if kind < 0.6:
        return Globally(start, end, inner())
    if kind < 0.8:
        return Finally(start, end, inner())
    return Until(start, end, inner(), inner())


def on_grid(formula: Normal, true: Bools, step_ns: int = 1) -> Bools:
    """(T, N): where a formula holds of T traces, ``true (T, N, predicates)``, a sample every ``step_ns``.

    Samples after the last one are like the last one. So it is right at sample i if N > i + reach.
    """

    def at(values: Bools, steps: int) -> Bools:
        return values[:, np.minimum(np.arange(values.shape[1]) + steps, values.shape[1] - 1)]

    def every(values: list[Bools]) -> Bools:
        found = np.ones(true.shape[:2], dtype=np.bool_)
        for one in values:
            found = found & one
        return found

    def any_of(values: list[Bools]) -> Bools:
        return ~every([~one for one in values])

    def inside(start: int, end: int) -> range:
        return range(-(-start // step_ns), end // step_ns + 1)

    match formula:
        case Constant(value):
            return np.full(true.shape[:2], value)
        case Literal(predicate):
            return np.array(true[:, :, predicate])
        case Conjunction(operands):
            return every([on_grid(operand, true, step_ns) for operand in operands])
        case Disjunction(operands):
            return any_of([on_grid(operand, true, step_ns) for operand in operands])
        case Globally(start, end, operand):
            holds = on_grid(operand, true, step_ns)
            return every([at(holds, k) for k in inside(start, end)])
        case Finally(start, end, operand):
            holds = on_grid(operand, true, step_ns)
            return any_of([at(holds, k) for k in inside(start, end)])
        case Until(start, end, left, right):
            kept, witness = on_grid(left, true, step_ns), on_grid(right, true, step_ns)
            found = np.zeros(true.shape[:2], bool)
            so_far = np.ones(true.shape[:2], bool)
            for k in range(end // step_ns + 1):
                so_far = so_far & at(kept, k)
                if k in inside(start, end):
                    found |= so_far & at(witness, k)
            return found
    raise TypeError(formula)


def at_instant(formula: Normal, stamps: Sequence[int], true: Bools, now: int) -> bool:
    """Whether a formula about samples holds at an instant; ``true (N, predicates)`` at increasing ``stamps`` (N).

    A literal at an instant without a sample is taken as true, the worst case for whoever must not exclude it.
    """

    def later(start: int, end: int) -> list[int]:
        return [t for t in stamps if start <= t - now <= end]

    def holds(operand: Normal, t: int) -> bool:
        return at_instant(operand, stamps, true, t)

    match formula:
        case Constant(value):
            return value
        case Literal(predicate):
            return now not in stamps or bool(true[stamps.index(now), predicate])
        case Conjunction(operands):
            return all(holds(operand, now) for operand in operands)
        case Disjunction(operands):
            return any(holds(operand, now) for operand in operands)
        case Globally(start, end, operand):
            return all(holds(operand, t) for t in later(start, end))
        case Finally(start, end, operand):
            return any(holds(operand, t) for t in later(start, end))
        case Until(start, end, left, right):
            return any(
                holds(right, t) and all(holds(left, before) for before in later(0, t - now)) for t in later(start, end)
            )
    raise TypeError(formula)


def minimal(rng: np.random.Generator, true: Bools, holds: Callable[[Bools], Bools]) -> Bools:
    """Traces ``true (T, N, predicates)`` with hardly more true than ``holds`` (T traces to T) needs, where it held.

    Formulas in normal form are positive, so these are what an obligation that asks for too much fails on.
    """
    size = true[0].size
    order = rng.permuted(np.tile(np.arange(size), (len(true), 1)), axis=1)
    for entries in np.array_split(order, size // 2 + 1, axis=1):
        fewer = true.copy()
        np.put_along_axis(fewer.reshape(len(true), -1), entries, False, axis=1)
        true = np.where(holds(fewer)[:, None, None], fewer, true)
    return true


def plain_steps(table: Table, obligation: int, true: Bools) -> list[set[int]]:
    """Obligations left after each sample of a trace, ``true (N, literals)``, one branch an alternative."""
    left = [{obligation}]
    for holds in true:
        ways = [way for one in left[-1] for way in table.alternatives(one)]
        left.append({way.next for way in ways if all(holds[literal] for literal in way.literals)})
    return left


def believed(table: Table, obligation: int, true: Bools) -> list[int]:
    """Beliefs after each sample of a trace, ``true (N, literals)``."""
    beliefs = [table.belief([obligation])]
    for holds in true:
        beliefs.append(table.after(beliefs[-1], frozenset(np.flatnonzero(~holds).tolist())))
    return beliefs


def accepts(table: Table, obligation: int, true: Bools) -> bool:
    """Whether a trace that is as long as the obligation reaches fulfils it."""
    return TRUE in table.members(believed(table, obligation, true)[-1])
