"""The random sets that are measured. Every family is drawn from its seed alone."""

from dataclasses import dataclass

import numpy as np

from reach_server.numeric.types import FloatArray
from reach_server.sets import ConstrainedZonotope, Zonotope


@dataclass(frozen=True, eq=False)
class Sets:
    """S inhabited planar sets ``{Gβ : Aβ = b, |β| <= 1}``: generators (S, 2, g), matrix (S, c, g), offset (S, c)."""

    name: str
    generators: FloatArray
    matrix: FloatArray
    offset: FloatArray

    def __len__(self) -> int:
        return len(self.generators)

    def all(self) -> ConstrainedZonotope:
        """One batch."""
        return ConstrainedZonotope(np.zeros(self.generators.shape[:-1]), self.generators, self.matrix, self.offset)

    def one(self, i: int) -> ConstrainedZonotope:
        """Set i alone."""
        return ConstrainedZonotope(
            np.zeros(self.generators.shape[-2]), self.generators[i], self.matrix[i], self.offset[i]
        )


def random_rows(count: int, generators: int, rows: int, seed: int = 0, dimension: int = 2) -> Sets:
    """Gaussian generators and rows; the offset is that of a point with factors in [-0.5, 0.5]."""
    rng = np.random.default_rng([seed, generators, rows, dimension])
    inner = rng.uniform(-0.5, 0.5, (count, generators, 1))
    matrix = rng.normal(size=(count, rows, generators))
    name = f"random rows, {generators} generators, {rows} constraints"
    return Sets(name, rng.normal(size=(count, dimension, generators)), matrix, (matrix @ inner)[..., 0])


def strip_cuts(count: int, generators: int, rows: int, seed: int = 0) -> Sets:
    """Gaussian zonotopes cut by strips through a common inner point, as the paper's Algorithm 3 makes them.

    ``generators`` and ``rows`` are those of the result: one generator and one row per strip.
    """
    rng = np.random.default_rng([seed, generators, rows, 1])
    free = generators - rows
    columns = rng.normal(size=(count, 2, free))
    inner = (columns @ rng.uniform(-0.5, 0.5, (count, free, 1)))[..., 0]
    normal = rng.normal(size=(count, rows, 2))
    heights = normal @ columns
    radius = np.abs(heights).sum(axis=-1) * rng.uniform(0.1, 0.5, (count, rows))
    middle = (normal @ inner[..., None])[..., 0] + radius * rng.uniform(-0.9, 0.9, (count, rows))
    added = -radius[..., None] * np.eye(rows)
    padded = np.concatenate([columns, np.zeros((count, 2, rows))], axis=-1)
    name = f"cut by {rows} strips, {generators} generators"
    return Sets(name, padded, np.concatenate([heights, added], axis=-1), middle)


CUT_FAMILIES = ("generic", "thin", "wide", "correlated")


@dataclass(frozen=True, eq=False)
class Cuts:
    """P planar zonotopes and a strip ``|normal·x - middle| <= radius`` each."""

    name: str
    zonotopes: Zonotope
    normal: FloatArray
    middle: FloatArray
    radius: FloatArray


def cuts(name: str, pairs: int, seed: int = 1) -> Cuts:
    """One of ``CUT_FAMILIES``: half-widths of the strip relative to that of the set are 0.05 to 0.6 (``generic``,
    and ``correlated``, whose sets are 100 times as long as wide), 0.001 to 0.02 (``thin``), 0.6 to 1.2 (``wide``)."""
    rng = np.random.default_rng([seed, CUT_FAMILIES.index(name)])
    generators = rng.normal(size=(pairs, 2, 6))
    if name == "correlated":
        angle = rng.uniform(0, np.pi, pairs)
        turn = np.stack([np.cos(angle), np.sin(angle), -np.sin(angle), np.cos(angle)], axis=-1).reshape(pairs, 2, 2)
        generators = turn @ (generators * np.array([[1.0], [0.01]]))
    normal = rng.normal(size=(pairs, 2))
    reach = np.abs((normal[:, None] @ generators)[:, 0]).sum(axis=1)
    narrowest, widest = {"thin": (0.001, 0.02), "wide": (0.6, 1.2)}.get(name, (0.05, 0.6))
    return Cuts(
        name, Zonotope(np.zeros((pairs, 2)), generators), normal,
        rng.uniform(-0.8, 0.8, pairs) * reach, rng.uniform(narrowest, widest, pairs) * reach,
    )  # fmt: skip
