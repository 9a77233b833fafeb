"""Fewer and weaker obligations: what was allowed stays so, and numbers stay bounded."""

from random import Random

import numpy as np
import pytest

from side_info.progression import DEAD, FALSE, TRUE, Grid, Table, frontier
from side_info.stl.nnf import Conjunction, Disjunction, Finally, Globally, Literal, Normal, Until, reach_ns
from tests.side_info.progression.readings import accepts, believed, on_grid, plain_steps, random_formula

A, B, C = Literal(0), Literal(1), Literal(2)


def add(table: Table, formula: Normal) -> int:
    return table.add(formula, Grid(step_ns=1), lambda predicate, margin: predicate)


def errands(count: int) -> Normal:
    """Many things that have to happen, in any order."""
    return Conjunction(tuple(Finally(0, 20, Literal(i)) for i in range(count)))


def test_six_independent_errands_are_exact() -> None:
    table = Table()
    ways = table.alternatives(add(table, errands(6)))
    assert len(ways) == 64
    assert {way.literals for way in ways} == {frozenset(i for i in range(6) if n >> i & 1) for n in range(64)}


@pytest.mark.parametrize("most", [1, 2, 5, 64])
def test_thirty_independent_errands_are_weakened(most: int) -> None:
    table = Table(max_alternatives=most)
    root = add(table, errands(30))
    assert len(table.alternatives(root)) <= most
    # What leaves no choice is kept in any case.
    watched = table.alternatives(add(table, Conjunction((errands(30), Globally(0, 20, C)))))
    assert all(2 in way.literals for way in watched)
    rng = np.random.default_rng(0)
    true = rng.random((21, 30)) < 0.05
    true[rng.integers(0, 21, 30), np.arange(30)] = True
    assert accepts(table, root, true)
    if most == 64:
        assert not accepts(table, root, np.zeros((21, 30), dtype=bool))


@pytest.mark.slow
def test_few_alternatives_lose_nothing() -> None:
    rng, arrays = Random(1), np.random.default_rng(1)
    fulfilled = let_through = 0
    for _ in range(300):
        formula = random_formula(rng, 4, 3, lambda rng: (start := rng.randint(0, 2), start + rng.randint(0, 3)))
        table = Table(max_alternatives=rng.choice((1, 2, 3)))
        root = add(table, formula)
        true = arrays.random((24, reach_ns(formula) + 1, 3)) < arrays.choice([0.3, 0.6, 0.85], size=(24, 1, 1))
        for trace, holds in zip(true, on_grid(formula, true)[:, 0].tolist(), strict=True):
            beliefs = believed(table, root, trace)
            for belief in beliefs:
                members = table.members(belief)
                assert len(members) <= table.max_alternatives
                assert all(len(table.alternatives(one)) <= table.max_alternatives for one in members)
            assert not holds or table.members(beliefs[-1]) == (TRUE,)
            fulfilled += holds
            let_through += not holds and beliefs[-1] != DEAD
    assert fulfilled > 1000
    # Weakening was needed, and the rest still refuses most of what is wrong.
    assert 100 < let_through < 3000


@pytest.mark.slow
def test_capped_obligations_are_weaker_and_few() -> None:
    rng, arrays = Random(2), np.random.default_rng(2)
    for _ in range(60):
        formulas = [random_formula(rng, 2, 2, lambda rng: (start := rng.randint(0, 2), start + 2)) for _ in range(9)]
        formulas = [Conjunction((one, rng.choice(formulas), Globally(0, 3, A))) for one in formulas]
        table = Table()
        roots = [add(table, formula) for formula in formulas]
        most = rng.randint(1, 6)
        weaker = table.cap(roots, most)
        assert table.cap(roots[::-1], most) == weaker
        assert set(weaker) == set(roots)
        assert len(set(weaker.values())) <= most
        length = max(map(reach_ns, formulas)) + 1
        true = arrays.random((60, length, 2)) < 0.8
        for root in set(roots):
            assert table.entails(root, weaker[root])
            for trace in true:
                assert not accepts(table, root, trace) or accepts(table, weaker[root], trace)


def test_what_is_common_is_kept() -> None:
    table = Table()
    lot, gate = Globally(0, 5, A), Finally(0, 5, B)
    both, one = add(table, Conjunction((lot, gate))), add(table, lot)
    late = add(table, Conjunction((lot, Finally(0, 3, B), Finally(0, 2, C))))
    assert table.cap([both, one, late], 3) == {both: both, one: one, late: late}
    # Those that differ least become one.
    assert table.cap([both, one, late], 2) == {both: one, one: one, late: late}
    assert table.cap([both, late], 1) == {both: both, late: both}
    either = add(table, Disjunction((Conjunction((lot, B)), Conjunction((lot, C)))))
    assert table.cap([either, both], 1) == {either: one, both: one}
    assert table.cap([FALSE, one], 1) == {FALSE: one, one: one}
    assert table.cap([TRUE, one], 1) == {TRUE: TRUE, one: TRUE}
    assert table.cap([one, one], 1) == {one: one}
    assert table.cap([], 1) == {}


def test_an_antichain_keeps_the_weakest() -> None:
    table = Table()
    always, until, eventually = (
        add(table, Globally(0, 5, A)),
        add(table, Until(0, 5, A, B)),
        add(table, Finally(0, 5, A)),
    )
    assert table.antichain([always, eventually, eventually]) == (eventually,)
    assert table.antichain([until, always]) == tuple(sorted((until, always)))
    assert table.antichain([until, TRUE, FALSE]) == (TRUE,)
    assert table.antichain([]) == ()
    assert table.entails(until, eventually)
    assert not table.entails(eventually, until)


def test_nested_formulas_stay_small() -> None:
    reply = Globally(0, 20, Disjunction((A, Finally(0, 5, B))))
    chain = Until(0, 20, A, Until(0, 20, B, Conjunction((C, Globally(0, 20, C)))))
    for formula in (Globally(0, 20, Finally(0, 5, A)), Finally(0, 20, Globally(0, 5, A)), reply, chain):
        table = Table()
        obligations = {add(table, formula)}
        for _ in range(reach_ns(formula) + 1):
            ways = [way for one in obligations for way in table.alternatives(one)]
            obligations = {way.next for way in ways}
            assert len(obligations) <= 42, formula
        assert obligations == {TRUE}


def test_a_frontier_of_many_errands_is_bounded() -> None:
    table = Table(max_alternatives=16)
    asked = frontier(table, add(table, Conjunction((errands(12), Globally(0, 20, Literal(12))))), 22)
    assert all(12 in always for always, _ in asked[:21])
    assert asked[21] == (frozenset(), frozenset())
    assert len(table) < 5000


def test_weakened_steps_are_those_of_the_table() -> None:
    table = Table(max_alternatives=4)
    root = add(table, errands(5))
    left = plain_steps(table, root, np.ones((21, 5), dtype=bool))
    assert all(len(table.alternatives(one)) <= 4 for obligations in left for one in obligations)
    assert TRUE in left[-1]
