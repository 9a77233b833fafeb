"""Samples that nothing is known of, many at once: as one by one."""

from random import Random

import numpy as np
import pytest

from side_info.progression import DEAD, TRUE, Grid, Table
from side_info.stl.nnf import Conjunction, Disjunction, Finally, Globally, Literal, Until, reach_ns
from tests.side_info.progression.readings import random_formula


def windows(rng: Random) -> tuple[int, int]:
    start = rng.randint(0, 3)
    return start, start + rng.randint(0, 6)


def numbered(predicate: int, _: int) -> int:
    return predicate


@pytest.mark.slow
def test_many_steps_at_once_are_many_single_steps() -> None:
    rng, arrays = Random(5), np.random.default_rng(5)
    compared = told_apart = 0
    for _ in range(600):
        formula = random_formula(rng, 3, 2, windows)
        table = Table(max_alternatives=10_000)
        root = table.belief([table.add(formula, Grid(1), numbered)])
        steps = rng.randint(2, reach_ns(formula) + 3)
        single = root
        for _ in range(steps):
            single = table.after(single, frozenset())
        both = [table.skip(root, steps), single]
        for true in arrays.random((12, reach_ns(formula) + 2, 2)) < rng.choice((0.3, 0.6, 0.9)):
            beliefs = list(both)
            for sample in true:
                false = frozenset(np.flatnonzero(~sample).tolist())
                beliefs = [table.after(belief, false) for belief in beliefs]
            compared += 1
            told_apart += beliefs[0] == DEAD
            assert (beliefs[0] == DEAD) == (beliefs[1] == DEAD), (formula, steps)
    assert compared > 5000
    assert told_apart > 500


def test_a_million_steps_cost_no_more_than_a_few() -> None:
    million = 10**6
    p, q = Literal(0), Literal(1)
    formulas = (
        Globally(0, 2 * million, p),
        Globally(0, 2 * million, Finally(0, 100, q)),
        Conjunction((Globally(0, 2 * million, Disjunction((p, Until(0, 50, p, q)))), Finally(million, 2 * million, q))),
        Until(0, 2 * million, Finally(0, 3000, p), Globally(0, 3000, q)),
    )
    for formula in formulas:
        table = Table()
        root = table.belief([table.add(formula, Grid(1), numbered)])
        for steps in (million, million + 1, 2 * million, 5 * million):
            left = table.skip(root, steps)
        assert left == table.belief([TRUE])
        assert len(table) < 3000
