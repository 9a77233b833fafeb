"""Half-spaces, strips and discs as literals, noise and motion, and the numbering."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from shapely import Point, Polygon

from reach_server.numeric.types import BoolArray, FloatArray
from reach_server.predicates import DISC_TANGENTS, Literals, tangents
from reach_server.sets import Zonotope
from reach_server.sets import polygon as planar
from side_info import DiscPredicate, LinearPredicate, ScenarioError
from side_info.stl.expression import Name, Negation, Number, Power, Sum, Time
from side_info.stl.predicates import NonlinearPredicate, Predicate
from tests.reach_server import ugly
from tests.reach_server.predicates.asking import context, cut_polygon, factors, kept, members
from tests.reach_server.ugly import Raw, moderate

INDEX = {"x": 1, "y": 2}
NOISELESS = np.zeros((3, 0))
STRIP = LinearPredicate("lane", {"x": 1.0, "y": 2.0}, -3.0, 1.0)
HALF = LinearPredicate("half", {"x": -0.5}, -np.inf, 2.0)
DISC = DiscPredicate("ring", {"x": 0.3, "y": -2.0}, 1.4)


def literal(literals: Literals, predicate: Predicate, speed: FloatArray | float = 0.0, margin_ns: int = 0) -> int:
    return literals.add(predicate, INDEX, scenario="s", name=predicate.name, speed=speed, margin_ns=margin_ns)


def holds(predicate: Predicate, points: FloatArray) -> BoolArray:
    """Whether predicates hold at points (..., n)."""
    if isinstance(predicate, LinearPredicate):
        height = sum(c * points[..., INDEX[name]] for name, c in predicate.coefficients.items())
        return np.asarray((predicate.lower <= height) & (height <= predicate.upper))
    assert isinstance(predicate, DiscPredicate)
    offsets = [points[..., INDEX[name]] - q for name, q in predicate.center.items()]
    return np.asarray(np.hypot(*offsets) <= predicate.radius)


@moderate
@given(st.integers(0, 2**32 - 1))
def test_no_state_that_may_obey_is_cut_and_no_status_is_wrong(seed: int) -> None:
    rng = np.random.default_rng(seed)
    noise = rng.normal(size=(3, 2)) * rng.choice([0.0, 0.2])
    speed, margin = rng.uniform(0, 2, 3), rng.choice([0.0, 0.1])
    literals = Literals(3, (1, 2), noise)
    rows, count = 8, 200
    center = rng.normal(size=(rows, 3)) * 2 + [0, 0, -1]
    generators = rng.normal(size=(rows, 3, 4)) * rng.choice([0.0, 0.01, 0.3, 1.0], (rows, 1, 1))
    held = members(rng, center, generators, count)
    moved = factors(rng, rows, count, 3) * speed * margin
    true = held + factors(rng, rows, count, 2) @ noise.T + moved
    for predicate in (STRIP, HALF, DISC):
        number = literal(literals, predicate, speed, round(margin * 1e9))
        assert literals.fixed(number)
        strips, empty = literals.strips(number, center, generators, context(rows, 3))
        obeys = holds(predicate, true)
        assert not (obeys & ~kept(strips, held)).any()
        assert not (obeys.any(axis=1) & empty).any()
        status = literals.verdict([number], center, generators, context(rows, 3))[:, 0]
        assert not (holds(predicate, held + moved).any(axis=1) & (status == -1)).any()
        assert holds(predicate, held)[status == 1].all()


def test_strips_are_exact_where_nothing_is_blurred() -> None:
    literals = Literals(3, (1, 2), NOISELESS)
    strips, _ = literals.strips(literal(literals, STRIP), np.zeros((1, 3)), np.zeros((1, 3, 0)), context(1, 3))
    np.testing.assert_array_equal(strips.normal, [[0, 1, 2]])
    np.testing.assert_array_equal([strips.lower, strips.upper], [[-3], [1]])


def test_noise_and_motion_widen_strips() -> None:
    noise = np.array([[5.0], [0.25], [-0.5]])
    literals = Literals(3, (1, 2), noise)
    number = literal(literals, STRIP, np.array([9.0, 1.0, 2.0]), 100_000_000)
    # |1 * 0.25 - 2 * 0.5| of noise, (1 * 1 + 2 * 2) * 0.1 of motion
    expected = 0.75 + 0.5
    strips, empty = literals.strips(number, np.array([[0, 2.0, 0]]), np.zeros((1, 3, 0)), context(1, 3))
    np.testing.assert_allclose([strips.lower[0], strips.upper[0]], [-3 - expected, 1 + expected], rtol=1e-14)
    assert not empty
    # The status is about true states: motion alone.
    at = np.array([[0, 1.4, 0], [0, 1.6, 0], [0, 1.0, 0]])
    np.testing.assert_array_equal(literals.verdict([number], at, np.zeros((3, 3, 0)), context(3, 3))[:, 0], [0, -1, 1])


def test_states_on_the_border_hold() -> None:
    literals = Literals(3, (1, 2), NOISELESS)
    number = literals.add(LinearPredicate("P", {"x": 1.0}, -1.0, 0.375), INDEX, scenario="s", name="P")
    at = np.array([[0, 0.375, 0], [0, 0.125, 0], [0, np.nextafter(0.375, 1), 0]])
    generators = np.zeros((3, 3, 1))
    generators[1, 1] = 0.25
    np.testing.assert_array_equal(literals.verdict([number], at, generators, context(3, 3))[:, 0], [1, 1, 0])


def test_without_a_noise_bound_nothing_cuts() -> None:
    literals = Literals(3, (1, 2), None)
    for predicate in (STRIP, DISC, NonlinearPredicate("later", Sum((Name("x"), Time())))):
        number = literal(literals, predicate)
        strips, empty = literals.strips(number, np.full((2, 3), 99.0), np.zeros((2, 3, 0)), context(2, 3))
        assert strips.normal.shape == (0, 3)
        assert len(strips.lower) == len(strips.upper) == 0
        assert not empty.any()
        assert literals.fixed(number)
        # What true states are like is another question.
        assert literals.verdict([number], np.full((2, 3), 99.0), np.zeros((2, 3, 0)), context(2, 3)).any()


def test_the_same_literal_has_the_same_number() -> None:
    literals = Literals(3, (1, 2), NOISELESS)
    first = literal(literals, STRIP)
    again = LinearPredicate("lane", {"x": 1.0, "y": 2.0}, -3.0, 1.0)
    assert literal(literals, again) == first
    different = {
        literals.add(STRIP, INDEX, scenario="other", name="lane"),
        literals.add(STRIP, INDEX, scenario="s", name="lane 2"),
        literals.add(STRIP, {"x": 2, "y": 1}, scenario="s", name="lane"),
        literal(literals, STRIP, 1.0, 5),
        literal(literals, LinearPredicate("lane", {"x": 1.0, "y": 2.0}, -3.0, 1.5)),
        literal(literals, DISC),
        literal(literals, NonlinearPredicate("lane", Name("x"))),
    }
    assert different == set(range(1, 8))
    assert literal(literals, NonlinearPredicate("lane", Name("x"))) == 7
    assert literals.count == 8
    assert (literals.scenario(1), literals.name(1), literals.name(2)) == ("other", "lane", "lane 2")
    # Motion matters only within a margin.
    assert literal(literals, STRIP, 7.0, 0) == first


def test_status_of_many_literals_is_one_column_each() -> None:
    literals = Literals(3, (1, 2), NOISELESS)
    numbers = [literal(literals, predicate) for predicate in (STRIP, HALF, DISC)]
    center = np.array([[0, 0.3, -2.0], [0, -9.0, 0.0]])
    found = literals.verdict(numbers, center, np.zeros((2, 3, 0)), context(2, 3))
    np.testing.assert_array_equal(found, [[-1, 1, 1], [-1, -1, -1]])
    assert literals.verdict([], center, np.zeros((2, 3, 0)), context(2, 3)).shape == (2, 0)


def test_what_cannot_be_compiled_is_refused() -> None:
    with pytest.raises(ScenarioError, match="'z'"):
        literal(Literals(3, None, NOISELESS), NonlinearPredicate("p", Name("z")))


@pytest.mark.parametrize("count", [4, 8, DISC_TANGENTS, 64])
@pytest.mark.parametrize(("center", "radius"), [((0.0, 0.0), 1.0), ((0.3, -2.0), 1.4), ((1e4, -1e4), 1e-2)])
def test_tangents_hold_the_disc_and_touch_it(center: tuple[float, float], radius: float, count: int) -> None:
    normals, bounds = tangents(np.array(center), radius, count)
    angle = np.linspace(0, 2 * np.pi, 1000)
    disc = np.array(center) + radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    assert (disc @ normals.T <= bounds + 1e-12 * np.abs(center).sum()).all()
    np.testing.assert_allclose((disc @ normals.T).max(axis=0), bounds, atol=1e-4 * radius)


def test_a_disc_is_cut_to_its_area_and_little_more() -> None:
    literals = Literals(2, (0, 1), np.zeros((2, 0)))
    number = literals.add(DiscPredicate("d", {"x": 0.0, "y": 0.0}, 1.2), {"x": 0, "y": 1}, scenario="s", name="d")
    center, generators = np.array([0.3, 0.2]), np.array([[1.5, 0.3, -0.4], [0.2, 1.1, 0.6]])
    strips, _ = literals.strips(number, center[None], generators[None], context(1, 2))
    whole = Polygon(planar.zonotope_polygon(center, generators))
    exact = whole.intersection(Point(0, 0).buffer(1.2, 256)).area
    assert exact <= cut_polygon(center, generators, strips).area <= 1.02 * exact
    # The symmetric strip of the paper, |h| <= r² about the center with the remainder of h, does not cut this set.
    gradient = -2 * center
    value = 1.44 - center @ center
    corner = np.abs(generators).sum(axis=1)
    symmetric = Zonotope(center, generators).intersect_linearised(gradient, value, (-(corner @ corner), 0.0), 1.44)
    assert symmetric.area() >= 1.5 * exact


def test_both_coordinates_of_a_disc_may_mean_the_same_state() -> None:
    literals = Literals(1, None, np.zeros((1, 0)))
    disc = DiscPredicate("d", {"x": 1.0, "y": 0.0}, 1.0)
    number = literals.add(disc, {"x": 0, "y": 0}, scenario="s", name="d")
    # (s - 1)² + s² <= 1 for s from 0 to 1
    at = np.linspace(-1, 2, 13)[:, None]
    strips, _ = literals.strips(number, at, np.zeros((13, 1, 0)), context(13, 1))
    inside = (at[:, 0] >= 0) & (at[:, 0] <= 1)
    assert kept(strips, at[:, None])[inside].all()
    found = literals.verdict([number], at, np.zeros((13, 1, 0)), context(13, 1))[:, 0]
    assert (found[~inside] <= 0).all()
    assert (found[inside] >= 0).all()
    assert found[at[:, 0] == 0.5] == 1
    assert found[0] == found[-1] == -1


@pytest.mark.parametrize("case", ugly.ZONOTOPES, ids=ugly.named)
def test_ugly_sets(case: Raw) -> None:
    """Predicates of all kinds at the scale of the set, about its center and beyond it."""
    n, size = case.n, case.size
    names = [f"s{i}" for i in range(n)]
    index = {name: i for i, name in enumerate(names)}
    first, last = names[0], names[-1]
    at_first = float(case.c[0])

    def number(value: float) -> Negation | Number:
        return Negation(Number(-value)) if value < 0 else Number(value)

    offset = Sum((Name(last), Negation(number(float(case.c[-1])))))
    parabola = Sum((Name(first), Negation(number(at_first)), Negation(Power(offset, Number(2.0)))))
    saddle = Sum((parabola, Power(Name(first), Number(2.0)), Negation(number(at_first**2))))
    predicates: list[Predicate] = [
        LinearPredicate("near", {first: 1.0}, at_first, at_first + size),
        LinearPredicate("beyond", {first: 1.0}, at_first + 3 * size + 1e-5 * abs(at_first), np.inf),
        NonlinearPredicate("parabola", parabola),
        NonlinearPredicate("saddle", saddle),
    ]
    if n > 1:
        predicates.append(DiscPredicate("disc", {first: at_first, last: float(case.c[-1])}, size))
    literals = Literals(n, None, np.zeros((n, 0)))
    center, generators = case.c[None], case.G[None]
    inside = ugly.corners(case)[:64]
    for predicate in predicates:
        one = literals.add(predicate, index, scenario="s", name=predicate.name)
        strips, empty = literals.strips(one, center, generators, context(1, n))
        status = literals.verdict([one], center, generators, context(1, n))[0, 0]
        assert strips.lower.shape[-1] == strips.upper.shape[-1] == strips.normal.shape[-2]
        if predicate.name == "beyond":
            assert (bool(empty[0]), status) == (True, -1)
        else:
            # The center satisfies all others.
            assert not empty[0]
            assert status >= 0
            assert kept(strips, case.c[None, None]).all()
        if predicate.name == "disc":
            assert kept(strips, inside[None]).all()
