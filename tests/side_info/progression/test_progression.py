"""The tableau against brute force: on the sample grid nothing is lost and nothing is let through."""

from random import Random

import numpy as np
import pytest

from side_info.progression import DEAD, FALSE, TRUE, Grid, Table, frontier
from side_info.stl.nnf import Conjunction, Constant, Disjunction, Finally, Globally, Literal, Normal, Until, reach_ns
from tests.side_info.progression.readings import Bools, accepts, believed, on_grid, plain_steps, random_formula

A, B, C = Literal(0), Literal(1), Literal(2)
STEPS = Grid(step_ns=1)
#: The paper's parking: in the lot, through the gate in time, outside afterwards.
PARKING = Conjunction((Globally(0, 25, A), Finally(0, 25, B), Globally(25, 40, C)))


def add(table: Table, formula: Normal, grid: Grid = STEPS) -> int:
    return table.add(formula, grid, lambda predicate, margin: predicate)


def small_windows(rng: Random) -> tuple[int, int]:
    start = rng.choice((0, 0, 1, 2))
    return start, start + rng.choice((0, 1, 2, 3))


def traces(rng: np.random.Generator, formula: Normal, count: int, predicates: int = 2) -> Bools:
    """Traces that reach as far as the formula, some of them mostly true and some mostly false."""
    share = rng.choice([0.15, 0.5, 0.85], size=(count, 1, predicates))
    drawn: Bools = rng.random((count, reach_ns(formula) + 1, predicates)) < share
    return drawn


@pytest.mark.slow
def test_random_formulas_mean_what_brute_force_says() -> None:
    rng, arrays = Random(1), np.random.default_rng(1)
    pairs = satisfied = 0
    for _ in range(420):
        formula = random_formula(rng, 4, 2, small_windows)
        table = Table(max_alternatives=10**6)
        root = add(table, formula)
        true = traces(arrays, formula, 128)
        expected = on_grid(formula, true)[:, 0]
        for trace, holds in zip(true, expected.tolist(), strict=True):
            assert accepts(table, root, trace) == holds, (formula, trace.tolist())
        pairs += len(true)
        satisfied += int(expected.sum())
    assert pairs > 50_000
    assert 0.2 < satisfied / pairs < 0.8


def test_all_traces_of_small_formulas() -> None:
    rng = Random(2)
    checked = 0
    while checked < 60:
        formula = random_formula(rng, 3, 2, lambda rng: (start := rng.randint(0, 1), start + rng.randint(0, 1)))
        length = reach_ns(formula) + 1
        if length > 5:
            continue
        checked += 1
        bits = np.arange(4**length)[:, None] >> np.arange(2 * length) & 1
        true = bits.astype(bool).reshape(-1, length, 2)
        table = Table()
        root = add(table, formula)
        expected = on_grid(formula, true)[:, 0]
        assert [accepts(table, root, trace) for trace in true] == expected.tolist(), formula


def test_bounds_are_whole_steps_inside_the_window() -> None:
    rng, arrays = Random(3), np.random.default_rng(3)
    for _ in range(150):
        formula = random_formula(rng, 3, 2, lambda rng: (start := rng.randint(0, 25), start + rng.randint(0, 25)))
        table = Table(max_alternatives=10**6)
        root = add(table, formula, Grid(step_ns=10))
        true = arrays.random((16, reach_ns(formula) // 10 + 1, 2)) < arrays.choice([0.3, 0.7, 0.9])
        expected = on_grid(formula, true, step_ns=10)[:, 0]
        assert [accepts(table, root, trace) for trace in true] == expected.tolist(), formula


def test_a_window_without_a_sample() -> None:
    table = Table()
    assert add(table, Globally(1, 9, A), Grid(step_ns=10)) == TRUE
    assert add(table, Finally(1, 9, A), Grid(step_ns=10)) == FALSE
    assert add(table, Until(1, 9, A, B), Grid(step_ns=10)) == FALSE


def test_beliefs_are_the_obligations_of_plain_stepping() -> None:
    rng, arrays = Random(4), np.random.default_rng(4)
    for _ in range(150):
        formula = random_formula(rng, 4, 2, small_windows)
        table = Table(max_alternatives=10**6)
        root = add(table, formula)
        for trace in traces(arrays, formula, 8):
            for obligations, belief in zip(plain_steps(table, root, trace), believed(table, root, trace), strict=True):
                members = table.members(belief)
                assert set(members) <= obligations
                # What is left out is covered by one that is not: nothing is lost, not even later.
                assert (belief == DEAD) == (not obligations - {FALSE})
                assert (TRUE in members) == (TRUE in obligations)


def test_expansion_in_one_go_is_that_of_each() -> None:
    rng, arrays = Random(5), np.random.default_rng(5)
    table = Table()
    roots = [add(table, random_formula(rng, 4, 40, small_windows)) for _ in range(30)]
    roots += [TRUE, FALSE, table.add(Literal(0), STEPS, lambda predicate, margin: 200)]
    for _ in range(4):
        rows = arrays.choice(roots, size=200)
        expansion = table.expand(rows)
        masks = table.masks(expansion.literal_set, 210)
        assert masks.shape == (len(expansion.parent), 210)
        np.testing.assert_array_equal(table.masks(expansion.literal_set, 7), masks[:, :7])
        for row, obligation in enumerate(rows.tolist()):
            block = slice(*expansion.start[row : row + 2])
            assert (expansion.parent[block] == row).all()
            found = [
                (frozenset(np.flatnonzero(mask).tolist()), rest)
                for mask, rest in zip(masks[block], expansion.next[block].tolist(), strict=True)
            ]
            assert found == [(way.literals, way.next) for way in table.alternatives(obligation)]
        roots += expansion.next.tolist()
    assert table.expand(np.zeros(0, dtype=np.int64)).parent.shape == (0,)


def test_alternatives_are_an_antichain() -> None:
    rng = Random(6)
    for _ in range(100):
        table = Table()
        for way_i in (ways := table.alternatives(add(table, random_formula(rng, 4, 3, small_windows)))):
            for way_j in ways:
                if way_i is not way_j:
                    assert not (way_j.literals <= way_i.literals and table.entails(way_i.next, way_j.next))


def test_what_entails_holds_wherever_it_does() -> None:
    rng, arrays = Random(7), np.random.default_rng(7)
    claims = 0
    for _ in range(40):
        formulas = [random_formula(rng, 2, 2, small_windows) for _ in range(25)]
        table = Table()
        roots = [add(table, formula) for formula in formulas]
        length = max(map(reach_ns, formulas)) + 1
        true = arrays.random((200, length, 2)) < arrays.choice([0.2, 0.5, 0.8], size=(200, 1, 1))
        holds = [on_grid(formula, true)[:, 0] for formula in formulas]
        for one, first in zip(roots, holds, strict=True):
            for other, second in zip(roots, holds, strict=True):
                if table.entails(one, other):
                    claims += one != other
                    assert (first <= second).all(), (table.text(one, str), table.text(other, str))
    assert claims > 1000


@pytest.mark.slow
def test_subsumed_alternatives_can_go_at_once() -> None:
    rng, arrays = Random(8), np.random.default_rng(8)
    dropped = 0
    for _ in range(200):
        formula = random_formula(rng, 4, 2, small_windows)
        table = Table()
        root = add(table, formula)
        expansion = table.expand(np.array([root, TRUE, root]))
        pairs = np.stack(table.subsumption(expansion), axis=1)
        assert (expansion.parent[pairs[:, 0]] == expansion.parent[pairs[:, 1]]).all()
        masks = table.masks(expansion.literal_set, 2)
        for surely in ({0}, {1}, {0, 1}):
            # Literals in ``surely`` hold on the whole set: they cut nothing.
            acting = masks & ~np.isin(np.arange(2), list(surely))
            goes = {i for i, j in pairs.tolist() if not (acting[j] & ~masks[i]).any()}
            dropped += len(goes)
            true = traces(arrays, formula, 16)
            true[:, 0, list(surely)] = True
            for trace, holds in zip(true, on_grid(formula, true)[:, 0].tolist(), strict=True):
                kept = [
                    rest
                    for way, rest in enumerate(expansion.next.tolist())
                    if expansion.parent[way] == 0 and way not in goes and (masks[way] <= trace[0]).all()
                ]
                assert any(accepts(table, rest, trace[1:]) for rest in kept) == holds
    assert dropped > 50


def test_conjunction_of_obligations() -> None:
    arrays = np.random.default_rng(9)
    table = Table()
    first, second = add(table, Until(1, 3, A, B)), add(table, Finally(0, 2, A))
    both = table.conjunction([first, second, first])
    assert both == add(table, Conjunction((Until(1, 3, A, B), Finally(0, 2, A))))
    for trace in arrays.random((50, 4, 2)) < 0.6:
        assert accepts(table, both, trace) == (accepts(table, first, trace) and accepts(table, second, trace))


def test_the_parking_formula_stays_small() -> None:
    table = Table()
    root = add(table, PARKING)
    obligations = {root}
    for step in range(41):
        ways = [way for one in obligations for way in table.alternatives(one)]
        assert len(ways) <= 3, step
        obligations = {way.next for way in ways}
        assert len(obligations) <= 2, step
    assert obligations == {TRUE}


def test_the_frontier_of_the_parking_formula() -> None:
    table = Table()
    asked = [tuple(map(set, at_step)) for at_step in frontier(table, add(table, PARKING), 42)]
    assert asked[0] == ({0}, {0, 1})
    assert asked[24] == ({0}, {0, 1})
    assert asked[25] == ({0, 2}, {0, 1, 2})
    assert asked[26] == ({2}, {2})
    assert asked[40] == ({2}, {2})
    assert asked[41] == (set(), set())


@pytest.mark.parametrize(
    ("formula", "same"),
    [
        (Conjunction((Globally(0, 3, A), Globally(0, 5, A))), Globally(0, 5, A)),
        (Conjunction((Globally(0, 3, A), Globally(4, 5, A))), Globally(0, 5, A)),
        (Conjunction((A, Globally(1, 5, A))), Globally(0, 5, A)),
        (Conjunction((Finally(0, 3, A), Finally(0, 5, A))), Finally(0, 3, A)),
        (Disjunction((Finally(0, 3, A), Finally(2, 5, A))), Finally(0, 5, A)),
        (Disjunction((Globally(0, 3, A), Globally(1, 2, A))), Globally(1, 2, A)),
        (Conjunction((A, A, Constant(True))), A),
        (Conjunction((A, Constant(False))), Constant(False)),
        (Disjunction((A, A, Constant(False))), A),
        (Disjunction((A, Constant(True))), Constant(True)),
        (Conjunction((A, Disjunction((A, B)))), A),
        (Disjunction((A, Conjunction((A, B)))), A),
        (Globally(2, 5, Globally(1, 3, A)), Globally(3, 8, A)),
        (Finally(2, 5, Finally(1, 3, A)), Finally(3, 8, A)),
        (Globally(1, 4, Conjunction((A, B))), Conjunction((Globally(1, 4, A), Globally(1, 4, B)))),
        (Until(0, 4, Constant(True), A), Finally(0, 4, A)),
        (Until(0, 0, A, B), Conjunction((A, B))),
        (Conjunction((Finally(0, 4, A), Finally(1, 1, A))), Globally(1, 1, A)),
        (Conjunction(()), Constant(True)),
        (Disjunction(()), Constant(False)),
    ],
)
def test_what_means_the_same_is_the_same(formula: Normal, same: Normal) -> None:
    table = Table()
    assert add(table, formula) == add(table, same)


def test_skipped_samples_may_have_been_anything() -> None:
    rng, arrays = Random(10), np.random.default_rng(10)
    for _ in range(150):
        formula = random_formula(rng, 4, 2, small_windows)
        table = Table(max_alternatives=10**6)
        root = add(table, formula)
        for trace in traces(arrays, formula, 4):
            missing = arrays.random(len(trace)) < 0.4
            belief = table.belief([root])
            for holds, lost in zip(trace, missing.tolist(), strict=True):
                false = frozenset(np.flatnonzero(~holds).tolist())
                belief = table.skip(belief) if lost else table.after(belief, false)
            # Formulas are positive: what was lost can be taken as true.
            possible = on_grid(formula, (trace | missing[:, None])[None])[0, 0]
            assert (belief != DEAD) == possible


def test_many_samples_skipped_at_once() -> None:
    rng = Random(11)
    for _ in range(100):
        table = Table()
        belief = table.belief([add(table, random_formula(rng, 3, 2, small_windows))])
        one_by_one = [belief]
        for _ in range(20):
            one_by_one.append(table.skip(one_by_one[-1]))
        settled = DEAD, table.belief([TRUE])
        for steps, single in enumerate(one_by_one):
            at_once = table.skip(belief, steps)
            assert (at_once in settled) == (single in settled)
            assert at_once == single or at_once not in settled
        assert table.skip(belief, 10**9) in (DEAD, table.belief([TRUE]))
    with pytest.raises(ValueError, match="cannot be skipped"):
        table.skip(belief, -1)


def test_a_belief_asks_for_the_literals_of_its_members() -> None:
    table = Table()
    root = add(table, PARKING)
    belief = table.belief([root, root, FALSE])
    assert table.members(belief) == (root,)
    assert table.literals_of(belief) == {0, 1}
    assert table.after(belief, frozenset({0})) == DEAD
    assert table.after(belief, frozenset({1, 7})) == table.after(belief, frozenset({1}))
    assert table.belief([]) == table.belief([FALSE]) == DEAD
    assert table.members(DEAD) == ()
    assert table.after(DEAD, frozenset()) == DEAD


def test_text() -> None:
    table = Table()
    name = "abc".__getitem__
    assert table.text(add(table, Globally(2, 5, Until(0, 3, A, B))), name) == ("always[2:5]((a until[0:3] (a and b)))")
    assert table.text(add(table, Disjunction((Finally(1, 3, A), Globally(2, 2, B)))), name) == (
        "(eventually[1:3](a) or b@2)"
    )
    assert table.text(TRUE, name) == "true"
    assert table.text(FALSE, name) == "false"


def test_wrong_use_is_refused() -> None:
    with pytest.raises(ValueError, match="alternatives"):
        Table(max_alternatives=0)
    with pytest.raises(ValueError, match="step"):
        Grid(step_ns=0)
    with pytest.raises(ValueError, match="jitter"):
        Grid(step_ns=10, jitter_ns=6)
    with pytest.raises(ValueError, match="lead"):
        Table().add(A, STEPS, lambda predicate, margin: predicate, lead=-1)
    with pytest.raises(ValueError, match="most"):
        Table().cap([TRUE], 0)
    with pytest.raises(TypeError, match="normal form"):
        add(Table(), Normal())
