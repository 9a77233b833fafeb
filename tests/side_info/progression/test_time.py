"""Slack, jitter and continuous meaning: whatever a formula allows in real time stays allowed on the samples."""

from functools import partial
from random import Random

import numpy as np
import pytest
from numpy.typing import NDArray

from side_info.progression import Grid, Table
from side_info.stl.nnf import Conjunction, Disjunction, Finally, Globally, Literal, Normal, Until, reach_ns
from tests.side_info.progression.readings import Bools, Bounds, accepts, at_instant, minimal, on_grid, random_formula

A, B = Literal(0), Literal(1)
STEP = 20


def windows(rng: Random) -> tuple[int, int]:
    start = rng.choice((0, 0, rng.randint(0, 50)))
    return start, start + rng.choice((0, rng.randint(0, 70)))


def sampled(formula: Normal, grid: Grid, lead: int = 0) -> tuple[Table, int]:
    table = Table(max_alternatives=10**6)
    return table, table.add(formula, grid, lambda predicate, margin: predicate, lead=lead)


def text(formula: Normal, grid: Grid, lead: int = 0) -> str:
    table, root = sampled(formula, grid, lead)
    return table.text(root, "ab".__getitem__)


def fulfilled_from(formula: Normal, start: int, true: Bools) -> Bools:
    return on_grid(formula, true[:, start:])[:, 0]


def fulfilled_at_instant(formula: Normal, stamps: list[int], now: int, true: Bools) -> Bools:
    return np.array([at_instant(formula, stamps, one, now) for one in true])


def test_windows_with_slack_of_time_zero() -> None:
    slack = Grid(step_ns=10, slack_ns=4)
    assert text(Globally(0, 30, A), slack) == "always[1:2](a)"
    assert text(Globally(0, 7, A), slack) == "true"
    assert text(Finally(10, 30, A), slack) == "eventually[1:3](a)"
    assert text(Finally(12, 38, A), slack) == "eventually[1:4](a)"
    assert text(Finally(0, 30, Globally(0, 30, A)), slack) == "eventually[0:3](always[0:3](a))"
    assert text(Until(0, 30, A, B), slack) == "((a and b) or (a until[0:2] (a and b))@1)"
    assert text(A, slack) == "true"
    assert text(A, Grid(step_ns=10)) == "a"


def test_windows_of_samples_that_jitter() -> None:
    jitter = Grid(step_ns=10, jitter_ns=5)
    assert text(Globally(0, 30, A), jitter) == "always[1:2](a)"
    # Read at a sample, a window from 0 on has that sample in it.
    assert text(Finally(0, 30, Globally(0, 30, A)), jitter) == "eventually[0:4](always[0:2](a))"
    assert text(Finally(0, 30, Globally(10, 30, A)), jitter) == "eventually[2:6](a)"
    assert text(Globally(0, 30, Finally(10, 30, A)), jitter) == "always[1:2](eventually[0:5](a))"


def test_windows_of_continuous_time() -> None:
    asked: list[tuple[int, int]] = []

    def literal(predicate: int, margin: int) -> int:
        asked.append((predicate, margin))
        return len(asked) - 1

    table = Table()
    grid = Grid(step_ns=10, slack_ns=4, continuous=True)
    root = table.add(Conjunction((A, Globally(0, 30, A), Finally(10, 30, B))), grid, literal)
    assert asked == [(0, 4), (0, 0), (1, 5)]
    assert table.text(root, str) == "(0 and always[1:2](1) and eventually[1:3](2))"
    asked.clear()
    root = table.add(Until(0, 30, A, B), Grid(step_ns=11, continuous=True, jitter_ns=2), literal)
    assert asked == [(0, 0), (1, 8)]


@pytest.mark.slow
def test_nothing_is_lost_by_slack_and_jitter() -> None:
    """A formula about samples, true at a time zero off the grid, of stamps off the grid by up to half a step."""
    rng, arrays = Random(1), np.random.default_rng(1)
    fulfilled = lost_as_if_on_time = 0
    for _ in range(1600):
        formula = random_formula(rng, 3, 2, windows)
        grid = Grid(STEP, slack_ns=rng.choice((0, 7, 20, 45)), jitter_ns=rng.choice((0, 3, 9, 10)))
        table, root = sampled(formula, grid, grid.lead)
        punctual, as_if_on_time = sampled(formula, Grid(STEP), grid.lead)
        count = grid.lead + (reach_ns(formula) + 90) // STEP
        # Two samples never have one stamp: half a step late is one less.
        jitter = arrays.choice([-grid.jitter_ns, min(grid.jitter_ns, STEP // 2 - 1)], count)
        stamps = (np.arange(-grid.lead, count - grid.lead) * STEP + jitter).tolist()
        zero = int(arrays.integers(-grid.slack_ns, grid.slack_ns, endpoint=True))

        holds = partial(fulfilled_at_instant, formula, stamps, zero)
        true = minimal(arrays, np.ones((1, count, 2), dtype=bool), holds)
        if holds(true)[0]:
            fulfilled += 1
            lost_as_if_on_time += not accepts(punctual, as_if_on_time, true[0])
            assert accepts(table, root, true[0]), (formula, grid, stamps, zero, true.tolist())
    assert fulfilled > 500
    # Without the weakening it would not be so: the test can fail.
    assert lost_as_if_on_time > 100


def test_a_witness_before_grid_index_zero_needs_the_lead() -> None:
    grid = Grid(STEP, slack_ns=STEP)
    assert grid.lead == 1
    table, root = sampled(Finally(0, 100, A), grid, grid.lead)
    seen_early = np.array([[True]] + [[False]] * 7)
    assert at_instant(Finally(0, 100, A), [STEP * k for k in range(-1, 7)], seen_early, -STEP)
    assert accepts(table, root, seen_early)
    assert Grid(STEP).lead == Grid(STEP, slack_ns=STEP - 1).lead == 0
    assert [Grid(STEP, slack_ns=s, continuous=True).lead for s in (0, 10, 11, 30, 31)] == [0, 0, 1, 1, 2]


def near(true: Bools, at: NDArray[np.int64], literals: list[tuple[int, int]]) -> Bools:
    """(N, literals): whether a signal, ``true (instants, predicates)``, is so within margins of instants ``at``."""
    return np.array([[true[max(i - m, 0) : i + m + 1, p].any() for p, m in literals] for i in at.tolist()], dtype=bool)


def nested(rng: Random, bounds: Bounds) -> Normal:
    """A temporal operator on another one, or on that or a predicate: windows that are read at samples."""

    def temporal(operand: Normal, other: Normal) -> Normal:
        start, end = bounds(rng)
        return rng.choice(
            (
                Globally(start, end, operand),
                Finally(start, end, operand),
                Until(start, end, operand, other),
                Until(start, end, other, operand),
            )
        )

    inner = temporal(rng.choice((A, B)), rng.choice((A, B)))
    return temporal(rng.choice((inner, Disjunction((rng.choice((A, B)), inner)))), rng.choice((A, B)))


def excused(rng: Random, bounds: Bounds) -> Normal:
    """Always: a predicate, or else another one throughout a window from then on."""
    return Globally(*bounds(rng), Disjunction((A, Globally(*bounds(rng), B))))


def few_instants(rng: Random) -> tuple[int, int]:
    start = rng.choice((0, rng.randint(0, 9)))
    return start, start + rng.choice((0, rng.randint(0, 12)))


@pytest.mark.slow
def test_nothing_is_lost_between_samples() -> None:
    """A formula about instants: its samples allow what is true of a signal.

    A literal with a margin is what the signal is within that time of the sample: the worst that motion can do.
    """
    rng, arrays = Random(2), np.random.default_rng(2)
    fulfilled = lost_as_if_sampled = lost_without_margin = 0
    for _ in range(350):
        make = rng.choice((nested, excused, partial(random_formula, depth=3, predicates=2)))
        formula = make(rng, bounds=few_instants)
        grid = Grid(rng.choice((4, 5)), rng.choice((0, 0, 1, 7)), continuous=True, jitter_ns=rng.choice((0, 1, 2, 2)))
        literals: list[tuple[int, int]] = []

        def literal(predicate: int, margin: int, literals: list[tuple[int, int]] = literals) -> int:
            literals.append((predicate, margin))
            return len(literals) - 1

        table = Table(max_alternatives=10**6)
        root = table.add(formula, grid, literal, lead=grid.lead)
        simple, as_if_sampled = sampled(formula, Grid(grid.step_ns), grid.lead)

        steps = (reach_ns(formula) + grid.slack_ns) // grid.step_ns + 4
        origin = grid.lead * grid.step_ns + grid.slack_ns + grid.jitter_ns
        zero = origin + int(arrays.choice([-grid.slack_ns, grid.slack_ns]))

        holds = partial(fulfilled_from, formula, zero)
        signals = minimal(arrays, np.ones((8, origin + (steps + 2) * grid.step_ns, 2), dtype=bool), holds)
        for true in signals[holds(signals)]:
            fulfilled += 1
            jitter = arrays.choice([-grid.jitter_ns, grid.jitter_ns], steps + grid.lead)
            at = origin + np.arange(-grid.lead, steps) * grid.step_ns + jitter
            assert accepts(table, root, near(true, at, literals)), (formula, grid)
            lost_without_margin += not accepts(table, root, near(true, at, [(p, 0) for p, _ in literals]))
            lost_as_if_sampled += not accepts(simple, as_if_sampled, true[at])
    assert fulfilled > 1000
    # Both the margins and the windows matter: the test can fail.
    assert lost_as_if_sampled > 100
    assert lost_without_margin > 100
