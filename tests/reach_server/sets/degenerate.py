"""Sets that touch, are flat, single points, empty, far away, huge or tiny, with repeated rows or without generators."""

from collections.abc import Iterator

import numpy as np

from reach_server.numeric.types import FloatArray
from reach_server.sets import ConstrainedZonotope, Zonotope
from tests.examples import examples, seed

AnySet = Zonotope | ConstrainedZonotope
KINDS: tuple[type[AnySet], ...] = (Zonotope, ConstrainedZonotope)


def generators(count: int, *salt: int, share: int = 1) -> Iterator[np.random.Generator]:
    """Random numbers for each example of a property: the same ones in every run, unless another seed is asked for. Of
    those that take long, one in ``share``."""
    for example in range(max(examples(count) // share, 1)):
        yield np.random.default_rng([seed(), example, *salt])


def numbers(rng: np.random.Generator, *shape: int) -> FloatArray:
    """Numbers with few digits, so that sums are exact and things touch, or with all digits; some are zero."""
    if rng.random() < 0.6:
        return rng.integers(-4, 5, shape) / 2.0
    return np.where(rng.random(shape) < 0.15, 0.0, rng.normal(size=shape))


def zonotope(rng: np.random.Generator, n: int, most: int = 3) -> Zonotope:
    """A zonotope of one of the kinds in which rounding shows."""
    scale = 10.0 ** rng.choice([0, 0, 0, -9, 9, -3])
    center = scale * rng.choice([0, 1, 1, 1e3, 1e9]) * numbers(rng, n)
    g = int(rng.integers(0, most + 1))
    G = numbers(rng, n, g)
    kind = rng.integers(8)
    if kind == 0:
        G = np.zeros((n, g))
    elif kind == 1:
        G = numbers(rng, n, 1) * numbers(rng, g)
    elif kind == 2:
        G = np.diag(np.abs(numbers(rng, n)))
    elif kind == 3:
        G[rng.integers(n)] = 0.0
    elif kind == 4 and g > 1:
        G[:, -1] = G[:, 0] * rng.choice([1.0, -1.0, 1 / 3])
    elif kind == 5 and g:
        G[:, 0] *= 1e-9
    return Zonotope(center, scale * G)


def rows(rng: np.random.Generator, g: int) -> tuple[FloatArray, FloatArray]:
    """Constraints of one of the kinds in which rounding shows."""
    count = int(rng.integers(1, 3))
    A = numbers(rng, count, g)
    factors = np.clip(numbers(rng, g), -1.0, 1.0)
    kind = rng.integers(10)
    if kind == 0:
        A = np.zeros((count, g))
    elif kind == 1:
        # One corner of the factors alone.
        factors = np.where(A[0] < 0, -1.0, 1.0)
    elif kind == 2:
        A = np.concatenate([A, A[:1] * rng.choice([1.0, -2.0, 1 / 3])])
    elif kind == 3 and g:
        A = np.eye(g)[: count + 1]
    elif kind == 4:
        A = A * rng.choice([1e-9, 1e-3, 1e6])
    b = A @ factors if g else np.zeros(len(A))
    if kind == 5:
        b = b + rng.choice([1e-3, 1.0, 10.0])
    elif kind == 6:
        A, b = np.concatenate([A, A[:1]]), np.concatenate([b, b[:1] + 1.0])
    return A, b


def corner(rng: np.random.Generator, n: int) -> ConstrainedZonotope:
    """A box cut by half-spaces through one of its corners: that corner alone, an edge or a face, or more."""
    half = np.abs(numbers(rng, n)) + 0.25
    middle = numbers(rng, n) * rng.choice([1.0, 1.0, 1e3])
    box = ConstrainedZonotope.box(middle - half, middle + half)
    side = np.where(rng.random(n) < 0.5, -1.0, 1.0)
    H = np.abs(numbers(rng, int(rng.integers(1, 4)), n)) * side
    return box.intersect_tangents(-H, -(H @ (middle + side * half)))


def constrained(rng: np.random.Generator, n: int, most: int = 3) -> ConstrainedZonotope:
    """A constrained zonotope of one of the kinds in which rounding shows."""
    kind = rng.integers(8)
    if kind <= 1:
        return corner(rng, n)
    plain = ConstrainedZonotope.from_zonotope(zonotope(rng, n, most))
    if kind == 2:
        return plain
    return ConstrainedZonotope(plain.center, plain.generators, *rows(rng, plain.generators.shape[-1]))


def member(one: Zonotope | ConstrainedZonotope, rng: np.random.Generator) -> FloatArray:
    """A point of the zonotope, on its border as often as not, up to rounding."""
    g = one.generators.shape[-1]
    factors = np.sign(rng.normal(size=g)) if rng.random() < 0.5 else rng.uniform(-1, 1, g)
    return np.asarray(one.center + one.generators @ factors)


def draw(kind: type[AnySet], rng: np.random.Generator, n: int | None = None, most: int = 3) -> AnySet:
    n = n or int(rng.integers(1, 4))
    return zonotope(rng, n, most) if kind is Zonotope else constrained(rng, n, most)


def small(kind: type[AnySet], rng: np.random.Generator, n: int) -> AnySet:
    """A set of at most two factors."""
    plain = zonotope(rng, n, 2)
    if kind is Zonotope:
        return plain
    count = plain.generators.shape[-1]
    A, b = rows(rng, count) if rng.random() < 0.7 else (np.zeros((0, count)), np.zeros(0))
    return ConstrainedZonotope(plain.center, plain.generators, A, b)


def partner(kind: type[AnySet], rng: np.random.Generator, one: AnySet, n: int | None = None) -> AnySet:
    """Another set: any, the set itself, or one of its points."""
    n = n or one.dimension
    if n != one.dimension or rng.random() < 0.5:
        return draw(kind, rng, n, 2)
    if rng.random() < 0.3:
        return one
    other = draw(kind, rng, n, 2)
    return other.translate(member(one, rng) - member(other, rng))


def matrix_for(rng: np.random.Generator, one: AnySet) -> FloatArray:
    k = int(rng.integers(1, 4))
    M = numbers(rng, k, one.dimension)
    return np.zeros_like(M) if rng.random() < 0.1 else M


def normal_and_heights(rng: np.random.Generator, one: AnySet) -> tuple[FloatArray, float, float]:
    """A normal, a height of the set along it or beside it, and its reach."""
    H = numbers(rng, one.dimension) * 10.0 ** rng.choice([0, 0, -6, 6])
    if rng.random() < 0.1:
        H = np.zeros(one.dimension)
    reach = float(np.abs(H @ one.generators).sum())
    middle = float(H @ one.center)
    share = rng.choice([-1.0, 1.0, 0.0, -1.5, 2.0, rng.uniform(-1, 1)])
    return H, middle + share * reach, reach
