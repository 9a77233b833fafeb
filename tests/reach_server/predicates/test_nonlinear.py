"""Predicates of any expression: no state that may satisfy one is cut, and the cuts come near what they can be."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import shapely
from shapely import Polygon

from reach_server.numeric.types import FloatArray
from reach_server.predicates import Context, Literals
from reach_server.predicates.nonlinear import contracted
from reach_server.sets import polygon as planar
from side_info.stl.expression import (
    Call,
    Expression,
    Last,
    Name,
    Negation,
    Number,
    Power,
    Product,
    Reciprocal,
    Steps,
    Sum,
    Time,
)
from side_info.stl.predicates import DiscPredicate, NonlinearPredicate
from tests.reach_server.predicates.asking import context, cut_polygon, factors, kept, members, row
from tests.reach_server.predicates.expressions import evaluate, number, random_expression

X, Y = Name("x"), Name("y")
XY = {"x": 0, "y": 1}
ONE, TWO = Number(1.0), Number(2.0)


def less(value: Expression, *subtracted: Expression) -> Expression:
    return Sum((value, *(Negation(term) for term in subtracted)))


def squared(value: Expression) -> Expression:
    return Power(value, TWO)


DISC = less(ONE, squared(X), squared(Y))
AROUND_LAST = less(ONE, squared(less(X, Last("x"))), squared(less(Y, Last("y"))))
PARABOLA = less(Y, squared(X))
SKEW_PARABOLA = less(Sum((Number(1.5), X)), squared(Sum((X, Product((TWO, Y))))))
ELLIPSE = less(ONE, squared(Product((Number(0.6), X))), squared(Sum((X, Y))))
EXPONENTIAL = less(TWO, Call("exp", (X,)), squared(Y))
OUTSIDE = less(Sum((squared(X), squared(Y))), ONE)


def added(literals: Literals, expression: Expression, speed: FloatArray | float = 0.0, margin: float = 0.0) -> int:
    predicate = NonlinearPredicate("p", expression)
    return literals.add(predicate, XY, scenario="s", name="p", speed=speed, margin_ns=round(margin * 1e9))


def height(
    expression: Expression,
    index: Mapping[str, int],
    past: Mapping[str, FloatArray],
    steps: FloatArray,
    states: FloatArray,
    time: FloatArray,
) -> FloatArray:
    """The left side of a predicate at states (R, K, n) and times (R, K) or (R, 1)."""
    values = evaluate(expression, {name: states[..., i] for name, i in index.items()}, past, time, steps)
    return np.broadcast_to(values, steps.shape)


@pytest.mark.parametrize("seed", range(12))
def test_no_state_that_may_satisfy_is_cut_and_no_status_is_wrong(seed: int) -> None:
    """Random expressions, sets, noise, motion, clocks and last states; where undefined, a predicate may hold."""
    rng = np.random.default_rng(seed)
    index, n, rows, count = {"a": 0, "b": 2, "c": 1}, 4, 6, 60
    cut = removed = unsatisfied = 0
    for _ in range(60):
        grown = random_expression(rng, tuple(index), int(rng.integers(1, 4)))
        expression = Sum((grown, number(round(float(rng.normal()), 2))))
        noise = rng.normal(size=(n, 2)) * rng.choice([0.0, 0.05])
        speed, margin, slack = rng.uniform(0, 1, n), rng.choice([0.0, 0.0, 0.1]), rng.choice([0.0, 0.05])
        literals = Literals(n, (0, 2), noise)
        predicate = NonlinearPredicate("p", expression)
        one = literals.add(predicate, index, scenario="s", name="p", speed=speed, margin_ns=round(margin * 1e9))

        center = rng.normal(size=(rows, n)) * 2
        generators = rng.normal(size=(rows, n, 5)) * rng.choice([1e-3, 0.05, 0.3, 1.0], (rows, 1, 1))
        t, k = rng.uniform(0, 5, rows), rng.integers(0, 5, rows).astype(np.float64)
        last = rng.normal(size=(rows, n))
        width = rng.choice([0.0, 0.1, 0.5], (rows, 1)) * rng.random((rows, n))
        given = Context(t, k, t - 0.1 * k, last, last + width, float(slack))

        held = members(rng, center, generators, count)
        moved = factors(rng, rows, count, n) * speed * margin
        off = factors(rng, rows, count) * slack
        last_states = last[:, None] + width[:, None] * rng.random((rows, count, n))

        past = {"t": given.last_t[:, None] + off} | {name: last_states[..., i] for name, i in index.items()}
        steps = np.broadcast_to(k[:, None], off.shape)

        h = partial(height, expression, index, past, steps)

        at = t[:, None] + off + factors(rng, rows, count) * margin
        satisfied = ~(h(held + factors(rng, rows, count, 2) @ noise.T + moved, at) < 0)
        strips, empty = literals.strips(one, center, generators, given)
        stays = kept(strips, held)
        assert not (satisfied & ~stays).any(), expression
        assert not (satisfied.any(axis=1) & empty).any(), expression
        status = literals.verdict([one], center, generators, given)[:, 0]
        assert not ((status == -1) & ~(h(held + moved, at) < 0).all(axis=1)).any(), expression
        assert not ((status == 1)[:, None] & ~(h(held, t[:, None] + off) >= -1e-12)).any(), expression
        cut += int(np.isfinite(strips.lower).any(axis=1).sum())
        unsatisfied += int((~satisfied).sum())
        removed += int((~satisfied & (~stays | empty[:, None])).sum())
    # And the cuts do something.
    assert cut > 0.5 * 60 * rows
    assert removed > 0.7 * unsatisfied


def area_of(h: Callable[[FloatArray, FloatArray], FloatArray], polygon: Polygon) -> float:
    left, low, right, high = polygon.bounds
    x, y = np.meshgrid(np.linspace(left, right, 801), np.linspace(low, high, 801))
    inside = shapely.contains_xy(polygon, x.ravel(), y.ravel()) & (h(x, y).ravel() >= 0)
    return float(inside.mean() * (right - left) * (high - low))


CENTER, GENERATORS = np.array([[0.3, 0.2]]), np.array([[[1.5, 0.3, -0.4], [0.2, 1.1, 0.6]]])


@pytest.mark.parametrize(
    ("expression", "h", "fixed", "most"),
    [
        (DISC, lambda x, y: 1 - x**2 - y**2, True, 1.02),
        (ELLIPSE, lambda x, y: 1 - (0.6 * x) ** 2 - (x + y) ** 2, True, 1.02),
        (AROUND_LAST, lambda x, y: 1 - x**2 - y**2, False, 1.02),
        (PARABOLA, lambda x, y: y - x**2, False, 1.02),
        (SKEW_PARABOLA, lambda x, y: 1.5 + x - (x + 2 * y) ** 2, False, 1.03),
        (EXPONENTIAL, lambda x, y: 2 - np.exp(x) - y**2, False, 1.03),
    ],
)
def test_concave_predicates_are_cut_to_their_area_and_little_more(
    expression: Expression, h: Callable[[FloatArray, FloatArray], FloatArray], fixed: bool, most: float
) -> None:
    literals = Literals(2, (0, 1), np.zeros((2, 0)))
    one = added(literals, expression)
    strips, empty = literals.strips(one, CENTER, GENERATORS, context(1, 2))
    assert literals.fixed(one) is fixed
    assert not empty.any()
    assert strips.lower.shape[-1] == (8 if fixed else 16)
    whole = Polygon(planar.zonotope_polygon(CENTER[0], GENERATORS[0]))
    exact = area_of(h, whole)
    assert cut_polygon(CENTER[0], GENERATORS[0], row(strips, 0)).area <= most * exact + 0.002 * whole.area


def test_an_ellipse_has_the_tangents_of_a_disc() -> None:
    literals = Literals(2, (0, 1), np.zeros((2, 0)))
    named = literals.add(DiscPredicate("d", {"x": 0.0, "y": 0.0}, 1.0), XY, scenario="s", name="d")
    found, expected = (
        literals.strips(one, CENTER, GENERATORS, context(1, 2))[0] for one in (added(literals, DISC), named)
    )
    areas = [cut_polygon(CENTER[0], GENERATORS[0], strips).area for strips in (found, expected)]
    np.testing.assert_allclose(areas[0], areas[1], rtol=1e-9)


def test_a_small_set_at_the_border_of_a_large_disc_is_cut_closely() -> None:
    """Tangents at points of the set, which those of the disc itself would not be."""
    literals = Literals(2, (0, 1), np.zeros((2, 0)))
    one = added(literals, less(Number(1e4), squared(less(X, Last("x"))), squared(Y)))
    angle = np.pi / 16
    center = 100 * np.array([[np.cos(angle), np.sin(angle)]])
    strips, _ = literals.strips(one, center, np.eye(2)[None], context(1, 2))
    square = Polygon(planar.zonotope_polygon(center[0], np.eye(2)))
    exact = area_of(lambda x, y: 1e4 - x**2 - y**2, square)
    assert cut_polygon(center[0], np.eye(2), row(strips, 0)).area <= 1.02 * exact + 0.01


def test_outside_of_a_disc_one_half_space_is_left() -> None:
    literals = Literals(2, (0, 1), np.zeros((2, 0)))
    one = added(literals, OUTSIDE)
    center, generators = np.array([[0.9, 0.9], [0.1, 0.0], [5.0, 5.0]]), np.tile(0.5 * np.eye(2), (3, 1, 1))
    strips, empty = literals.strips(one, center, generators, context(3, 2))
    assert strips.normal.shape == (3, 1, 2)
    np.testing.assert_array_equal(empty, [False, True, False])
    whole = Polygon(planar.zonotope_polygon(center[0], generators[0]))
    exact = area_of(lambda x, y: x**2 + y**2 - 1, whole)
    assert cut_polygon(center[0], generators[0], row(strips, 0)).area <= 1.15 * exact
    np.testing.assert_array_equal(literals.verdict([one], center, generators, context(3, 2))[:, 0], [0, -1, 1])


def test_generators_tell_what_a_box_does_not() -> None:
    """``x y >= 0.9`` fails on the diagonal from (1.8, 0) to (0, 1.8), not in its box."""
    literals = Literals(2, (0, 1), np.zeros((2, 0)))
    one = added(literals, less(Product((X, Y)), Number(0.9)))
    generators = np.stack([0.9 * np.array([[1.0, 0.0], [-1.0, 0.0]]), 0.9 * np.eye(2)])
    center = np.full((2, 2), 0.9)
    _, empty = literals.strips(one, center, generators, context(2, 2))
    np.testing.assert_array_equal(empty, [True, False])
    np.testing.assert_array_equal(literals.verdict([one], center, generators, context(2, 2))[:, 0], [-1, 0])


def test_boxes_are_contracted_to_what_half_spaces_leave() -> None:
    lower, upper = np.zeros((3, 2)), np.ones((3, 2))
    normal = np.array([[[1.0, 1.0], [0.0, -2.0]]] * 3)
    bound = np.array([[1.5, -1.8], [3.0, -np.inf], [-np.inf, -np.inf]])
    low, high, gone = contracted(lower, upper, normal, bound)
    np.testing.assert_allclose(low[0], [0.5, 0.5], rtol=1e-12)
    np.testing.assert_allclose(high[0], [1.0, 0.9], rtol=1e-12)
    np.testing.assert_array_equal(gone, [False, True, False])
    np.testing.assert_array_equal([low[2], high[2]], [[0, 0], [1, 1]])
    # Outer: no state that obeys is lost to rounding.
    rng = np.random.default_rng(0)
    normal, center = rng.normal(size=(2000, 3, 2)), rng.normal(size=(2000, 2))
    point = center + rng.uniform(-0.1, 0.1, (2000, 2))
    bound = (normal * point[:, None]).sum(axis=2) * (1 - 1e-15 * np.sign((normal * point[:, None]).sum(axis=2)))
    low, high, gone = contracted(center - 0.1, center + 0.1, normal, bound)
    assert not gone.any()
    assert ((low <= point + 1e-15) & (point <= high + 1e-15)).all()


@pytest.mark.parametrize(
    "expression",
    [
        Sum((Call("sqrt", (X,)), Negation(Number(5.0)))),
        Sum((Reciprocal(X), Negation(Number(500.0)))),
        Sum((Call("log", (X,)), Negation(Number(5.0)))),
        # CasADi makes these x, 0 and 1.
        less(squared(Call("sqrt", (X,))), Number(5.0)),
        less(Product((Number(0.0), Call("tan", (Product((TWO, X)),)))), ONE),
        less(Product((X, Reciprocal(X))), TWO),
    ],
)
def test_a_predicate_says_nothing_where_it_is_not_defined(expression: Expression) -> None:
    literals = Literals(2, (0, 1), np.zeros((2, 0)))
    one = added(literals, expression)
    # The second set lies in the domain, and fails there.
    center, generators = np.array([[0.0, 0.0], [0.5, 0.0]]), np.tile(np.eye(2), (2, 1, 1))
    generators[1] *= 0.1
    strips, empty = literals.strips(one, center, generators, context(2, 2))
    assert np.isneginf(strips.lower[0]).all()
    np.testing.assert_array_equal(empty, [False, True])
    np.testing.assert_array_equal(literals.verdict([one], center, generators, context(2, 2))[:, 0], [0, -1])


def test_kinks_in_a_state_are_never_expanded() -> None:
    """A Lagrange remainder across a kink would lose states: the second derivative of ``|x|`` is 0 but for one place."""
    literals = Literals(2, (0, 1), np.zeros((2, 0)))
    for kinked in (Call("abs", (X,)), Call("norm", (X,)), Call("max", (X, Negation(X)))):
        one = added(literals, less(kinked, Number(0.5)))
        center = np.array([[0.2, 0.0], [2.0, 0.0], [0.0, 0.0]])
        generators = np.array([1.0, 1.0, 0.4])[:, None, None] * np.eye(2)
        strips, empty = literals.strips(one, center, generators, context(3, 2))
        assert np.isneginf(strips.lower[0]).all()
        assert np.isfinite(strips.lower[1]).any() or kinked == Call("max", (X, Negation(X)))
        np.testing.assert_array_equal(empty, [False, False, True])
    # The branch cut of atan2 is a jump.
    one = added(literals, less(Call("atan2", (Y, X)), TWO))
    strips, _ = literals.strips(one, np.array([[-2.0, -0.5]]), np.eye(2)[None], context(1, 2))
    assert np.isneginf(strips.lower).all()


def test_time_steps_and_the_last_state() -> None:
    literals = Literals(2, (0, 1), np.zeros((2, 0)))
    # What can be reached from the last state at 2 m/s in k samples of half a second.
    reach = less(Product((TWO, less(Time(), Last("t")))), less(X, Last("x")))
    same = less(Steps(), less(X, Last("x")))
    center, generators = np.full((3, 2), 3.0), np.tile(np.eye(2), (3, 1, 1))
    given = context(
        3, 2, t=np.array([10.0, 11.0, 12.0]), k=np.array([0.0, 2.0, 4.0]), last_t=np.full(3, 10.0),
        last_lower=np.array([[1.0, 0]] * 3), last_upper=np.array([[1.5, 9]] * 3),
    )  # fmt: skip
    for expression in (reach, same):
        one = added(literals, expression)
        strips, empty = literals.strips(one, center, generators, given)
        assert strips.lower.shape == (3, 1)
        # x <= last x + 2 (t - last t), at the greatest last x
        np.testing.assert_allclose(strips.lower[:, 0] / strips.normal[:, 0, 0], [1.5, 3.5, 5.5], rtol=1e-9)
        np.testing.assert_array_equal(empty, [True, False, False])
        np.testing.assert_array_equal(literals.verdict([one], center, generators, given)[:, 0], [-1, 0, 1])
    one = added(literals, reach)
    strips, _ = literals.strips(one, center, generators, replace(given, t_slack=0.1))
    np.testing.assert_allclose(strips.lower[:, 0] / strips.normal[:, 0, 0], [1.9, 3.9, 5.9], rtol=1e-9)
    # Nothing was received yet.
    unknown = replace(given, last_lower=np.full((3, 2), np.nan), last_upper=np.full((3, 2), np.nan))
    strips, empty = literals.strips(one, center, generators, unknown)
    assert np.isneginf(strips.lower).all()
    assert not empty.any()


def test_a_predicate_without_states_cuts_all_or_nothing() -> None:
    literals = Literals(2, (0, 1), np.zeros((2, 0)))
    one = added(literals, less(Time(), Number(0.3)))
    given = context(3, 2, t=np.array([0.2, 0.1 + 0.2, 0.4]))
    strips, empty = literals.strips(one, np.zeros((3, 2)), np.zeros((3, 2, 0)), given)
    assert strips.normal.shape == (3, 0, 2)
    np.testing.assert_array_equal(empty, [True, False, False])
    np.testing.assert_array_equal(
        literals.verdict([one], np.zeros((3, 2)), np.zeros((3, 2, 0)), given)[:, 0], [-1, 1, 1]
    )
    moving = added(literals, less(Time(), Number(0.3)), margin=0.15)
    _, empty = literals.strips(moving, np.zeros((3, 2)), np.zeros((3, 2, 0)), given)
    assert not empty.any()


def test_noise_and_motion_move_the_border_by_what_they_move_states() -> None:
    blurred = Literals(2, (0, 1), np.array([[0.3], [0.0]]))
    one = added(blurred, AROUND_LAST, speed=np.array([1.0, 0.0]), margin=0.2)
    center, generators = np.array([[1.0, 0.0]]), 0.6 * np.eye(2)[None]
    strips, _ = blurred.strips(one, center, generators, context(1, 2))
    points = np.stack([np.linspace(0.4, 1.6, 241), np.zeros(241)], axis=1)[None]
    # |x| <= 1 of a state half a metre away at most
    farthest = points[0, kept(strips, points)[0], 0].max()
    assert 1.5 <= farthest <= 1.51


def test_ellipsoids_that_are_none() -> None:
    literals = Literals(2, (0, 1), np.zeros((2, 0)))
    nowhere = added(literals, less(Negation(ONE), squared(X), squared(Y)))
    assert not literals.fixed(nowhere)
    strips, empty = literals.strips(nowhere, CENTER, GENERATORS, context(1, 2))
    assert empty.all()
    assert literals.verdict([nowhere], CENTER, GENERATORS, context(1, 2)) == -1
    interval = added(literals, less(ONE, squared(X)))
    assert literals.fixed(interval)
    strips, _ = literals.strips(interval, CENTER, GENERATORS, context(1, 2))
    np.testing.assert_allclose(np.abs([strips.lower[0], strips.upper[0]] / strips.normal[0, 0]), [1, 1], rtol=1e-9)
