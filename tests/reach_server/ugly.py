"""Sets that operations go wrong on, and slow oracles: corners of the factor box and linear programs by HiGHS."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from hypothesis import settings
from hypothesis import strategies as st
from scipy.optimize import linprog
from shapely import MultiPoint

from reach_server.numeric.types import FloatArray
from reach_server.sets import ConstrainedZonotope, Zonotope
from tests.examples import examples

#: ``lower <= normal·x <= upper``
Strip = tuple[FloatArray, float, float]

#: What linear programs and sums of a few terms leave, relative to the size of a set.
ROUNDING = 1e-6

moderate = settings(max_examples=examples(60))


@dataclass(frozen=True, eq=False)
class Raw:
    """``{c + Gβ : Aβ = b, |β| <= 1}`` as plain arrays; ``inhabited`` by construction or not."""

    name: str
    c: FloatArray
    G: FloatArray
    A: FloatArray
    b: FloatArray
    inhabited: bool = True

    @property
    def n(self) -> int:
        return len(self.c)

    @property
    def size(self) -> float:
        """An upper bound of how far the set reaches from its center, and at least the rounding of the center."""
        return float(np.abs(self.G).sum() + 1e-8 * np.abs(self.c).sum() + 1e-300)

    def zonotope(self) -> Zonotope:
        return Zonotope(self.c, self.G)

    def constrained(self) -> ConstrainedZonotope:
        return ConstrainedZonotope(self.c, self.G, self.A, self.b)


def raw(name: str, c: Sequence[float], G: Sequence[Sequence[float]], scale: float = 1.0) -> Raw:
    generators = np.array(G, dtype=np.float64).reshape(len(c), -1) * scale
    return Raw(name, np.array(c, dtype=np.float64) * scale, generators, np.zeros((0, generators.shape[1])), np.zeros(0))


_SQUARE = [[1.0, 0.5, -0.3], [0.2, -1.0, 0.7]]
_RNG = np.random.default_rng(2024)

ZONOTOPES: tuple[Raw, ...] = (
    raw("a point without generators", [1.0, -2.0], [[], []]),
    raw("a point with zero generators", [1.0, -2.0], [[0, 0, 0], [0, 0, 0]]),
    raw("a segment", [0.5, 0.25], [[1.0], [1 / 3]]),
    raw("a segment of parallel generators", [0.0, 0.0], [[1.0, -0.7, 0.1], [1 / 3, -0.7 / 3, 0.1 / 3]]),
    raw("a segment along an axis", [0.0, 3.0], [[2.0, 1.0], [0.0, 0.0]]),
    raw("one dimension", [3.0], [[1.0, -0.5]]),
    raw("a point in one dimension", [3.0], [[]]),
    raw("flat in three dimensions", [0.0, 1.0, 2.0], [[1, 0, 1], [0, 1, 1], [0, 0, 0]]),
    raw("fewer generators than dimensions", [0.0, 1.0, 2.0], [[1, 0.3], [0.2, 1], [-0.5, 0.4]]),
    raw("equal generators", [0.0, 0.0], [[1, 1, 0.5, 1], [0, 0, 1, 0]]),
    raw("a zero generator among others", [0.0, 0.0], [[1, 0, 0.5], [0.3, 0, 1]]),
    raw("tiny", [1.0, -1.0], _SQUARE, 1e-12),
    raw("huge", [1.0, -1.0], _SQUARE, 1e12),
    raw("huge and tiny", [0.0, 0.0], [[1e12, 0.5, 1e-12], [1e-12, 1.0, 0.0]]),
    raw("small and far away", [1e6, -1e6], [[1e-3, 5e-4], [0.0, 1e-3]]),
    raw("a box", [0.5, -0.5], [[1.5, 0.0], [0.0, 0.5]]),
    raw("plain in the plane", [0.1, 0.2], _RNG.normal(size=(2, 6)).tolist()),
    raw("plain in three dimensions", [0.1, 0.2, 0.3], _RNG.normal(size=(3, 5)).tolist()),
    raw("plain in four dimensions", [0.1, 0.2, 0.3, 0.4], _RNG.normal(size=(4, 7)).tolist()),
)


def _rows(base: Raw, name: str, A: FloatArray, b: FloatArray, *, inhabited: bool = True) -> Raw:
    return Raw(f"{base.name}, {name}", base.c, base.G, A, b, inhabited)


def _constrained(base: Raw) -> list[Raw]:
    g = base.G.shape[1]
    rng = np.random.default_rng(g + 10 * base.n)
    A = rng.normal(size=(2, g))
    inner = A @ rng.uniform(-0.9, 0.9, g)
    ones = np.ones((1, g))
    found = [
        base,
        _rows(base, "zero row", np.zeros((1, g)), np.zeros(1)),
        _rows(base, "zero row that cannot hold", np.zeros((1, g)), np.ones(1), inhabited=False),
        _rows(base, "two rows", A, inner),
    ]
    if g:
        found += [
            _rows(base, "repeated rows", np.concatenate([A, A[:1], -2 * A[1:]]), np.r_[inner, inner[0], -2 * inner[1]]),
            _rows(base, "a corner alone", ones, np.array([float(g)])),
            _rows(base, "beyond every corner", ones, np.array([g + 1.0]), inhabited=False),
            _rows(base, "just beyond every corner", ones, np.array([g * (1 + 1e-5)]), inhabited=False),
            _rows(base, "tiny rows", 1e-12 * A, 1e-12 * inner),
            _rows(base, "huge rows", 1e12 * A, 1e12 * inner),
            _rows(base, "huge rows that cannot hold", 1e12 * ones, np.array([1.5e12 * g]), inhabited=False),
            _rows(base, "rows of unlike size", A * [[1e-9], [1e9]], inner * [1e-9, 1e9]),
            _rows(
                base, "rows that contradict", np.concatenate([ones, ones]), np.array([0.5, -0.5]), inhabited=False
            ),
            _rows(base, "as many rows as generators", np.eye(g), np.linspace(-1, 1, g)),
        ]  # fmt: skip
    return found


CONSTRAINED: tuple[Raw, ...] = tuple(case for base in ZONOTOPES for case in _constrained(base))
INHABITED: tuple[Raw, ...] = tuple(case for case in CONSTRAINED if case.inhabited)
EMPTY: tuple[Raw, ...] = tuple(case for case in CONSTRAINED if not case.inhabited)


def named(case: Raw) -> str:
    return case.name


def of(zonotope: Zonotope | ConstrainedZonotope) -> Raw:
    """Plain arrays of one set (batch ``()``)."""
    g = zonotope.generators.shape[-1]
    if isinstance(zonotope, Zonotope):
        return Raw("", zonotope.center, zonotope.generators, np.zeros((0, g)), np.zeros(0))
    return Raw("", zonotope.center, zonotope.generators, zonotope.constraint_matrix, zonotope.constraint_offset)


def factor_corners(g: int, limit: int = 256) -> FloatArray:
    """All corners (2^g, g) of the factor box, or ``limit`` of them."""
    if not g:
        return np.zeros((1, 0))
    if 2**g <= limit:
        return np.array(list(product((-1.0, 1.0), repeat=g))).reshape(-1, g)
    return np.sign(np.random.default_rng(g).uniform(-1, 1, (limit, g)))


def corners(case: Raw) -> FloatArray:
    """Images (K, n) of the corners of the factor box; their convex hull is the zonotope."""
    return np.asarray(case.c + factor_corners(case.G.shape[1]) @ case.G.T)


def directions(n: int, count: int = 12, seed: int = 0) -> FloatArray:
    """Both ways along the axes, and random directions."""
    random = np.random.default_rng(seed).normal(size=(count, n))
    return np.concatenate([np.eye(n), -np.eye(n), random])


def extreme(case: Raw, direction: FloatArray, strips: Sequence[Strip] = ()) -> tuple[float, FloatArray] | None:
    """Greatest ``direction·x`` over the set (cut by strips) and where it is taken; None if the set is empty."""
    g = case.G.shape[1]
    if not g:
        meets = not case.b.any() and all(lo <= float(h @ case.c) <= hi for h, lo, hi in strips)
        return (float(direction @ case.c), case.c) if meets else None
    rows, right = [], []
    for normal, lower, upper in strips:
        height, middle = normal @ case.G, float(normal @ case.c)
        scale = np.abs(height).max() or 1.0
        for sign, bound in ((1.0, upper), (-1.0, -lower)):
            if np.isfinite(bound):
                rows.append(sign * height / scale)
                right.append((bound - sign * middle) / scale)
    scale = np.where(case.A.any(axis=1), np.abs(case.A).max(axis=1, initial=0.0), 1.0)
    cost = direction @ case.G
    found = linprog(
        -cost / (np.abs(cost).max() or 1.0),
        A_ub=np.array(rows) if rows else None,
        b_ub=np.array(right) if rows else None,
        A_eq=case.A / scale[:, None] if len(case.A) else None,
        b_eq=case.b / scale if len(case.A) else None,
        bounds=(-1, 1),
        method="highs",
    )
    if found.status != 0 or found.x is None:
        return None
    point = case.c + case.G @ found.x
    return float(direction @ point), point


def gap(case: Raw, point: FloatArray, source: Raw | None = None) -> float:
    """How far a point is from the set, relative to its size (or that of the larger set that it was made from): 0
    inside; a linear program that is always feasible."""
    stacked = np.concatenate([case.G, case.A])
    target = np.concatenate([point - case.c, case.b])
    floor = np.concatenate([1e-8 * np.abs(case.c), np.zeros(len(case.b))])
    size = np.maximum(np.abs(stacked).sum(axis=1), np.maximum(floor, 1e-300))
    # A coordinate in which the set is a point is measured by the set's other sizes.
    size[: case.n] = np.maximum(size[: case.n], 1e-9 * case.size)
    if source is not None:
        size[: case.n] = np.maximum(size[: case.n], np.abs(source.G).sum(axis=1) + 1e-8 * np.abs(source.c))
    stacked, target = stacked / size[:, None], target / size
    g = stacked.shape[1]
    if not g:
        return float(np.abs(target).max(initial=0.0))
    one = np.ones((len(stacked), 1))
    found = linprog(
        np.append(np.zeros(g), 1.0),
        A_ub=np.block([[stacked, -one], [-stacked, -one]]),
        b_ub=np.concatenate([target, -target]),
        bounds=[(-1, 1)] * g + [(0, None)],
        method="highs",
    )
    assert found.status == 0, found.message
    assert found.fun is not None
    return float(found.fun)


def assert_holds(outer: Raw, points: FloatArray, source: Raw | None = None) -> None:
    """Every point (K, n) lies in the set, up to the rounding of the set that it was made from."""
    for point in np.unique(points, axis=0):
        assert gap(outer, point, source) <= ROUNDING


def assert_outlines(vertices: FloatArray, points: FloatArray, size: float) -> None:
    """The convex hull of the vertices (V, 2) holds every point (K, 2)."""
    origin = points.mean(axis=0)
    hull = MultiPoint((vertices - origin) / size).convex_hull
    assert hull.buffer(ROUNDING).covers(MultiPoint((points - origin) / size))


def members(case: Raw, count: int = 6, strips: Sequence[Strip] = (), seed: int = 0) -> FloatArray:
    """Extreme points (K, n) of the set (cut by strips) and mixtures of them; none if it is empty."""
    found = [extreme(case, d, strips) for d in directions(case.n, count, seed)]
    points = np.array([f[1] for f in found if f is not None]).reshape(-1, case.n)
    if not len(points):
        return points
    weights = np.random.default_rng(seed).dirichlet(np.ones(len(points)), size=3)
    return np.concatenate([points, weights @ points])


def batched(case: Raw, shape: tuple[int, ...]) -> Raw:
    """The same set at every place of a batch, moved and stretched differently."""
    rng = np.random.default_rng(7)
    stretch = rng.uniform(0.5, 2.0, shape)
    c = case.c + case.size * rng.normal(size=(*shape, case.n))
    return Raw(
        case.name,
        c,
        case.G * stretch[..., None, None],
        np.broadcast_to(case.A, (*shape, *case.A.shape)),
        np.broadcast_to(case.b, (*shape, *case.b.shape)),
    )


def at(case: Raw, place: tuple[int, ...]) -> Raw:
    """One set of a batch."""
    return Raw(case.name, case.c[place], case.G[place], case.A[place], case.b[place])


_ENTRIES = st.one_of(st.sampled_from([0.0, 1.0, -1.0, 0.5]), st.floats(-3, 3, allow_subnormal=False))


@st.composite
def random_sets(draw: st.DrawFn, n: int | None = None, rows: int = 3) -> Raw:
    """Sets of any kind that hold at least the image of one drawn factor."""
    n = n or draw(st.integers(1, 3))
    g = draw(st.integers(0, 6))
    scale = draw(st.sampled_from([1e-9, 1.0, 1e9]))

    def array(*shape: int) -> FloatArray:
        count = int(np.prod(shape))
        return np.array(draw(st.lists(_ENTRIES, min_size=count, max_size=count)), dtype=np.float64).reshape(shape)

    c, G = array(n) * scale, array(n, g) * scale
    count = draw(st.integers(0, rows)) if g else 0
    # Entries below the tolerance of HiGHS would make its answers wrong, which are the oracle.
    A = np.round(array(count, g), 3)
    factor = np.clip(array(g), -1, 1)
    return Raw("random", c, G, A, A @ factor)
