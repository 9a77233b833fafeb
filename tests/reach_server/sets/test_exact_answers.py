"""Every question to both classes is answered truly on degenerate sets: held against rational arithmetic."""

from collections.abc import Callable
from fractions import Fraction
from typing import Any, get_args

import numpy as np
import pytest
from scipy.spatial import ConvexHull, QhullError

from reach_server.numeric.types import FloatArray
from reach_server.sets import ConstrainedZonotope, Zonotope
from reach_server.sets.sampling import SampleMethod
from tests.reach_server.sets import rational
from tests.reach_server.sets.degenerate import KINDS, AnySet, draw, generators, member, numbers, partner, small
from tests.reach_server.sets.rational import Body, Exact, body_of, exact, total, ways, zeros

#: What numbers that come back may be off by, relative to the terms of their sums.
ROUNDING = Fraction(1, 2**40)
#: How well the linear programs must do in their bounds; these are bounds whatever they do.
TIGHT = Fraction(1, 2**30)
#: By how much a proof of emptiness must exceed its terms, and by how much members may miss the set; both with room.
EMPTY, MEMBER = Fraction(1, 2**28), Fraction(1, 2**22)

both = pytest.mark.parametrize("kind", KINDS, ids=["zonotope", "constrained"])
Check = Callable[[type[AnySet], np.random.Generator], bool]


def every(check: Check, kind: type[AnySet], salt: int, count: int = 60, share: int = 1) -> None:
    """The check holds on all examples, and says of some that they were worth it."""
    wrong, told = [], 0
    for example, rng in enumerate(generators(count, salt, share=share)):
        try:
            told += check(kind, rng)
        except Exception as error:
            wrong.append((example, repr(error)[:200]))
    assert told
    assert not wrong, (len(wrong), wrong[:5])


def enlarged(s: Body, share: Fraction) -> Body:
    """The set and what lies beside it by ``share`` of its size, up to the rounding of its center."""
    reach = total(abs(s.G).ravel())
    size = zeros(s.n) + total(abs(s.c)) * (ROUNDING / share) + reach
    return Body(s.c, s.G, s.A, s.b, size, s.row_size).widened(share)


def _supports(kind: type[AnySet], rng: np.random.Generator) -> bool:
    one = draw(kind, rng)
    truth = body_of(one)
    d = np.concatenate([np.eye(one.dimension), -np.eye(one.dimension), numbers(rng, 2, one.dimension)])
    bounds = one.support(d)
    lower, upper = one.interval_hull()
    wide = truth.widened(TIGHT)
    for way, bound in zip(exact(d), bounds, strict=True):
        found = truth.best(way)
        if found is None:
            continue
        beyond = wide.best(way)
        assert beyond is not None
        assert np.isfinite(bound)
        assert found[0] <= exact(bound)[()] <= beyond[0] + ROUNDING * total(abs(way) * truth.size)
        assert (exact(lower) <= found[1]).all()
        assert (found[1] <= exact(upper)).all()
    assert one.is_empty() or (lower <= upper).all()
    if isinstance(one, ConstrainedZonotope):
        certificate = one.support_certificate(d)
        proof = one.emptiness_certificate()
        for way, bound, weights in zip(exact(d), certificate.bound, exact(certificate.weights), strict=True):
            if np.isfinite(bound):
                rest = way @ truth.G - weights @ truth.A if truth.G.shape[1] else zeros(0)
                assert total(way * truth.c) + total(weights * truth.b) + total(abs(rest)) <= exact(bound)[()]
        y = exact(proof.weights)
        contradiction = total(y * truth.b) + (total(abs(y @ truth.A)) if truth.G.shape[1] else 0)
        assert (contradiction < 0) == bool(proof.empty)
    return not truth.is_empty()


@both
def test_supports_and_hulls_are_bounds_and_tight(kind: type[AnySet]) -> None:
    every(_supports, kind, 1)


def _emptiness(kind: type[AnySet], rng: np.random.Generator) -> bool:
    one = draw(kind, rng)
    truth, said = body_of(one), bool(one.is_empty())
    empty = truth.is_empty()
    assert empty or not said
    if empty and Body(truth.c, truth.G, truth.A, truth.b, zeros(truth.n), truth.row_size).widened(EMPTY).is_empty():
        assert said
    return said or kind is Zonotope


@both
def test_emptiness_is_never_claimed_of_what_holds_a_point_and_told_where_it_is_clear(kind: type[AnySet]) -> None:
    every(_emptiness, kind, 2)


def _points(kind: type[AnySet], rng: np.random.Generator) -> bool:
    one = draw(kind, rng)
    truth = body_of(one)
    inside = [found[1] for d in ways(rng, truth.n, 1) if (found := truth.best(d)) is not None]
    inside += [(inside[0] + inside[-1]) / 2] if inside else []
    for point in inside:
        x = np.array([float(value) for value in point])
        assert one.contains_point(x)
        factors = exact(one.factors_of(x))
        assert all(abs(value) <= 1 for value in factors)
        shown = truth.c + (truth.G @ factors if len(factors) else 0)
        allowed = MEMBER * total(abs(truth.G).ravel()) + ROUNDING * total(abs(truth.c))
        assert all(abs(value) <= allowed for value in shown - exact(x))
    x = member(one, rng) + rng.normal(size=one.dimension) * rng.choice([1e-3, 1.0]) * np.abs(one.generators).sum()
    if not enlarged(truth, 4 * MEMBER).holds(exact(x)):
        assert not one.contains_point(x)
        assert np.isnan(one.factors_of(x)).all()
    return bool(inside)


@both
def test_points_are_told_apart(kind: type[AnySet]) -> None:
    every(_points, kind, 3)


def _containment(kind: type[AnySet], rng: np.random.Generator) -> bool:
    one = draw(kind, rng)
    truth = body_of(one)
    first = truth.best(exact(numbers(rng, one.dimension)))
    other: AnySet = draw(KINDS[int(rng.integers(2))], rng, one.dimension)
    known = False
    if first is not None and rng.random() < 0.7:
        x, known = np.array([float(value) for value in first[1]]), True
        inner: list[AnySet] = [one, one.scale(0.5).translate(x / 2), type(one).point(x), Zonotope.point(x)]
        other = inner[int(rng.integers(len(inner)))]
    elif rng.random() < 0.5:
        other = other.translate(one.center - other.center)
    said = bool(one.contains_set(other))
    if known:
        assert said
    elif said:
        wide = enlarged(truth, MEMBER)
        reached = [body_of(other).best(d) for d in ways(rng, truth.n)]
        assert all(wide.holds(found[1]) for found in reached if found is not None)
    return known


@both
def test_containment_is_shown_of_parts_and_never_of_more(kind: type[AnySet]) -> None:
    every(_containment, kind, 4)


def _disjointness(kind: type[AnySet], rng: np.random.Generator) -> bool:
    one = draw(kind, rng)
    other: Any = partner(kind, rng, one)
    both = rational.common(body_of(one), body_of(other), exact(np.eye(one.dimension)))
    meets = not both.is_empty()
    if meets:
        assert one.intersects(other)
    elif Body(both.c, both.G, both.A, both.b, zeros(both.n), both.row_size).widened(EMPTY).is_empty():
        assert not one.intersects(other)
    return meets


@both
def test_sets_that_meet_are_never_called_disjoint(kind: type[AnySet]) -> None:
    every(_disjointness, kind, 5)


def _planar(kind: type[AnySet], rng: np.random.Generator) -> bool:
    one = small(kind, rng, 2) if rng.random() < 0.7 else draw(kind, rng, 2, 2)
    truth = body_of(one)
    area, extent = rational.area(truth), total(abs(truth.G).ravel())
    loss = 4 * ROUNDING * extent**2
    inner, outer = (exact(value)[()] for value in one.area_bracket())
    # Rows that repeat others up to rounding say nothing more.
    assert inner <= area or inner <= rational.area(truth.widened(ROUNDING))
    assert area <= outer
    assert area <= exact(one.area())[()] + loss
    assert exact(one.area())[()] <= area + (Fraction(1, 10**8) * extent**2)
    assert tuple(map(float, one.volume_bracket())) == tuple(map(float, one.area_bracket()))
    if truth.is_empty():
        return False
    for corners in (one.polygon(), one.polygon(int(rng.integers(3, 9)))):
        _assert_around(exact(corners), truth, extent, rng)
    wide = enlarged(truth, Fraction(1, 10**8))
    assert all(wide.holds(corner) for corner in exact(one.polygon()))
    return True


def _assert_around(corners: Exact, truth: Body, extent: Fraction, rng: np.random.Generator) -> None:
    """The hull of the corners reaches as far as the set, in any direction, up to rounding."""
    for d in ways(rng, 2, 6):
        found = truth.best(d)
        assert found is not None
        missing = found[0] - max(total(d * corner) for corner in corners)
        assert missing <= ROUNDING * total(abs(d)) * (extent + max(abs(truth.c)))


@both
def test_areas_and_outlines_are_bounds(kind: type[AnySet]) -> None:
    every(_planar, kind, 6, share=2)


def _volume(kind: type[AnySet], rng: np.random.Generator) -> bool:
    one = draw(kind, rng, int(rng.choice([1, 3])))
    truth = body_of(one)
    inner, outer = one.volume_bracket()
    volume = one.volume()
    sizes = np.array([float(v) for v in abs(truth.G).sum(axis=1)]) if truth.G.shape[1] else np.zeros(truth.n)
    hull = float(np.prod(2 * sizes))
    points = [found[1] for d in ways(rng, truth.n, 10) if (found := truth.best(d)) is not None]
    attained, flat = 0.0, True
    if truth.n == 1 and points:
        attained = float(max(p[0] for p in points) - min(p[0] for p in points))
        # Rows that repeat others up to rounding say nothing more.
        blurred = [truth.widened(ROUNDING).best(d) for d in exact([[1], [-1]])]
        assert exact(inner)[()] <= total(end[0] for end in blurred if end is not None)
        assert attained <= outer
        assert exact(volume)[()] <= total(end[0] for end in blurred if end is not None) + Fraction(hull) / 10**8
    elif points and sizes.all():
        shape = np.array([[float(v) for v in p - truth.c] for p in points]) / sizes
        normal = np.linalg.svd(shape - shape[0])[2][-1] / sizes
        ends = [truth.best(exact(sign * normal)) for sign in (1.0, -1.0)]
        flat = total(end[0] for end in ends if end is not None) <= Fraction(1, 10**9)
        try:
            attained = 0.0 if flat else float(ConvexHull(shape).volume * np.prod(sizes))
        except QhullError:
            attained = 0.0
    assert attained * (1 - 1e-9) <= float(outer) + 1e-12 * hull
    assert attained * (1 - 1e-9) <= float(volume) + 1e-12 * hull
    assert 0 <= inner <= outer <= hull * (1 + 1e-9)
    if flat and truth.n == 3:
        assert inner <= 1e-8 * hull
    return bool(attained)


@both
def test_volumes_are_bounded(kind: type[AnySet]) -> None:
    every(_volume, kind, 7)


def _samples(kind: type[AnySet], rng: np.random.Generator) -> bool:
    one = draw(kind, rng)
    truth = body_of(one)
    for how in get_args(SampleMethod):
        points: FloatArray = one.sample(rng, 2, how)
        if not truth.is_empty():
            wide = enlarged(truth, Fraction(1, 10**8))
            assert all(wide.holds(exact(point)) for point in points)
    return not truth.is_empty()


@both
def test_samples_are_members(kind: type[AnySet]) -> None:
    every(_samples, kind, 8)


def test_strips_are_only_missed_where_no_point_is_in_them() -> None:
    met = 0
    for rng in generators(200, 9):
        one: Any = draw(Zonotope, rng)
        d = numbers(rng, one.dimension)
        found = body_of(one).best(exact(d))
        assert found is not None
        # The float next to the support touches, or misses by an ulp.
        q = float(found[0])
        for r in (0.0, 1e-12 * abs(q), 1.0):
            touches = found[0] >= Fraction(q) - Fraction(r)
            met += touches
            assert not touches or not one.misses_strip(d, q, r)
            away = 1e-6 * (abs(q) + float(np.abs(d) @ (np.abs(one.center) + np.abs(one.generators).sum(axis=-1)))) + r
            assert not d.any() or not away or one.misses_strip(d, q + 2 * away, r)
    assert met
