"""Sets and linear programs over the rationals: floating-point numbers are taken as the fractions that they are.

Slow, and right to the last digit; what the sets' operations are held against where rounding decides.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from math import lcm
from typing import Any

import numpy as np
from numpy.typing import NDArray

from reach_server.numeric.types import FloatArray
from reach_server.sets import ConstrainedZonotope, Zonotope

#: Arrays of ``Fraction`` (or, inside the solver, of ``int``).
Exact = NDArray[Any]


def exact(values: Any) -> Exact:
    """Numbers as the fractions that they are, in an array of the same shape."""
    array = np.asarray(values, dtype=object)
    flat = [value if isinstance(value, Fraction) else Fraction(value) for value in array.ravel().tolist()]
    result = np.empty(len(flat), dtype=object)
    result[:] = flat
    return result.reshape(array.shape)


def zeros(*shape: int) -> Exact:
    """An array of zeros."""
    return np.full(shape, Fraction(0), dtype=object)


def total(values: Iterable[Fraction]) -> Fraction:
    """The sum, exact."""
    return sum(values, Fraction(0))


def rows_of(*blocks: Sequence[Exact]) -> Exact:
    """A block matrix."""
    return np.concatenate([np.concatenate(list(block), axis=1) for block in blocks], axis=0)


def maximise(cost: Exact, matrix: Exact, right: Exact) -> tuple[Fraction, Exact] | None:
    """Greatest ``cost·z`` over ``matrix z = right``, ``|z| <= 1``, and such a z; None where there is none: exact.

    The dual simplex method for variables in boxes with the rule of least indices, which ends; integers with a common
    denominator, which divide without remainder. Rows start with a variable of their own that is fixed at 0.
    """
    m, g = matrix.shape
    table = np.zeros((m + 1, g + 1), dtype=object)
    for i in range(m + 1):
        row = [*matrix[i].tolist(), right[i]] if i < m else [*cost.tolist(), Fraction(0)]
        common = lcm(*(value.denominator for value in row))
        table[i] = [value.numerator * (common // value.denominator) for value in row]
    scale = 1
    basis = list(range(g, g + m))
    place = np.where(np.array([bool(value >= 0) for value in table[m, :g]], dtype=bool), 1, -1).astype(object)
    while True:
        values = table[:m, g] - (table[:m, :g] @ place if g else 0)
        wrong = [i for i in range(m) if abs(values[i]) > (scale if basis[i] < g else 0)]
        if not wrong:
            break
        r = min(wrong, key=basis.__getitem__)
        side = 1 if values[r] > 0 else -1
        entering = -1
        for j in range(g):
            if place[j] * table[r, j] * side < 0 and (
                entering < 0 or abs(table[m, j] * table[r, entering]) < abs(table[m, entering] * table[r, j])
            ):
                entering = j
        if entering < 0:
            return None
        pivot = table[r, entering]
        chosen = table[r].copy()
        table = (table * pivot - np.outer(table[:, entering], chosen)) // scale
        table[r] = chosen
        scale = pivot
        if scale < 0:
            table, scale = -table, -scale
        if basis[r] < g:
            place[basis[r]] = side
        basis[r], place[entering] = entering, 0
    point = exact(place)
    for i in range(m):
        if basis[i] < g:
            point[basis[i]] = Fraction(values[i], scale)
    return total(cost * point), point


@dataclass(frozen=True, eq=False)
class Body:
    """``{c + Gβ : Aβ = b, |β| <= 1}`` over the rationals.

    ``size`` (n) and ``row_size`` (c) are sums of the absolute values that went into each coordinate and each row: what
    rounding is relative to.
    """

    c: Exact
    G: Exact
    A: Exact
    b: Exact
    size: Exact
    row_size: Exact

    @property
    def n(self) -> int:
        return len(self.c)

    def best(self, d: Exact) -> tuple[Fraction, Exact] | None:
        """Greatest ``d·x`` and where it is taken; None where the set is empty."""
        found = maximise(d @ self.G if self.G.shape[1] else zeros(0), self.A, self.b)
        if found is None:
            return None
        point = self.c + (self.G @ found[1] if self.G.shape[1] else 0)
        return total(d * point), point

    def is_empty(self) -> bool:
        return self.best(zeros(self.n)) is None

    def widened(self, share: Fraction) -> "Body":
        """The set with every coordinate and every row off by at most ``share`` of what went into it."""
        n, g, rows = self.n, self.G.shape[1], len(self.b)
        space, slack = np.diag(share * self.size) + zeros(n, n), np.diag(share * self.row_size) + zeros(rows, rows)
        used = [i for i in range(n) if self.size[i]]
        tight = [i for i in range(rows) if self.row_size[i]]
        return Body(
            self.c,
            rows_of([self.G, space[:, used], zeros(n, len(tight))]),
            rows_of([self.A.reshape(rows, g), zeros(rows, len(used)), slack[:, tight]]),
            self.b, self.size, self.row_size,
        )  # fmt: skip

    def holds(self, point: Exact) -> bool:
        """Is the point in the set?"""
        matrix = rows_of([self.G], [self.A])
        right = np.concatenate([point - self.c, self.b])
        return maximise(zeros(matrix.shape[1]), matrix, right) is not None


def body(c: Any, G: Any, A: Any = None, b: Any = None) -> Body:
    """A set of these arrays."""
    center, generators = exact(c), exact(G)
    matrix = exact(A) if A is not None else zeros(0, generators.shape[1])
    offset = exact(b) if b is not None else zeros(0)
    size = abs(center) + (abs(generators).sum(axis=1) if generators.shape[1] else 0)
    row_size = abs(offset) + (abs(matrix).sum(axis=1) if matrix.shape[1] else 0)
    return Body(center, generators, matrix, offset, exact(size), exact(row_size))


def body_of(one: Zonotope | ConstrainedZonotope, place: tuple[int, ...] = ()) -> Body:
    """One set of a batch."""

    def entry(array: FloatArray, own: int) -> FloatArray:
        return np.asarray(np.broadcast_to(array, one.batch + array.shape[array.ndim - own :])[place])

    c, G = entry(one.center, 1), entry(one.generators, 2)
    if isinstance(one, Zonotope):
        return body(c, G)
    return body(c, G, entry(one.constraint_matrix, 2), entry(one.constraint_offset, 1))


def mapped(s: Body, matrix: Exact, offset: Exact | None = None) -> Body:
    """``{Mx + t}``."""
    move = zeros(len(matrix)) if offset is None else offset
    G = matrix @ s.G if s.G.shape[1] else zeros(len(matrix), 0)
    return Body(matrix @ s.c + move, G, s.A, s.b, abs(matrix) @ s.size + abs(move), s.row_size)


def _joined(s: Body, t: Body) -> tuple[Exact, Exact, Exact]:
    g, h = s.G.shape[1], t.G.shape[1]
    A = rows_of([s.A, zeros(len(s.b), h)], [zeros(len(t.b), g), t.A])
    return A, np.concatenate([s.b, t.b]), np.concatenate([s.row_size, t.row_size])


def added(s: Body, t: Body) -> Body:
    """``{a + b}``."""
    A, b, row_size = _joined(s, t)
    return Body(s.c + t.c, rows_of([s.G, t.G]), A, b, s.size + t.size, row_size)


def product(s: Body, t: Body) -> Body:
    """``{(a, b)}``."""
    A, b, row_size = _joined(s, t)
    G = rows_of([s.G, zeros(s.n, t.G.shape[1])], [zeros(t.n, s.G.shape[1]), t.G])
    return Body(np.concatenate([s.c, t.c]), G, A, b, np.concatenate([s.size, t.size]), row_size)


def cut(s: Body, normals: Exact, lower: Sequence[Fraction | None], upper: Sequence[Fraction | None]) -> Body:
    """``{x : lower <= normals x <= upper}`` (K, n), K; None where a side does not bind."""
    for normal, low, high in zip(normals, lower, upper, strict=True):
        heights = normal @ s.G if s.G.shape[1] else zeros(0)
        middle = total(normal * s.c)
        reach = total(abs(heights))
        size = total(abs(normal) * s.size)
        ends = (
            middle - reach if low is None else low,
            middle + reach if high is None else high,
        )
        if ends[0] > ends[1] and (low is None or high is None):
            # Beyond the zonotope: nothing is left.
            ends = (ends[0], ends[0]) if high is None else (ends[1], ends[1])
        mid, half = (ends[0] + ends[1]) / 2, (ends[1] - ends[0]) / 2
        given = total(abs(end) for end in (low, high) if end is not None)
        s = Body(
            s.c,
            rows_of([s.G, zeros(s.n, 1)]),
            rows_of([s.A, zeros(len(s.b), 1)], [heights[None], exact([[-half]])]),
            np.concatenate([s.b, [mid - middle]]), s.size, np.concatenate([s.row_size, [size + given]]),
        )  # fmt: skip
    return s


def common(s: Body, t: Body, matrix: Exact) -> Body:
    """``{x in s : Rx in t}``."""
    A, b, row_size = _joined(s, t)
    heights = matrix @ s.G if s.G.shape[1] else zeros(len(matrix), 0)
    return Body(
        s.c,
        rows_of([s.G, zeros(s.n, t.G.shape[1])]),
        rows_of([A], [rows_of([heights, -t.G])]),
        np.concatenate([b, t.c - matrix @ s.c]), s.size + (t.size if t.n == s.n else 0),
        np.concatenate([row_size, abs(matrix) @ s.size + t.size]),
    )  # fmt: skip


def hull(s: Body, t: Body) -> Body:
    """The least convex set around both: ``λ = (1 + ξ)/2`` of the one, ``1 - λ`` of the other ([RK22], theorem 5).

    Factors (γ1, γ2, ξ, σ, τ): ``|γ1| <= λ`` and ``|γ2| <= 1 - λ``, as ``λ - γ = 1 + σ`` and ``λ + γ = 1 + τ``.
    """
    g, h = s.G.shape[1], t.G.shape[1]
    k, unit, half = g + h, exact(np.eye(g + h)), Fraction(1, 2)
    A, _, row_size = _joined(s, t)
    share = exact([half] * g + [-half] * h).reshape(k, 1)
    weighted = np.concatenate([-half * s.b, half * t.b])[:, None]
    return Body(
        half * (s.c + t.c),
        rows_of([s.G, t.G, half * (s.c - t.c)[:, None], zeros(s.n, 2 * k)]),
        rows_of(
            [A, weighted, zeros(len(A), 2 * k)],
            [unit, -share, unit, zeros(k, k)],
            [-unit, -share, zeros(k, k), unit],
        ),
        np.concatenate([half * s.b, half * t.b, exact([-half] * (2 * k))]),
        s.size + t.size, np.concatenate([row_size, exact([2] * (2 * k))]),
    )  # fmt: skip


def area(s: Body, rounds: int = 200) -> Fraction:
    """Area of a planar set: exact, by its vertices, found beyond the chords of those known."""
    axes = exact([[1, 0], [0, 1], [-1, 0], [0, -1]])
    found = [s.best(d) for d in axes]
    corners = [f[1] for f in found if f is not None]
    if not corners:
        return Fraction(0)
    outline: list[Exact] = []
    for start, end in zip(corners, corners[1:] + corners[:1], strict=True):
        pending, here = [end], start
        outline.append(start)
        while pending and rounds:
            there = pending[-1]
            chord = there - here
            beyond = s.best(exact([chord[1], -chord[0]])) if any(chord) else None
            if beyond is not None and beyond[0] > chord[1] * here[0] - chord[0] * here[1]:
                pending.append(beyond[1])
                rounds -= 1
            else:
                outline.append(pending.pop())
                here = there
    ends = zip(outline, outline[1:] + outline[:1], strict=True)
    return total(p[0] * q[1] - p[1] * q[0] for p, q in ends) / 2


def ways(rng: np.random.Generator, n: int, count: int = 3) -> list[Exact]:
    """Directions along the axes, and random ones."""
    return [exact(d) for d in (*np.eye(n), *-np.eye(n), *rng.integers(-3, 4, (count, n)))]
