"""Matrix zonotopes: all linear models that agree with the data ([AKA+21]; measurement noise: [AKA+23]).

A vehicle with ``x+ = M z + w``, ``z = (x, u, lagged u)``, M constant and unknown, w in Z_w; measured ``y = x + v``,
v in Z_v. With D (p, T) the measured regressors and ``Y+`` (n, T) the measured targets,

    Y+ = M D + N,   columns  n_t = w_t + v+_t - A v_t,   A the columns of M for the states,

and where D has full row rank, ``D D† = I``,

    M = (Y+ - N) D†  ∈  C_M ⊕ { Σ_t Σ_i β_ti g_i d_t : |β_ti| <= 1 },   C_M = Y+ D†,

d_t the rows of D† (T, p), g_i the generators of a symmetric zonotope 𝒩 that holds every n_t (all noise sets are
symmetric around zero here, so signs do not matter and ``C_N = 0``). This matrix zonotope has T generators for each g_i;
they are never made. For z in ``<c, [h_1 … h_g]>``, as in [AKA+21],

    M z  ∈  <C_M c, C_M [h_1 … h_g]> ⊕ Σ_t Σ_i g_i ( d_t c β_ti + Σ_j d_t h_j β_tij ) ,

and all generators that belong to one g_i are parallel to it, so that together they are one:

    M z  ∈  <C_M c, C_M [h_1 … h_g]> ⊕ κ 𝒩 ,   κ = Σ_t ( |d_t c| + Σ_j |d_t h_j| ) .

The very set, with g + |𝒩| generators in place of g + T |𝒩| (1 + g).

**The set 𝒩.** ``Z_w ⊕ Z_v ⊕ A Z_v`` needs A, about which data and profile say something. With half-widths ω of Z_w,
ζ of Z_v, and ``q_i = Σ_c |A_ic| ζ_c`` every ``|n_ti| <= ω_i + ζ_i + q_i``; from ``A = C_A - N D†_x``, row by row,

    |A_ic - C_ic| <= (ω_i + ζ_i + q_i) s_c ,  s_c = Σ_t |d_tc| ,    so with  σ = Σ_c s_c ζ_c
    q_i <= Σ_c |C_ic| ζ_c + (ω_i + ζ_i + q_i) σ ,    thus if σ < 1
    q_i <= ( Σ_c |C_ic| ζ_c + (ω_i + ζ_i) σ ) / (1 - σ) .

So ``A v ∈ C_A v ⊕ box((ω + ζ + q) σ)``. Where the profile bounds the derivatives, ``A_ic ∈ mid_ic ± rad_ic``, also
``A v ∈ mid v ⊕ box(Σ_c rad_ic ζ_c)``; of each row the narrower is taken. Without measurement noise all this is zero.

**Rounding.** With the D† that was computed ``M = M D D† + M (I - D D†)``: the rest and what the sums lose, times the
greatest |M| that agrees with the data, is added to every set as a box.

What is assumed is that the dynamics are linear (no constant: states and inputs count from an equilibrium) and do not
change over the window; no bound of slopes is needed. World frame only: turned increments are not linear.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from fleet_bus.errors import UsageError
from fleet_bus.messages import Lipschitz
from reach_server.data.input_sets import InputSets
from reach_server.data.regressors import RegressorSpec, Transitions
from reach_server.models.residual_model import NoiseBounds
from reach_server.numeric.checks import stack_columns
from reach_server.numeric.jit import kernel
from reach_server.numeric.rounding import EPS
from reach_server.numeric.types import FloatArray
from reach_server.sets.raw import RawSets

#: Least singular value of the scaled data, relative to the largest, below which it does not determine M.
RANK: Final = 1e-8


@dataclass(frozen=True, slots=True, eq=False)
class LinearModels:
    """The models of V vehicles that agree with their data: ``C_M ⊕ { Σ_t n_t d_t : n_t ∈ 𝒩 }``.

    Attributes:
        matrix: C_M (V, n, p).
        inverse: D† (V, T, p); rows of zeros where a place holds no datum.
        noise: generators of 𝒩 (V, n, g), those of the process noise first, those of a box last.
        lost: what rounding may make of M (V, n, p), by entry.
        determined: (V,) the data determines M and bounds 𝒩; the sets of other vehicles hold nothing for certain.
        contradicted: (V,) no linear model agrees with the data within the stated noise.
        newest: state (V, n) of the newest sample; the model of a state that is an angle holds in its turn.
    """

    matrix: FloatArray
    inverse: FloatArray
    noise: FloatArray
    lost: FloatArray
    determined: NDArray[np.bool_]
    contradicted: NDArray[np.bool_]
    newest: FloatArray


def fit(
    data: Transitions, layout: RegressorSpec, bounds: NoiseBounds, lipschitz: Lipschitz | None = None
) -> LinearModels:
    """All linear models of V vehicles that agree with their transitions: outer where ``determined`` [AKA+21].

    Raises ``UsageError`` for a layout in the body frame.
    """
    if layout.pose is not None:
        raise UsageError("method lti describes linear systems: it needs frame: world")
    weight = data.usable[..., None].astype(np.float64)
    # The weights come first: what places without a datum hold may be anything.
    z, target = np.where(weight > 0, data.z, 0.0), np.where(weight > 0, data.target, 0.0)
    inverse, full = _right_inverse(z)
    matrix = np.swapaxes(target, 1, 2) @ inverse
    states, rest = _measured_states(matrix, inverse, layout.n, bounds, lipschitz)
    determined = full & np.isfinite(rest).all(axis=1)
    rest = np.where(determined[:, None], rest, 0.0)
    noise = stack_columns(
        bounds.process, bounds.measurement, states @ bounds.measurement, rest[..., None] * np.eye(layout.n)
    )
    contradicted = determined & _contradicted(z, target, matrix, inverse, noise)
    lost = _lost(z, target, matrix, inverse, noise)
    return LinearModels(matrix, inverse, noise, lost, determined, contradicted, data.newest)


def _right_inverse(z: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
    """D† (V, T, p) of D (V, p, T) given as rows ``z`` (V, T, p), and where D has full row rank (V,).

    With ``z = Q R S``, S a scaling of the columns, ``D† = z (zᵀz)⁻¹ = Q R⁻ᵀ S⁻¹``.
    """
    scale = np.abs(z).max(axis=1, keepdims=True)
    full = (scale > 0).all(axis=(1, 2)) & (z.shape[1] >= z.shape[2])
    q, r = np.linalg.qr(z / np.where(scale > 0, scale, 1.0))
    if not full.any():
        return np.zeros_like(z), full
    values = np.linalg.svd(r, compute_uv=False)
    full &= values[:, -1] > RANK * values[:, 0]
    r = np.where(full[:, None, None], r, np.eye(z.shape[2]))
    inverse = q @ np.swapaxes(np.linalg.inv(r), 1, 2) / np.where(scale > 0, scale, 1.0)
    return np.where(full[:, None, None], inverse, 0.0), full


def _measured_states(
    matrix: FloatArray, inverse: FloatArray, n: int, bounds: NoiseBounds, lipschitz: Lipschitz | None
) -> tuple[FloatArray, FloatArray]:
    """A matrix (V, n, n) and half-widths (V, n): ``A v`` lies in their sum for every measurement error v."""
    half = np.abs(bounds.measurement).sum(axis=1)
    vehicles = len(matrix)
    if not half.any():
        return np.zeros((vehicles, n, n)), np.zeros((vehicles, n))
    center = matrix[..., :n]
    sigma = (np.abs(inverse[..., :n]).sum(axis=1) @ half)[:, None]
    each = np.abs(bounds.process).sum(axis=1) + half
    most = np.where(
        sigma < 1.0, (np.abs(center) @ half + each * sigma) / np.where(sigma < 1.0, 1.0 - sigma, 1.0), np.inf
    )
    stated = _stated(lipschitz, n)
    if stated is not None:
        most = np.minimum(most, np.maximum(np.abs(stated[0]), np.abs(stated[1])) @ half)
    rest = (each + most) * sigma
    if stated is None:
        return center, rest
    middle, narrow = (stated[0] + stated[1]) / 2, (stated[1] - stated[0]) / 2 @ half
    narrower = narrow < rest
    return np.where(narrower[..., None], middle, center), np.where(narrower, narrow, rest)


def _stated(lipschitz: Lipschitz | None, n: int) -> tuple[FloatArray, FloatArray] | None:
    """Bounds (n, n) of A that a profile states; None where it states none, or bounds something else."""
    if lipschitz is None or lipschitz.of == "residual":
        return None
    if lipschitz.matrix is not None:
        bound = np.abs(np.array(lipschitz.matrix, dtype=np.float64))[:, :n]
        return -bound, bound
    lower, upper = np.array(lipschitz.lower, dtype=np.float64), np.array(lipschitz.upper, dtype=np.float64)
    return lower[:, :n], upper[:, :n]


def _lost(z: FloatArray, target: FloatArray, matrix: FloatArray, inverse: FloatArray, noise: FloatArray) -> FloatArray:
    """What the rounding of D† and of C_M may change of M (V, n, p), by entry; see the head of this module."""
    p = z.shape[2]
    unit = (z.shape[1] + p + 8) * EPS
    size = np.abs(inverse)
    inexact = np.abs(np.eye(p) - np.swapaxes(z, 1, 2) @ inverse) + unit * (np.swapaxes(np.abs(z), 1, 2) @ size)
    largest = np.abs(matrix) + np.abs(noise).sum(axis=2)[..., None] * size.sum(axis=1)[:, None]
    return np.asarray(largest @ inexact + unit * (largest + np.swapaxes(np.abs(target), 1, 2) @ size))


def _contradicted(
    z: FloatArray, target: FloatArray, matrix: FloatArray, inverse: FloatArray, noise: FloatArray
) -> NDArray[np.bool_]:
    """Where (V,) the largest residual of a component is more than all noise at its worst explains.

    ``r_t = y+_t - C_M z_t = n_t - Σ_s n_s (d_s z_t)``, so ``|r_ti| <= |𝒩|_i (1 - 2 d_t z_t + Σ_s |d_s z_t|)`` since
    ``0 <= d_t z_t <= 1``: a necessary condition, which says nothing where it holds.
    """
    residual = np.abs(target - z @ np.swapaxes(matrix, 1, 2))
    worst = residual.argmax(axis=1)
    at = np.swapaxes(np.take_along_axis(z, worst[..., None], axis=1), 1, 2)
    own = np.einsum("vip,vpi->vi", np.take_along_axis(inverse, worst[..., None], axis=1), at)
    norms = l1_norms(inverse, np.arange(len(z)), np.ascontiguousarray(at))
    half = np.abs(noise).sum(axis=-1)
    size = np.abs(target).max(axis=1)
    allowed = half * (1.0 - 2.0 * own + norms) + 1e-9 * size
    return np.asarray((residual.max(axis=1) > allowed).any(axis=1))


@kernel
def l1_norms(inverse: FloatArray, vehicle: NDArray[np.intp], vectors: FloatArray) -> FloatArray:
    """``Σ_t |d_t h|`` (R, g) for columns h of ``vectors`` (R, p, g) and the rows d_t of ``inverse[vehicle]`` (T, p)."""
    rows, p, g = vectors.shape
    samples = inverse.shape[1]
    norms = np.zeros((rows, g))
    product = np.zeros(g)
    for row in range(rows):
        v = vehicle[row]
        for t in range(samples):
            product[:] = 0.0
            for c in range(p):
                factor = inverse[v, t, c]
                for j in range(g):
                    product[j] += factor * vectors[row, c, j]
            for j in range(g):
                norms[row, j] += abs(product[j])
    return norms


@dataclass(slots=True, eq=False)
class LinearMotion:
    """Motion of the sets of V vehicles by all models that agree with their data, under ``inputs``.

    ``process`` (n, g) are the generators of the process noise; ``retained_generators`` remain beside a box.
    """

    inputs: InputSets
    models: LinearModels
    process: FloatArray
    layout: RegressorSpec
    retained_generators: int = 32

    @property
    def horizon(self) -> int:
        """Steps N."""
        steps: int = self.inputs.center.shape[1]
        return steps

    def begin(self, start: RawSets, vehicle: NDArray[np.intp]) -> RawSets:
        """Sets (R, n) of states now, joined by the past inputs of the vehicles ``vehicle`` (R,) they are of: exact."""
        past = self.inputs.past[vehicle].reshape(len(vehicle), -1)
        generators = np.pad(start.generators, [(0, 0), (0, past.shape[1]), (0, 0)])
        return RawSets(np.concatenate([start.center, past], axis=1), generators, start.matrix, start.offset)

    def advance(self, sets: RawSets, k: int, vehicle: NDArray[np.intp]) -> tuple[RawSets, NDArray[np.bool_]]:
        """Sets (R, n) after step ``k`` (from 0) of the vehicles ``vehicle`` (R,) they are of: outer; and where (R,) no
        linear model fits the data."""
        n, m, lagged = self.layout.n, self.layout.m, self.layout.lags * self.layout.m
        rows, _, g = sets.generators.shape
        center = np.concatenate([sets.center[:, :n], self.inputs.center[vehicle, k], sets.center[:, n:]], axis=1)
        # Factors: those of the set, then those of the input of this step.
        generators = np.zeros((rows, n + m + lagged, g + m))
        generators[:, :n, :g], generators[:, n + m :, :g] = sets.generators[:, :n], sets.generators[:, n:]
        generators[:, n : n + m, g:] = self.inputs.half[vehicle, k, :, None] * np.eye(m)
        vectors = np.concatenate([center[..., None], generators], axis=2)
        spread = l1_norms(self.models.inverse, vehicle, vectors).sum(axis=1)
        spread *= 1.0 + (self.models.inverse.shape[1] + vectors.shape[1] + vectors.shape[2]) * EPS
        # The process noise of this step is parallel to that of the data.
        now = np.arange(self.models.noise.shape[2]) < self.process.shape[1]
        noise = self.models.noise[vehicle] * (spread[:, None] + now)[:, None]
        noise[..., -n:] += (self.models.lost[vehicle] @ np.abs(vectors).sum(axis=2)[..., None]) * np.eye(n)
        matrix = self.models.matrix[vehicle]
        retained = slice(n, n + lagged)
        # The newest lag is the input of this step, the others move back by one.
        moved = np.concatenate([matrix @ generators, generators[:, retained]], axis=1)
        added = np.pad(noise, [(0, 0), (0, lagged), (0, 0)])
        after = RawSets(
            np.concatenate([(matrix @ center[..., None])[..., 0], center[:, retained]], axis=1),
            np.concatenate([moved, added], axis=2),
            np.pad(sets.matrix, [(0, 0), (0, 0), (0, m + added.shape[2])]),
            sets.offset,
        )
        return after.reduced(self.retained_generators), self.models.contradicted[vehicle]
