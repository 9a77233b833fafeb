"""The paper's functions, the scenarios made of them, and those that ship."""

from dataclasses import replace

import numpy as np
import pytest

from fleet_lab.paper import cuts
from fleet_lab.paper.drives import SAMPLE_TIME, Track, satisfies
from fleet_lab.paper.formulas import FORMULAS, PHI_P, PHI_R, PHI_THETA, Disc, Formula, Strip, active
from fleet_lab.paper.study import Study
from reach_server.numeric.types import FloatArray
from side_info import Scenario
from side_info.stl.nnf import Conjunction, Globally, Literal, Normal
from tests.fleet_lab.paper import plane
from tests.side_info.pointwise import holds, margins

NOTHING = np.zeros((2, 0))


def windows(formula: Normal) -> list[tuple[float, float, int]]:
    """(start s, end s, predicate) of a conjunction of windows."""
    match formula:
        case Conjunction(operands):
            return [window for operand in operands for window in windows(operand)]
        case Globally(start, end, Literal(predicate)):
            return [(start / 1e9, end / 1e9, predicate)]
        case Globally(start, end, Conjunction(operands)):
            return [window for operand in operands for window in windows(Globally(start, end, operand))]
    raise TypeError(formula)


def asked(scenario: Scenario, t: FloatArray, position: FloatArray) -> FloatArray:
    """Least margin (K,) of the predicates that do not look back and whose window holds ``t`` (K,)."""
    states = {"x1": position[:, 0], "x2": position[:, 1], "yaw": np.zeros(len(t)), "t": t}
    found = np.full(len(t), np.inf)
    for start, end, number in windows(scenario.side_information):
        predicate = scenario.predicates[number]
        if predicate.name.startswith(("left", "right", "h6", "h7")):
            continue
        on = (t >= start) & (t <= end)
        found = np.where(on, np.minimum(found, margins(predicate, states)), found)
    return found


def moments(formula: Formula) -> tuple[FloatArray, FloatArray]:
    """Times (K,), ends of windows and those beside among them, and positions (K, 2)."""
    rng = np.random.default_rng(0)
    ends = {end for part in formula.parts for end in (part.start, part.end)}
    exact = [end + shift for end in ends for shift in (-0.001, 0.0, 0.001)]
    t = np.concatenate([np.repeat(exact, 20), rng.uniform(0, formula.duration + 5, 2000)])
    return t, rng.uniform([-3, -3.5], [3, 4], (len(t), 2))


def test_the_functions_are_those_of_the_paper() -> None:
    x = np.array([[0.4, -1.1]])
    x1, x2 = x[0]
    values = {
        1.0: min(1.7175 - abs(x1 - 0.2805), 2.429 - abs(x2 - 0.839)),
        24.5: min(
            1.7175 - abs(x1 - 0.2805), 2.429 - abs(x2 - 0.839), 1.3045 - abs(x1 + 0.3225), 0.453 - abs(x2 + 1.137)
        ),
        30.0: 1 - abs(x2 + 1.665),
        40.1: np.inf,
    }
    for t, value in values.items():
        assert PHI_P.clearance(np.array([t]), x)[0] == pytest.approx(value)
        assert PHI_THETA.clearance(np.array([t]), x)[0] == pytest.approx(value)
    of_the_ring = {
        3.0: 1 - abs(x2 - 2.25),
        4.0: min(1 - abs(x2 - 2.25), 1.429 - np.hypot(x1 - 0.307, x2 - 0.044)),
        7.0: 1.429 - np.hypot(x1 - 0.307, x2 - 0.044),
        12.0: 1 - abs(x2 + 2.169),
        14.1: np.inf,
    }
    for t, value in of_the_ring.items():
        assert PHI_R.clearance(np.array([t]), x)[0] == pytest.approx(value)
    assert [formula.duration for formula in FORMULAS] == [40.0, 40.0, 14.0]
    assert [formula.motion is not None for formula in FORMULAS] == [False, True, False]


@pytest.mark.parametrize("part", [PHI_P.strips[2], PHI_R.discs[0]])
def test_windows_hold_their_ends_up_to_rounding(part: Strip | Disc) -> None:
    start, end = part.start, part.end
    t = np.array([start - 1e-6, start - 1e-12, start, end, end + 1e-12, end + 1e-6])
    np.testing.assert_array_equal(active(part, t), [False, True, True, True, True, False])
    # Samples are counted, not added up: each end is one.
    samples = SAMPLE_TIME * np.arange(4001.0)
    assert active(part, samples).sum() == round((end - start) / SAMPLE_TIME) + 1


@pytest.mark.parametrize("formula", FORMULAS, ids=lambda formula: formula.key)
def test_the_scenario_of_a_formula_says_the_same(formula: Formula) -> None:
    scenario = Scenario.parse(formula.document())
    assert scenario.name == formula.key.replace("_", "-")
    t, position = moments(formula)
    mine, theirs = formula.clearance(t, position), asked(scenario, t, position)
    np.testing.assert_allclose(mine, theirs, atol=1e-12)
    assert 100 < (mine >= 0).sum() < len(t) - 100
    ends = {(part.start, part.end) for part in formula.parts}
    if formula.motion is not None:
        ends |= {(0.0, 40.0)}
    assert {window[:2] for window in windows(scenario.side_information)} == ends


@pytest.mark.parametrize(("name", "formula"), [("parking-lot-paper", PHI_P), ("roundabout-paper", PHI_R),
                                               ("parking-lot-motion-paper", PHI_THETA)])  # fmt: skip
def test_the_scenarios_that_ship_have_the_same_numbers(name: str, formula: Formula) -> None:
    scenario = Scenario.load(name)
    t, position = moments(formula)
    np.testing.assert_allclose(formula.clearance(t, position), asked(scenario, t, position), atol=1e-12)
    shipped = {window[:2] for window in windows(scenario.side_information)}
    assert shipped == {window[:2] for window in windows(Scenario.parse(formula.document()).side_information)}


def steps(count: int) -> tuple[cuts.Situation, FloatArray]:
    """Last poses and what came next, most of it in or near T(x)."""
    rng = np.random.default_rng(1)
    heading, last = rng.uniform(-np.pi, np.pi, count), rng.uniform(-2, 2, (count, 2))
    direction = heading + rng.uniform(-0.6, 0.6, count)
    moved = rng.uniform(-0.1, 0.7, (count, 1)) * np.column_stack([np.cos(direction), np.sin(direction)])
    return cuts.Situation(np.full(count, 5.0), last, heading, NOTHING), last + moved


def least(scenario: Scenario, prefixes: tuple[str, str], at: cuts.Situation, after: FloatArray) -> FloatArray:
    """Least margin (S,) of the predicates of T(x)."""
    count = len(after)
    states = {
        "x1": np.concatenate([at.last[:, 0], after[:, 0]]),
        "x2": np.concatenate([at.last[:, 1], after[:, 1]]),
        "yaw": np.concatenate([at.heading, at.heading]),
        "t": np.concatenate([at.t, at.t + SAMPLE_TIME]),
    }
    found = [margins(p, states, count) for p in scenario.predicates if p.name.startswith(prefixes)]
    assert len(found) == 4
    return np.asarray(np.min(found, axis=0))


def test_the_scenario_of_the_motion_region_is_its_parallelogram() -> None:
    from shapely import Point

    at, after = steps(400)
    assert PHI_THETA.motion is not None
    found = least(Scenario.parse(PHI_THETA.document()), ("left", "right"), at, after)
    rows = list(cuts._motion(PHI_THETA.motion, at))
    inside = np.all([row.holds(after) for row in rows], axis=0)
    for k in range(len(after)):
        region = plane.motion_region(PHI_THETA.motion, at.last[k], float(at.heading[k]))
        if region.exterior.distance(Point(after[k])) > 1e-9:
            assert region.contains(Point(after[k])) == (found[k] >= 0.0) == inside[k]
    assert 0.2 < inside.mean() < 0.8


def test_the_shipped_scenario_of_the_printed_motion_region_has_the_printed_rows() -> None:
    at, after = steps(400)
    assert PHI_THETA.motion is not None
    found = least(Scenario.load("parking-lot-motion-paper"), ("h6", "h7"), at, after)
    rows = cuts.motion_as_printed(PHI_THETA.motion, at)
    margin = np.min([row.radius - np.abs((row.normal * after).sum(axis=1) - row.middle) for row in rows], axis=0)
    size = 1.0 + np.max([np.abs(row.normal).sum(axis=1) for row in rows], axis=0)
    np.testing.assert_allclose(found / size, margin / size, atol=1e-9)
    assert 0 < (margin >= 0).sum() < len(after)


def test_drives_satisfy_the_scenarios_of_their_formulas(study: Study) -> None:
    for formula in FORMULAS:
        scenario = Scenario.parse(formula.document())
        track = study.tracks(formula)[0]
        states = {"x1": track.position[:, 0], "x2": track.position[:, 1], "yaw": track.heading, "t": track.t}
        # T(x) is about the next sample; windows begin with the state that is predicted first.
        lag = 0 if formula.motion is None else 1
        assert holds(scenario.side_information, scenario.predicates, states, 10_000_000, lag)[0]
        assert satisfies(formula, track)


@pytest.mark.parametrize(("size", "stretch"), [(1.0, 1.0), (2.5, 0.35), (6.0, 0.08)])
@pytest.mark.parametrize("formula", FORMULAS, ids=lambda formula: formula.key)
def test_a_formula_laid_over_a_drive_is_scaled(formula: Formula, size: float, stretch: float) -> None:
    laid = formula.laid_over(size, stretch)
    assert laid.duration == pytest.approx(stretch * formula.duration)
    assert laid.motion == formula.motion
    assert [part.name for part in laid.parts] == [part.name for part in formula.parts]
    rng = np.random.default_rng(2)
    t, position = rng.uniform(0, formula.duration + 1, 500), rng.uniform(-3, 3, (500, 2))
    scaled = laid.clearance(t * stretch, position * size)
    np.testing.assert_allclose(scaled, size * formula.clearance(t, position), atol=1e-9)
    scenario = Scenario.parse(laid.document())
    np.testing.assert_allclose(asked(scenario, t * stretch, position * size), scaled, atol=1e-9)


def still(heading: float, moved: FloatArray) -> Track:
    """A track of two samples in the middle of the lot."""
    position = np.array([0.2, 1.0]) + np.stack([np.zeros(2), moved])
    return Track("two", np.array([1.0, 1.01]), position, np.full(2, heading), np.zeros((2, 2)))


def test_a_track_satisfies_what_holds_at_all_its_samples_and_steps() -> None:
    ahead = np.array([np.cos(1.0), np.sin(1.0)])
    assert satisfies(PHI_THETA, still(1.0, 0.2 * ahead))
    for heading, moved in ((1.0, -0.001 * ahead), (1.0, 0.65 * ahead), (1.4, 0.2 * ahead), (0.6, 0.2 * ahead)):
        track = still(heading, moved)
        assert satisfies(PHI_P, track)
        assert not satisfies(PHI_THETA, track)
    outside = still(1.0, 0.2 * ahead)
    outside = replace(outside, position=outside.position + np.array([0.0, 2.2]))
    assert not satisfies(PHI_P, outside)
    assert not satisfies(PHI_THETA, outside)
