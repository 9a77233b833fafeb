"""Sets that touch or hold a single point stay what they are, and flat ones are asked and answered as others."""

import numpy as np
import pytest

from reach_server.sets import ConstrainedZonotope, Zonotope
from tests.reach_server.sets.degenerate import KINDS, AnySet, corner
from tests.reach_server.sets.rational import body_of

CENTERS = ([0.0, 0.0], [100.0, -50.0], [1e6, 1e6], [1e-3, 2e-3])
ANGLES = (0.0, 0.3, 1.2, np.pi / 2)
both = pytest.mark.parametrize("kind", KINDS, ids=["zonotope", "constrained"])


@pytest.mark.parametrize("n", [2, 3])
@pytest.mark.slow
def test_a_corner_cut_by_half_spaces_through_it_is_kept(n: int) -> None:
    inhabited = 0
    for seed in range(150):
        one = corner(np.random.default_rng(seed), n)
        if body_of(one).is_empty():
            continue
        inhabited += 1
        lower, upper = one.interval_hull()
        assert (lower <= upper).all(), seed
        again = one
        for _ in range(3):
            again = again.rescale()
            assert not again.is_empty(), seed
        for count in range(3):
            assert not one.reduce_constraints(count).is_empty(), seed
        held = one.enclosing_zonotope().interval_hull()
        assert (held[0] <= upper).all()
        assert (held[1] >= lower).all()
    assert inhabited > 100


@pytest.mark.parametrize("angle", ANGLES)
@pytest.mark.parametrize("center", CENTERS, ids=str)
def test_a_segment_contains_its_half_and_no_square(center: list[float], angle: float) -> None:
    along = np.array([[np.cos(angle)], [np.sin(angle)]])
    middle = np.array(center)
    segment, half = Zonotope(middle, 2 * along), Zonotope(middle, along)
    constrained = ConstrainedZonotope.from_zonotope(segment)
    square = ConstrainedZonotope.box(middle - 0.1, middle + 0.1)
    for outer in (segment, constrained):
        assert outer.contains_set(half)
        assert outer.contains_set(ConstrainedZonotope.from_zonotope(half))
        assert outer.contains_set(outer)
        assert not outer.contains_set(square)
        assert not half.contains_set(outer)


@pytest.mark.parametrize("n", [1, 2, 3, 4])
@both
def test_sets_without_generators_contain_and_meet_themselves_alone(kind: type[AnySet], n: int) -> None:
    x = np.linspace(100.0, -50.0, n)
    for other_kind in KINDS:
        point, same, away = kind.point(x), other_kind.point(x), other_kind.point(x + 1e-3)
        assert point.contains_set(same)
        assert not point.contains_set(away)
        if other_kind is kind or kind is ConstrainedZonotope:
            assert point.intersects(same)  # type: ignore[arg-type]
            assert not point.intersects(away)  # type: ignore[arg-type]
    batch = kind.point(np.zeros((0, n)))
    assert batch.contains_set(batch).shape == (0,)


@both
def test_a_far_away_point_survives_a_strip_without_width_through_it(kind: type[AnySet]) -> None:
    x = np.array([1e9, 1e9])
    point = kind.point(x)
    for seed in range(300):
        normal = np.random.default_rng(seed).normal(size=2)
        cut = point.intersect_strip(normal, float(normal @ x), 0.0)
        assert not cut.is_empty(), seed
        assert cut.contains_point(x), seed
        held = body_of(cut).best(body_of(cut).c * 0)
        assert held is not None, f"{seed}: no factors at all solve the new row"


def test_a_preimage_ties_down_no_factor_by_rounding() -> None:
    lost = 0
    for seed in range(100):
        rng = np.random.default_rng(seed)
        # Exactly, (a, b, -a - b) times (x, x, x) is 0; products and sums are rounded on the way there.
        a, b = rng.integers(1, 2**30, 2).astype(float)
        M, x = np.array([[a, b, -(a + b)]]), rng.normal(size=2)
        one = ConstrainedZonotope(np.full(3, x[0]), np.full((3, 1), x[1]), np.zeros((0, 1)), np.zeros(0))
        lost += bool((M @ one.generators).any())
        kept = one.intersection(ConstrainedZonotope.point([0.0]), M)
        assert not kept.is_empty()
        np.testing.assert_allclose(kept.interval_hull(), one.interval_hull(), rtol=1e-12)
        assert kept.contains_point(one.center + one.generators[:, 0])
    assert lost


def test_tolerances_of_containment_are_those_of_the_sets() -> None:
    point, flat = ConstrainedZonotope.point(np.zeros(3)), ConstrainedZonotope.box([-1.0, -1.0, 0.0], [1.0, 1.0, 0.0])
    for size in (1e-9, 1e-20):
        needle = Zonotope(np.zeros(3), size * np.array([[-2.0], [2.0], [1.0]]))
        assert not point.contains_set(needle)
        assert not flat.contains_set(needle)
        assert flat.contains_set(needle.linear_map(np.diag([1.0, 1.0, 0.0])))
