"""Set in set, and set meets set, against linear programs and Shapely."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.optimize import linprog
from shapely import MultiPoint

from reach_server.numeric.types import FloatArray
from reach_server.sets import ConstrainedZonotope, SetError, Zonotope
from tests.reach_server.ugly import ZONOTOPES, Raw, corners, gap, moderate, named, random_sets

every = pytest.mark.parametrize("case", ZONOTOPES, ids=named)


def grown(case: Raw, factor: float) -> Zonotope:
    return Zonotope(case.c, factor * case.G)


def random_pair(seed: int, n: int) -> tuple[Zonotope, Zonotope]:
    rng = np.random.default_rng(seed)
    outer = Zonotope(rng.normal(size=n) * 0.2, rng.normal(size=(n, rng.integers(1, 7))))
    size = rng.choice([0.1, 0.4, 0.8])
    return outer, Zonotope(rng.normal(size=n) * size, size * rng.normal(size=(n, rng.integers(0, 4))))


def worst(outer: Zonotope, inner: Zonotope) -> float:
    """How far the inner set's corners are from the outer one: 0 where it is contained."""
    target = Raw("", outer.center, outer.generators, np.zeros((0, outer.generators.shape[1])), np.zeros(0))
    points = corners(Raw("", inner.center, inner.generators, np.zeros((0, inner.generators.shape[1])), np.zeros(0)))
    return max(gap(target, point) for point in points)


@every
def test_a_set_holds_itself_its_center_and_what_it_shrinks_to(case: Raw) -> None:
    z = case.zonotope()
    assert z.contains_set(z)
    assert z.contains_set(Zonotope.point(case.c))
    assert z.contains_set(grown(case, 0.7))
    assert z.contains_set(z.simplify())
    if case.G.any():
        # A coordinate on which the set is small and far from the origin cannot tell so little.
        assert not z.contains_set(grown(case, 1.01))
        assert not z.contains_set(z.translate(0.02 * np.abs(case.G).sum(axis=1)))
        assert grown(case, 1.01).contains_set(z)
    for order in (1, 1.5):
        assert z.reduce_order(order).contains_set(z)


@pytest.mark.parametrize("n", [1, 2, 3, 4])
def test_true_is_certain_and_in_the_plane_false_is_too(n: int) -> None:
    shown, contained = 0, 0
    for seed in range(60):
        outer, inner = random_pair(seed, n)
        excess = worst(outer, inner)
        answer = bool(outer.contains_set(inner))
        if answer:
            assert excess <= 1e-6
        if n <= 2:
            assert answer == (excess <= 1e-7)
        shown, contained = shown + answer, contained + (excess <= 1e-7)
    assert contained > 3
    # The sufficient condition misses little.
    assert shown >= 0.6 * contained


def test_the_linear_program_finds_what_least_norm_factors_do_not() -> None:
    rng = np.random.default_rng(0)
    outer = Zonotope(np.zeros(3), rng.normal(size=(3, 8)))
    # A vertex is reached by factors of ±1 alone; those of least norm are others.
    signs = np.sign(rng.normal(size=3) @ outer.generators)[:, None]
    assert outer.contains_set(Zonotope(np.zeros(3), outer.generators @ signs))
    assert not outer.contains_set(Zonotope(np.zeros(3), 1.001 * outer.generators @ signs))


def test_constrained_sets_in_zonotopes() -> None:
    square = np.eye(2)
    corner = ConstrainedZonotope(np.zeros(2), 3 * square, np.array([[1.0, 0.0], [0.0, 1.0]]), np.array([0.2, 0.3]))
    assert Zonotope(np.zeros(2), square).contains_set(corner)
    assert not Zonotope(np.zeros(2), 0.5 * square).contains_set(corner)
    flat = Zonotope(np.zeros(3), 3 * np.eye(3))
    free = ConstrainedZonotope(np.zeros(3), 2 * np.eye(3), np.ones((1, 3)), np.zeros(1))
    assert flat.contains_set(free)


@moderate
@given(random_sets(n=2, rows=0), random_sets(n=2, rows=0), st.floats(0, 2))
def test_meeting_in_the_plane_agrees_with_shapely(a: Raw, b: Raw, apart: float) -> None:
    size = a.size + b.size
    # Among the last digits that there are, Shapely's distances are none.
    assume(size == 0 or size > 1e-280)
    moved = Zonotope(b.c + apart * size * np.array([0.6, 0.8]), b.G)
    first = MultiPoint(corners(a)).convex_hull
    second = MultiPoint(corners(b) + moved.center - b.c).convex_hull
    distance = first.distance(second) / size
    meets = bool(a.zonotope().intersects(moved))
    assert meets == bool(moved.intersects(a.zonotope()))
    # Of points far away the distance may be one of rounding alone.
    if distance > 1e-9 and distance * size > 1e-13 * np.abs(a.c).max():
        assert not meets
    if distance == 0 and first.intersection(second).area > 1e-9 * size**2:
        assert meets


@pytest.mark.parametrize("n", [1, 3, 4])
def test_meeting_agrees_with_linear_programs(n: int) -> None:
    answers = []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        a, b = rng.normal(size=(n, 4)), rng.normal(size=(n, 3))
        shift = rng.normal(size=n) * rng.uniform(0, 5)
        joined = np.concatenate([a, b], axis=1)
        found = linprog(
            np.append(np.zeros(7), 1.0),
            A_ub=np.block([[np.eye(7), -np.ones((7, 1))], [-np.eye(7), -np.ones((7, 1))]]),
            b_ub=np.zeros(14),
            A_eq=np.column_stack([joined, np.zeros(n)]),
            b_eq=shift,
            bounds=(None, None),
        )
        assert found.fun is not None
        meets = bool(Zonotope(np.zeros(n), a).intersects(Zonotope(shift, b)))
        assert meets == (found.fun <= 1)
        answers.append(meets)
    assert 0.05 < np.mean(answers) < 0.95


@every
def test_sets_that_touch_are_not_called_disjoint(case: Raw) -> None:
    z = case.zonotope()
    for direction in np.eye(case.n):
        signs = np.sign(direction @ case.G)
        touching = z.translate(2 * case.G @ signs)
        assert z.intersects(touching)
        if (direction @ case.G).any():
            assert not z.intersects(z.translate((2 + 1e-3) * case.G @ signs))
    assert z.intersects(z)


@pytest.mark.parametrize("n", [2, 3])
@pytest.mark.parametrize("shape", [(), (5,), (2, 3), (0,)], ids=str)
def test_a_batch_gives_what_its_members_give(n: int, shape: tuple[int, ...]) -> None:
    rng = np.random.default_rng(4)

    def sets(size: float, g: int) -> tuple[FloatArray, FloatArray]:
        return size * rng.normal(size=(*shape, n)), size * rng.normal(size=(*shape, n, g))

    (c, G), (c2, G2) = sets(1.0, 6), sets(0.3, 3)
    far = 6 * c2
    holds = Zonotope(c, G).contains_set(Zonotope(c2, G2))
    meets = Zonotope(c, G).intersects(Zonotope(far, G2))
    assert holds.shape == meets.shape == shape
    for place in np.ndindex(*shape):
        one = Zonotope(c[place], G[place])
        assert holds[place] == one.contains_set(Zonotope(c2[place], G2[place]))
        assert meets[place] == one.intersects(Zonotope(far[place], G2[place]))


def test_sets_of_other_spaces_and_kinds_are_refused() -> None:
    z = Zonotope(np.zeros(2), np.eye(2))
    with pytest.raises(SetError, match="other has dimension 3, expected 2"):
        z.contains_set(Zonotope(np.zeros(3), np.eye(3)))
    with pytest.raises(SetError, match="other has dimension 3, expected 2"):
        z.intersects(Zonotope(np.zeros(3), np.eye(3)))
    with pytest.raises(SetError, match="other is a ConstrainedZonotope"):
        z.intersects(ConstrainedZonotope.from_zonotope(z))  # type: ignore[arg-type]
