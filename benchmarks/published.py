"""One update as the algorithm is published: a pseudoinverse of the data at every step of the horizon.

Alanwar et al. 2022, Algorithm 1, written down line by line with NumPy: the same samples, noise and horizon as the
engine gets, and its two predicates as strips by Algorithm 2. No tuning against it: what depends on the
data alone is built once an update, products are BLAS calls. Of the matrix zonotope of the noise the algorithm uses
nothing but its center; it can be built all the same, to see what that takes.
"""

import numpy as np

from reach_server.numeric.types import FloatArray

Zonotope = tuple[FloatArray, FloatArray]


def noise_matrix_zonotope(noise: Zonotope, samples: int) -> tuple[FloatArray, FloatArray]:
    """Center (n, T) and generators (g T, n, T): a noise generator at each sample, as the matrix zonotope M_w lists
    them."""
    center, generators = noise
    n, g = generators.shape
    matrices = np.zeros((g, samples, n, samples))
    sample = np.arange(samples)
    matrices[:, sample, :, sample] = generators.T
    return np.repeat(center[:, None], samples, axis=1), matrices.reshape(-1, n, samples)


def tube(
    states: FloatArray,
    inputs: FloatArray,
    after: FloatArray,
    start: Zonotope,
    plan: FloatArray,
    noise: Zonotope,
    allowance: FloatArray,
    strips: list[tuple[FloatArray, float, float]],
    reduced_to: int,
    *,
    matrix_zonotope: bool = True,
) -> list[Zonotope]:
    """Sets of N steps from data (n, T), (q, T), (n, T): a linear model at each step about the center of the last set.

    ``plan`` (N, q) are the inputs with their lags, ``allowance`` (n,) the half-widths of Z_ε, ``strips`` (normal,
    middle, radius). M_w is built once, before the first step; without ``matrix_zonotope`` only its center, and the
    sets are the same, as the algorithm uses no more of it.
    """
    samples = states.shape[1]
    if matrix_zonotope:
        noise_center, _ = noise_matrix_zonotope(noise, samples)
    else:
        noise_center = np.repeat(noise[0][:, None], samples, axis=1)
    sets = []
    current = start
    for step_input in plan:
        center, generators = current
        data = np.vstack([np.ones(samples), states - center[:, None], inputs - step_input[:, None]])
        model = (after - noise_center) @ np.linalg.pinv(data)
        residual = after - model @ data
        low, high = residual.min(axis=1), residual.max(axis=1)
        n = len(center)
        moved_center = model[:, 0] + (low + high) / 2
        # Z_L with -Z_w, then Z_ε, then Z_w: the centers of the noise cancel.
        moved = np.hstack([
            model[:, 1 : 1 + n] @ generators, np.diag((high - low) / 2), noise[1], np.diag(allowance), noise[1],
        ])  # fmt: skip
        current = _reduced(moved_center, moved, reduced_to)
        for normal, middle, radius in strips:
            current = _cut(current, normal, middle, radius)
        sets.append(current)
    return sets


def _cut(current: Zonotope, normal: FloatArray, middle: float, radius: float) -> Zonotope:
    """Algorithm 2: the zonotope of least Frobenius norm around the intersection with a strip."""
    center, generators = current
    heights = normal @ generators
    weight = generators @ heights / (heights @ heights + radius**2)
    moved = np.column_stack([generators - np.outer(weight, heights), weight * radius])
    return center + weight * (middle - normal @ center), moved


def _reduced(center: FloatArray, generators: FloatArray, kept: int) -> Zonotope:
    """Girard's reduction to ``kept`` generators."""
    n, g = generators.shape
    if g <= kept:
        return center, generators
    size = np.abs(generators).sum(axis=0) - np.abs(generators).max(axis=0)
    order = np.argsort(size)
    boxed, rest = order[: g - kept + n], order[g - kept + n :]
    return center, np.hstack([generators[:, rest], np.diag(np.abs(generators[:, boxed]).sum(axis=1))])
