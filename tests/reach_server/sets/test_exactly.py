"""Every verb of both classes keeps its tag on degenerate sets: held against rational arithmetic."""

from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
import pytest

from reach_server.sets import Direction
from tests.reach_server.sets import rational
from tests.reach_server.sets.degenerate import (
    KINDS,
    AnySet,
    draw,
    generators,
    matrix_for,
    member,
    normal_and_heights,
    numbers,
    partner,
    small,
)
from tests.reach_server.sets.rational import Body, body, body_of, exact, ways

EXACT, OUTER = Direction.EXACT, Direction.OUTER
#: What the arrays of a result may have lost, relative to the terms of their sums: some hundred ulps.
ROUNDING = Fraction(1, 2**44)
#: What counts as touching may be apart by this, relative to the same.
MARGIN = Fraction(1, 2**28)


@dataclass(frozen=True, eq=False)
class Case:
    """A verb called: what came back, and the same over the rationals."""

    result: AnySet
    truth: Body


def image(kind: type[AnySet], rng: np.random.Generator) -> Case:
    one = draw(kind, rng)
    M = matrix_for(rng, one)
    return Case(one.linear_map(M), rational.mapped(body_of(one), exact(M)))


def affine(kind: type[AnySet], rng: np.random.Generator) -> Case:
    one = draw(kind, rng)
    M = matrix_for(rng, one)
    t = numbers(rng, len(M)) * rng.choice([1.0, 1e9])
    return Case(one.affine_map(M, t), rational.mapped(body_of(one), exact(M), exact(t)))


def scaled(kind: type[AnySet], rng: np.random.Generator) -> Case:
    one, factor = draw(kind, rng), float(rng.choice([0.0, -1.0, 1 / 3, 1e-9, 1e9]))
    return Case(one.scale(factor), rational.mapped(body_of(one), exact(factor * np.eye(one.dimension))))


def moved(kind: type[AnySet], rng: np.random.Generator) -> Case:
    one = draw(kind, rng)
    t = numbers(rng, one.dimension) * rng.choice([1.0, 1e9])
    return Case(one.translate(t), rational.mapped(body_of(one), exact(np.eye(one.dimension)), exact(t)))


def projected(kind: type[AnySet], rng: np.random.Generator) -> Case:
    one = draw(kind, rng)
    axes = rng.integers(0, one.dimension, 2).tolist()
    return Case(one.project(axes), rational.mapped(body_of(one), exact(np.eye(one.dimension)[axes])))


def total_of_two(kind: type[AnySet], rng: np.random.Generator) -> Case:
    one = draw(kind, rng)
    other: Any = partner(kind, rng, one)
    return Case(one.minkowski_sum(other), rational.added(body_of(one), body_of(other)))


def pair_of_two(kind: type[AnySet], rng: np.random.Generator) -> Case:
    one = draw(kind, rng)
    other: Any = draw(kind, rng, most=2)
    return Case(one.cartesian_product(other), rational.product(body_of(one), body_of(other)))


def strip(kind: type[AnySet], rng: np.random.Generator) -> Case:
    one = draw(kind, rng)
    H, q, reach = normal_and_heights(rng, one)
    r = float(rng.choice([0.0, 0.0, reach, 0.1 * reach, 1.0, np.inf]))
    low, high = (None, None) if np.isinf(r) else (Fraction(q) - Fraction(r), Fraction(q) + Fraction(r))
    return Case(one.intersect_strip(H, q, r), rational.cut(body_of(one), exact(H[None]), [low], [high]))


def halfspace(kind: type[AnySet], rng: np.random.Generator) -> Case:
    one = draw(kind, rng)
    H, q, _ = normal_and_heights(rng, one)
    return Case(one.intersect_halfspace(H, q), rational.cut(body_of(one), exact(H[None]), [None], [Fraction(q)]))


def tangents(kind: type[AnySet], rng: np.random.Generator) -> Case:
    one = draw(kind, rng)
    drawn = [normal_and_heights(rng, one) for _ in range(int(rng.integers(0, 4)))]
    H = np.array([d[0] for d in drawn]).reshape(-1, one.dimension)
    q = np.array([d[1] for d in drawn])
    result = one.intersect_tangents(H, q)
    return Case(result, rational.cut(body_of(one), exact(H), [None] * len(q), [Fraction(v) for v in q.tolist()]))


def linearised(kind: type[AnySet], rng: np.random.Generator) -> Case:
    one = draw(kind, rng)
    J, q, reach = normal_and_heights(rng, one)
    h0 = float(J @ one.center) - q
    low, high = -reach * float(rng.choice([0.0, 0.5])), reach * float(rng.choice([0.0, 0.1]))
    r = float(rng.choice([0.0, 0.1 * reach]))
    middle = sum((a * b for a, b in zip(exact(J), exact(one.center), strict=True)), Fraction(0))
    ends = [middle - Fraction(h0) - Fraction(r) - Fraction(high), middle - Fraction(h0) + Fraction(r) - Fraction(low)]
    truth = rational.cut(body_of(one), exact(J[None]), ends[:1], ends[1:])
    return Case(one.intersect_linearised(J, h0, (low, high), r), truth)


def shared(kind: type[AnySet], rng: np.random.Generator) -> Case:
    one = draw(kind, rng)
    other: Any = partner(kind, rng, one)
    truth = rational.common(body_of(one), body_of(other), exact(np.eye(one.dimension)))
    return Case(one.intersection(other), truth)


def preimage(kind: type[AnySet], rng: np.random.Generator) -> Case:
    one = draw(kind, rng)
    M = matrix_for(rng, one)
    other: Any = partner(kind, rng, one.linear_map(M))
    return Case(one.intersection(other, M), rational.common(body_of(one), body_of(other), exact(M)))


def reduced(kind: type[AnySet], rng: np.random.Generator) -> Case:
    one = draw(kind, rng, most=6)
    method: Any = str(rng.choice(["girard", "combastel", "pca", "scott"]))
    return Case(one.reduce_order(float(rng.choice([1, 1.5, 2])), method), body_of(one))


def simplified(kind: type[AnySet], rng: np.random.Generator) -> Case:
    one = draw(kind, rng)
    return Case(one.simplify(), body_of(one))


def enclosed(kind: type[AnySet], rng: np.random.Generator) -> Case:
    one = draw(kind, rng)
    return Case(one.enclosing_zonotope(), body_of(one))


def fewer(kind: type[AnySet], rng: np.random.Generator) -> Case:
    one: Any = draw(kind, rng)
    return Case(one.reduce_constraints(int(rng.integers(0, 3)), int(rng.integers(1, 3))), body_of(one))


def newest(kind: type[AnySet], rng: np.random.Generator) -> Case:
    one: Any = draw(kind, rng)
    return Case(one.keep_newest_constraints(int(rng.integers(0, 3))), body_of(one))


def rescaled(kind: type[AnySet], rng: np.random.Generator) -> Case:
    one: Any = draw(kind, rng)
    result = one
    for _ in range(int(rng.integers(1, 4))):
        result = result.rescale()
    return Case(result, body_of(one))


def hull(kind: type[AnySet], rng: np.random.Generator) -> Case:
    # The hull has three factors and two rows for each factor of the two: small ones only.
    n = int(rng.integers(1, 3))
    one: Any = small(kind, rng, n)
    other: Any = small(kind, rng, n)
    if rng.random() < 0.3:
        other = one if rng.random() < 0.5 else other.translate(member(one, rng) - member(other, rng))
    return Case(one.convex_hull(other), rational.hull(body_of(one), body_of(other)))


def boxed(kind: type[AnySet], rng: np.random.Generator) -> Case:
    n = int(rng.integers(1, 4))
    low = numbers(rng, n) * 10.0 ** rng.choice([0, 9, -9])
    high = low + np.abs(numbers(rng, n)) * 10.0 ** rng.choice([0, 9, -9])
    middle, half = (exact(low) + exact(high)) / 2, (exact(high) - exact(low)) / 2
    return Case(kind.box(low, high), body(middle, np.diag(half) + rational.zeros(n, n)))


def the_point(kind: type[AnySet], rng: np.random.Generator) -> Case:
    x = numbers(rng, int(rng.integers(1, 4))) * 1e9
    return Case(kind.point(x), body(x, rational.zeros(len(x), 0)))


Make = Callable[[type[AnySet], np.random.Generator], Case]
#: What each verb is to its result, for either class.
MAKING: dict[str, tuple[Make, Direction | None, Direction]] = {
    "box": (boxed, EXACT, EXACT),
    "point": (the_point, EXACT, EXACT),
    "linear_map": (image, EXACT, EXACT),
    "affine_map": (affine, EXACT, EXACT),
    "scale": (scaled, EXACT, EXACT),
    "translate": (moved, EXACT, EXACT),
    "project": (projected, EXACT, EXACT),
    "minkowski_sum": (total_of_two, EXACT, EXACT),
    "cartesian_product": (pair_of_two, EXACT, EXACT),
    "convex_hull": (hull, OUTER, EXACT),
    "intersect_strip": (strip, OUTER, EXACT),
    "intersect_halfspace": (halfspace, OUTER, EXACT),
    "intersect_tangents": (tangents, OUTER, EXACT),
    "intersect_linearised": (linearised, OUTER, EXACT),
    "intersection": (shared, OUTER, EXACT),
    "preimage": (preimage, OUTER, EXACT),
    "reduce_order": (reduced, OUTER, OUTER),
    "simplify": (simplified, EXACT, EXACT),
    "enclosing_zonotope": (enclosed, EXACT, OUTER),
    "reduce_constraints": (fewer, None, OUTER),
    "keep_newest_constraints": (newest, None, OUTER),
    "rescale": (rescaled, None, EXACT),
}
PAIRS = [(kind, name) for name, (_, *steps) in MAKING.items() for kind, step in zip(KINDS, steps, strict=True) if step]


def assert_outer(truth: Body, result: AnySet, rng: np.random.Generator) -> bool:
    """Every point of the true set is in the result, up to rounding; whether there is one."""
    made = body_of(result)
    reached = [truth.best(d) for d in ways(rng, truth.n)]
    points = {tuple(found[1]): found[1] for found in reached if found is not None}
    if points:
        assert not result.is_empty()
        size = np.maximum(made.size, truth.size)
        wide = Body(made.c, made.G, made.A, made.b, size, made.row_size).widened(ROUNDING)
        for point in points.values():
            assert made.holds(point) or wide.holds(point)
    return bool(points)


def assert_inner(truth: Body, result: AnySet, rng: np.random.Generator) -> None:
    """Every point of the result is in the true set, up to rounding; of one that is missed by a hair, the nearest."""
    made = body_of(result)
    size = np.maximum(made.size, truth.size)
    wide = Body(truth.c, truth.G, truth.A, truth.b, size, truth.row_size).widened(
        MARGIN if truth.is_empty() else ROUNDING
    )
    for d in ways(rng, truth.n, 1):
        found = made.best(d)
        if found is None:
            return
        assert truth.holds(found[1]) or wide.holds(found[1])


@pytest.mark.parametrize(("kind", "name"), PAIRS, ids=[f"{kind.__name__}-{name}" for kind, name in PAIRS])
def test_results_are_exact_or_outer(kind: type[AnySet], name: str) -> None:
    make, *steps = MAKING[name]
    step = steps[KINDS.index(kind)]
    wrong, inhabited = [], 0
    for example, rng in enumerate(generators(60, sum(map(ord, name)), share=6 if make is hull else 1)):
        try:
            case = make(kind, rng)
            inhabited += assert_outer(case.truth, case.result, rng)
            if step is EXACT:
                assert_inner(case.truth, case.result, rng)
        except Exception as error:
            wrong.append((example, repr(error)[:300]))
    assert inhabited, "no example holds a point: nothing was tested"
    assert not wrong, (len(wrong), wrong[:5])
