"""Branches: what may or may not have happened is kept apart, and together it is an outer bound."""

import numpy as np
import pytest

from reach_server.data.input_sets import InputSets
from reach_server.numeric.types import FloatArray
from reach_server.sets.raw import RawSets
from reach_server.side_information.scenarios import MOST_BRANCHES
from reach_server.tube.branching import Tube, united
from reach_server.tube.recursion import Recursion
from side_info import Scenario
from tests.reach_server.drives import SVEA, World, inside, noise
from tests.reach_server.tube.trajectories import Side, tube_of, world_model, world_truth

WORLD = World()
STEPS = 6
MS = round(SVEA.dt * 1000)
START = np.array([0.1, -0.1])
HALF = 0.4 * np.eye(2)


def cut(formula: str, cuts: str = "zonotope") -> tuple[Tube, Side]:
    """The tube of one vehicle from a box around ``START``; windows of the formula as ``[a:b]`` in steps."""
    text = f"scenario: s\nversion: 1\nstate: {{x1: m, x2: m}}\ntime: {{zero: on_start}}\nassume: '{formula}'\n"
    side = Side(Scenario.parse(text), WORLD.profile)
    return tube_of(RawSets.zonotope(START[None], HALF[None]), motion(), side, cuts), side  # type: ignore[arg-type]


def motion() -> Recursion:
    inputs = InputSets(np.zeros((1, 1, 1)), np.zeros((1, STEPS, 1)), np.full((1, STEPS, 1), 0.2))
    return Recursion(inputs, world_model(1), WORLD.process, WORLD.layout)


def trajectories(count: int = 20_000) -> FloatArray:
    rng = np.random.default_rng(1)
    u = rng.uniform(-0.2, 0.2, (count, STEPS, 1))
    return world_truth(rng, START + noise(rng, HALF, count), u, np.zeros((1, 1)))


def window(first: int, last: int) -> str:
    return f"[{first * MS} ms:{last * MS} ms]"


def assert_holds(tube: Tube, truth: FloatArray) -> None:
    rng = np.random.default_rng(0)
    assert len(truth) > 100
    for k, step in enumerate(tube.steps):
        held = np.any([inside(step.sets, row, truth[:, k], rng) for row in range(len(step.track))], axis=0)
        assert held.all(), (k, int((~held).sum()))
        assert inside(united(step, [0]), 0, truth[:, k], rng).all()


def highest(tube: Tube, k: int) -> float:
    """Upper bound of x1 over all branches of a step."""
    sets = tube.steps[k].sets
    return float((sets.center[:, 0] + np.abs(sets.generators[:, 0]).sum(axis=1)).max())


@pytest.mark.parametrize("cuts", ["zonotope", "constrained", "frobenius"])
def test_a_witness_that_may_have_been_leaves_both_ways_open(cuts: str) -> None:
    tube, _ = cut(f"eventually{window(0, 4)}(x1 <= -0.1)", cuts)
    free, _ = cut("x1 <= 100", cuts)
    truth = trajectories()
    seen = (truth[:, :5, 0] <= -0.1).any(axis=1)
    assert_holds(tube, truth[seen])
    counts = [len(step.track) for step in tube.steps]
    assert counts[:4] == [2] * 4
    assert counts[4:] == [1] * 3
    # As long as the witness may still come nothing is cut; at the end of the window it must have come.
    assert highest(tube, 3) >= highest(free, 3) * (1 - 1e-9)
    if cuts == "zonotope":
        assert highest(tube, 3) == pytest.approx(highest(free, 3))
        assert highest(tube, 6) < highest(free, 6)


def test_what_surely_happened_leaves_one_way() -> None:
    tube, _ = cut(f"eventually{window(0, 4)}(x1 <= 5) and always{window(5, 6)}(x2 <= 0.1)")
    assert [len(step.track) for step in tube.steps] == [1] * 7
    assert tube.active[0, 5:].any()


def test_alternatives_are_followed_apart() -> None:
    formula = f"always{window(1, 6)}(x1 >= 0.2) or always{window(1, 6)}(x1 <= -0.2)"
    tube, side = cut(formula)
    assert [len(step.track) for step in tube.steps] == [1] + [2] * 5 + [1]
    low, high = sorted(
        (float(c - g), float(c + g))
        for c, g in zip(
            tube.steps[4].sets.center[:, 0], np.abs(tube.steps[4].sets.generators[:, 0]).sum(axis=1), strict=True
        )
    )
    assert low[1] < high[0]
    assert low[1] <= -0.2 + 1e-9
    assert high[0] >= 0.2 - 1e-9
    truth = trajectories()
    one = (truth[:, 1:, 0] >= 0.2).all(axis=1) | (truth[:, 1:, 0] <= -0.2).all(axis=1)
    assert_holds(tube, truth[one])
    assert set(map(side.literals.name, range(side.literals.count))) == {"x1 >= 0.2", "x1 <= -0.2"}


def test_an_alternative_that_cannot_be_is_dropped() -> None:
    tube, _ = cut(f"always{window(1, 6)}(x1 >= 0.2) or always{window(2, 6)}(x1 <= -20)")
    assert [len(step.track) for step in tube.steps] == [1, 2, 1, 1, 1, 1, 1]


def test_many_alternatives_are_capped_and_hold() -> None:
    thresholds = [-0.3, -0.2, -0.1, 0.0, 0.1]
    parts = [f"eventually{window(0, 5)}({axis} <= {t})" for t in thresholds for axis in ("x1", "x2")]
    tube, _ = cut(" and ".join(parts))
    assert max(len(step.track) for step in tube.steps) == MOST_BRANCHES
    truth = trajectories()
    obeys = np.ones(len(truth), dtype=bool)
    for axis in (0, 1):
        for t in thresholds:
            obeys &= (truth[:, :6, axis] <= t).any(axis=1)
    assert_holds(tube, truth[obeys])


def test_branches_of_equal_obligation_are_one_around_both() -> None:
    tube, _ = cut(f"always{window(0, 6)}(x1 >= 0.1 or x2 >= 0.1)")
    assert [len(step.track) for step in tube.steps] == [1] * 7
    truth = trajectories()
    assert_holds(tube, truth[((truth[..., 0] >= 0.1) | (truth[..., 1] >= 0.1)).all(axis=1)])
