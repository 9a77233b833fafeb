"""The recursion over the horizon: from the sets of one sample to those of the next.

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

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from reach_server.factor_sets import FactorSet
from reach_server.model import Model, residual_set
from reach_server.regression import Layout, rotate
from reach_server.rows import take
from reach_server.sets.arrays import Array, stack_columns

#: Beyond this heading half-width the rotation is enclosed as a whole.
WIDE_TURN = 1.5


@dataclass(frozen=True, slots=True, eq=False)
class InputSets:
    """Boxes of the inputs: ``past`` (B, lags, m) known values, newest first; ``center``, ``half`` (B, N, m)."""

    past: Array
    center: Array
    half: Array


@dataclass(slots=True, eq=False)
class Recursion:
    """How the sets of V vehicles move on: by their models, under ``inputs``, with ``process`` noise generators (n, g).

    ``membership`` takes set membership where it is smaller; ``kept_generators`` remain beside a box.
    """

    inputs: InputSets
    model: Model
    process: Array
    layout: Layout
    membership: bool = True
    kept_generators: int = 32
    #: Models by row, as long as the rows stay the same: the data in them is what is largest here.
    _taken: tuple[NDArray[np.intp], Model] | None = field(default=None, init=False)

    @property
    def horizon(self) -> int:
        """Steps N."""
        steps: int = self.inputs.center.shape[1]
        return steps

    def begin(self, start: FactorSet, vehicle: NDArray[np.intp]) -> FactorSet:
        """Sets (R, n) of states now, joined by the past inputs of their vehicles (R,)."""
        rows, g = len(vehicle), start.generators.shape[-1]
        past = self.inputs.past[vehicle].reshape(rows, -1)
        return FactorSet(
            np.concatenate([start.center, past], axis=1),
            np.concatenate([start.generators, np.zeros((rows, past.shape[1], g))], axis=1),
            start.matrix,
            start.offset,
        )

    def advance(self, sets: FactorSet, k: int, vehicle: NDArray[np.intp]) -> tuple[FactorSet, NDArray[np.bool_]]:
        """Sets (R) after step ``k`` (from 0) of the vehicles (R,), outer; and where the data excludes the bounds."""
        if self._taken is None or not np.array_equal(self._taken[0], vehicle):
            whole = np.array_equal(vehicle, np.arange(len(self.model.matrix)))
            self._taken = vehicle, self.model if whole else take(self.model, vehicle)
        model = self._taken[1]
        center, half = self.inputs.center[vehicle, k], self.inputs.half[vehicle, k]
        after, wrong = _step(sets, center, half, model, self.process, self.layout, self.membership)
        return after.reduced(self.kept_generators), wrong


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
    moved = stack_columns(slopes @ generators, error.generators, process)
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
