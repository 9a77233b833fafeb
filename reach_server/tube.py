"""The recursion over the horizon: propagate a set, cut it by what is known about that step, go on.

The set of a vehicle is a zonotope over the state and the lagged inputs together, so that an input inside the
horizon and the steps that it acts on later share their factors.

Body frame (calibrated.md, section 3): with position p, heading θ = θ_c + tξ, |tξ| <= ρ, and increment
d = d_c + Dξ over common factors ξ,

    R(θ) d = R(θ_c) [ d_c + (D + J d_c t) ξ + J (Dξ)(tξ) + (cos - 1) d + (sin - tξ) J d ],  J = [[0, -1], [1, 0]]

The linear part keeps its generators. A product of linear forms is enclosed by
``(aξ)(bξ) ∈ ½ Σ a_i b_i ± (|a|₁|b|₁ - ½ Σ |a_i b_i|)``: squares lie in [0, 1], mixed terms in [-1, 1]. The cosine
part lies in [-ρ²/2, 0] d, the sine part in ±ρ³/6 |d| with the components exchanged. Beyond ρ = 1.5 all of
``(R(tξ) - I) d`` is enclosed by ±2 |d| instead.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from reach_server.model import Model, ResidualSet, residual_set
from reach_server.predicates import CutTable
from reach_server.regression import Layout, rotate
from reach_server.sets import reduction, strips, support
from reach_server.sets.arrays import Array, stack_columns

CutMethod = Literal["zonotope", "constrained", "frobenius"]

#: Constraint rows kept through a propagation step; older ones are dropped, which only enlarges.
MAX_ROWS = 8
#: Beyond this heading half-width the rotation is enclosed as a whole.
WIDE_TURN = 1.5


@dataclass(frozen=True, slots=True, eq=False)
class FactorSet:
    """Sets of B vehicles, ``{c + Gξ : Aξ = b, |ξ| <= 1}``: center (B, z), generators (B, z, g), matrix (B, r, g),
    offset (B, r); without rows a zonotope."""

    center: Array
    generators: Array
    matrix: Array
    offset: Array

    @staticmethod
    def zonotope(center: Array, generators: Array) -> "FactorSet":
        """A set without constraints."""
        vehicles, _, g = generators.shape
        return FactorSet(center, generators, np.zeros((vehicles, 0, g)), np.zeros((vehicles, 0)))

    def reduced(self, kept: int) -> "FactorSet":
        """An enclosure by ``kept`` generators and a box."""
        z, rows = self.center.shape[-1], self.matrix.shape[-2]
        first = max(rows - MAX_ROWS, 0)
        matrix, offset = self.matrix[:, first:], self.offset[:, first:]
        lifted = reduction.girard(np.concatenate([self.generators, matrix], axis=1), kept + z + rows - first)
        return FactorSet(self.center, lifted[:, :z], lifted[:, z:], offset)


@dataclass(frozen=True, slots=True, eq=False)
class Tube:
    """Sets of B vehicles at steps 0 (now) to N: lists of ``FactorSet`` over the n states.

    ``empty`` (B, N + 1, C): the set of that step was certainly empty after that cut (it was not applied).
    ``cut`` (B, N + 1, C): the cut was active and acted. ``contradicted`` (B,): data excludes the stated bounds.
    """

    steps: list[FactorSet]
    empty: NDArray[np.bool_]
    cut: NDArray[np.bool_]
    contradicted: NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class InputSets:
    """Boxes of the inputs: ``past`` (B, lags, m) known values, newest first; ``center``, ``half`` (B, N, m)."""

    past: Array
    center: Array
    half: Array


def propagate(
    start: FactorSet,
    inputs: InputSets,
    model: Model,
    process: Array,
    layout: Layout,
    table: CutTable,
    active: NDArray[np.bool_],
    *,
    cuts: CutMethod = "zonotope",
    membership: bool = True,
    kept_generators: int = 32,
) -> Tube:
    """Tubes of B vehicles over the N steps of ``inputs``; every set is an outer bound.

    ``start`` bounds the true states now (B, n); ``process`` are the generators (n, g) of the process noise;
    ``active`` (B, N + 1, C) says which cuts hold at which step.
    """
    vehicles, horizon, m = inputs.center.shape
    lagged = layout.lags * m
    state = FactorSet(
        np.concatenate([start.center, inputs.past.reshape(vehicles, lagged)], axis=1),
        np.concatenate([start.generators, np.zeros((vehicles, lagged, start.generators.shape[-1]))], axis=1),
        start.matrix,
        start.offset,
    )
    empty = np.zeros((vehicles, horizon + 1, table.count), dtype=bool)
    cut = np.zeros_like(empty)
    contradicted = np.zeros(vehicles, dtype=bool)
    state, empty[:, 0], cut[:, 0] = apply_cuts(state, table, active[:, 0], cuts, layout.n)
    steps = [_states(state, layout.n)]
    for k in range(horizon):
        state, wrong = _step(state, inputs.center[:, k], inputs.half[:, k], model, process, layout, membership)
        contradicted |= wrong
        state = state.reduced(kept_generators)
        state, empty[:, k + 1], cut[:, k + 1] = apply_cuts(state, table, active[:, k + 1], cuts, layout.n)
        steps.append(_states(state, layout.n))
    return Tube(steps, empty, cut, contradicted)


def _states(state: FactorSet, n: int) -> FactorSet:
    return FactorSet(state.center[:, :n], state.generators[:, :n], state.matrix, state.offset)


def _step(
    state: FactorSet,
    input_center: Array,
    input_half: Array,
    model: Model,
    process: Array,
    layout: Layout,
    membership: bool,
) -> tuple[FactorSet, NDArray[np.bool_]]:
    n, m = layout.n, layout.m
    vehicles, _, g = state.generators.shape
    input_generators = input_half[..., None] * np.eye(m)
    free = list(layout.free)
    lags = slice(n, n + layout.lags * m)
    center = np.concatenate([state.center[:, free], input_center, state.center[:, lags]], axis=1)
    zeros = np.zeros((vehicles, len(free), m))
    top = np.concatenate([state.generators[:, free], zeros], axis=2)
    middle = np.concatenate([np.zeros((vehicles, m, g)), input_generators], axis=2)
    bottom = np.concatenate([state.generators[:, lags], np.zeros((vehicles, layout.lags * m, m))], axis=2)
    generators = np.concatenate([top, middle, bottom], axis=1)
    error = residual_set(model, center, np.abs(generators).sum(axis=-1), membership=membership)
    slopes = model.matrix[..., 1:]
    moved_center = model.matrix[..., 0] + (slopes @ center[..., None])[..., 0] + error.center
    moved = _columns(slopes @ generators, error, process)
    old = np.concatenate([state.generators[:, :n], np.zeros((vehicles, n, moved.shape[-1] - g))], axis=2)
    if layout.pose is None:
        new_center, new = moved_center, moved
    else:
        new_center, new = _turn(state.center[:, :n], old, moved_center, moved, layout.pose)
    # The newest lag is the input of this step, the others move back by one.
    kept = slice(len(free), len(free) + layout.lags * m)
    lag_generators = np.concatenate(
        [generators[:, kept], np.zeros((vehicles, layout.lags * m, new.shape[-1] - g - m))], axis=2
    )
    rows = state.matrix.shape[1]
    matrix = np.concatenate([state.matrix, np.zeros((vehicles, rows, new.shape[-1] - g))], axis=2)
    return (
        FactorSet(
            np.concatenate([new_center, center[:, kept]], axis=1),
            np.concatenate([new, lag_generators], axis=1),
            matrix,
            state.offset,
        ),
        error.contradicted,
    )


def _columns(linear: Array, error: ResidualSet, process: Array) -> Array:
    return stack_columns(linear, error.generators, process)


def _turn(
    center: Array, generators: Array, step_center: Array, step: Array, pose: tuple[int, int, int]
) -> tuple[Array, Array]:
    """State plus the increment turned by the heading; all generators over the same factors (B, n, g)."""
    first, second, heading = pose
    position = [first, second]
    angle = center[:, heading]
    t = generators[:, heading]
    rho = np.abs(t).sum(axis=-1)
    d_c, d = step_center[:, position], step[:, position]
    d_half = np.abs(d).sum(axis=-1)
    d_max = np.abs(d_c) + d_half
    quarter_turned = np.stack([-d_c[:, 1], d_c[:, 0]], axis=-1)
    linear = d + quarter_turned[..., None] * t[:, None]
    # J (Dξ)(tξ): first component -(D_y ξ)(tξ), second (D_x ξ)(tξ)
    turned = np.stack([-d[:, 1], d[:, 0]], axis=1)
    products = turned * t[:, None]
    middle = 0.5 * products.sum(axis=-1)
    radius = np.abs(turned).sum(axis=-1) * rho[:, None] - 0.5 * np.abs(products).sum(axis=-1)
    squared, cubed = rho[:, None] ** 2, rho[:, None] ** 3
    middle = middle - 0.25 * squared * d_c
    radius = radius + 0.25 * squared * np.abs(d_c) + 0.5 * squared * d_half + cubed / 6 * d_max[:, ::-1]
    wide = rho > WIDE_TURN
    longest = 2.0 * np.hypot(d_max[:, 0], d_max[:, 1])[:, None]
    linear = np.where(wide[:, None, None], d, linear)
    middle = np.where(wide[:, None], 0.0, middle)
    radius = np.where(wide[:, None], longest, radius)

    new_center = center + step_center
    new = generators + step
    new_center[:, position] = center[:, position] + rotate(angle, d_c + middle)
    new[:, position] = generators[:, position] + np.swapaxes(rotate(angle[:, None], np.swapaxes(linear, 1, 2)), 1, 2)
    rest = np.zeros((*new.shape[:2], 2))
    c, s = np.cos(angle), np.sin(angle)
    rest[:, first, 0], rest[:, second, 0] = c * radius[:, 0], s * radius[:, 0]
    rest[:, first, 1], rest[:, second, 1] = -s * radius[:, 1], c * radius[:, 1]
    return new_center, np.concatenate([new, rest], axis=2)


def apply_cuts(
    state: FactorSet, table: CutTable, active: NDArray[np.bool_], method: CutMethod, n: int
) -> tuple[FactorSet, NDArray[np.bool_], NDArray[np.bool_]]:
    """Cut sets (B) by the active ones (B, C) of a table over the first ``n`` coordinates.

    Returns the sets, where a cut left certainly nothing (it is then not applied), and where a cut acted.
    """
    vehicles = len(state.center)
    empty = np.zeros((vehicles, table.count), dtype=bool)
    acted = np.zeros((vehicles, table.count), dtype=bool)
    used = np.flatnonzero(active.any(axis=0))
    if not len(used):
        return state, empty, acted
    # Cuts do not commute: a second pass lets the first ones profit from the later ones.
    for _ in range(2 if method == "zonotope" and len(used) > 1 else 1):
        for c in used:
            normal = np.zeros(state.center.shape[1])
            normal[:n] = table.normal[c]
            lower = np.where(active[:, c] & ~empty[:, c], table.lower[c], -np.inf)
            upper = np.where(active[:, c] & ~empty[:, c], table.upper[c], np.inf)
            if method == "constrained":
                state, missed, cut = _constrain(state, normal, lower, upper)
            else:
                _, _, cut, missed = strips.strip_bounds(state.center, state.generators, normal, lower, upper)
                if cut.any() or (method == "frobenius" and active[:, c].any()):
                    center, generators, missed = strips.intersect_strip(
                        state.center, state.generators, normal, lower, upper,
                        method="frobenius" if method == "frobenius" else "tight", plane=table.plane,
                    )  # fmt: skip
                    rows = state.matrix.shape[1]
                    matrix = np.concatenate([state.matrix, np.zeros((vehicles, rows, 1))], axis=2)
                    state = FactorSet(center, generators, matrix, state.offset)
            empty[:, c] |= missed
            acted[:, c] |= cut
    if method == "constrained" and state.matrix.shape[1]:
        infeasible = support.emptiness_certificate(state.matrix, state.offset)
        empty |= infeasible[:, None] & acted
    return state, empty, acted


def _constrain(
    state: FactorSet, normal: Array, lower: Array, upper: Array
) -> tuple[FactorSet, NDArray[np.bool_], NDArray[np.bool_]]:
    """Algorithm 3: one factor and one row more where the strip cuts, a zero row elsewhere."""
    q, r, cuts, missed = strips.strip_bounds(state.center, state.generators, normal, lower, upper)
    if not cuts.any():
        return state, missed, cuts
    vehicles, z, _ = state.generators.shape
    heights = (normal @ state.generators).reshape(vehicles, -1)
    row = np.where(cuts[:, None], np.concatenate([heights, -r[:, None]], axis=1), 0.0)
    right = np.where(cuts, q - state.center @ normal, 0.0)
    rows = state.matrix.shape[1]
    matrix = np.concatenate([state.matrix, np.zeros((vehicles, rows, 1))], axis=2)
    return (
        FactorSet(
            state.center,
            np.concatenate([state.generators, np.zeros((vehicles, z, 1))], axis=2),
            np.concatenate([matrix, row[:, None]], axis=1),
            np.concatenate([state.offset, right[:, None]], axis=1),
        ),
        missed,
        cuts,
    )


def join_sets(sets: list[FactorSet]) -> FactorSet:
    """Sets one below the other, with zero columns and rows where they differ in size."""
    n = sets[0].center.shape[1]
    g = max(s.generators.shape[2] for s in sets)
    rows = max(s.matrix.shape[1] for s in sets)

    def padded(array: Array, *widths: int) -> Array:
        return np.pad(array, [(0, 0), *((0, w - a) for w, a in zip(widths, array.shape[1:], strict=True))])

    return FactorSet(
        np.concatenate([s.center for s in sets]),
        np.concatenate([padded(s.generators, n, g) for s in sets]),
        np.concatenate([padded(s.matrix, rows, g) for s in sets]),
        np.concatenate([padded(s.offset, rows) for s in sets]),
    )
