"""Points spread evenly over zonotopes and over their boundaries, by tilings into parallelotopes."""

from itertools import combinations
from math import comb

import numpy as np

from reach_server.numeric.types import FloatArray

#: Choices of generators that are looked at; of more, this many are drawn at random.
CHOICES = 20_000
#: Directions in which a set is thinner than this, relative to its coordinates' widths, count as flat.
FLAT = 1e-12


def choices(g: int, k: int, rng: np.random.Generator) -> np.ndarray[tuple[int, int], np.dtype[np.intp]]:
    """All choices (S, k) of k generators of g, or ``CHOICES`` random ones."""
    if comb(g, k) <= CHOICES:
        return np.array(list(combinations(range(g), k)), dtype=np.intp).reshape(comb(g, k), k)
    return np.sort(rng.random((CHOICES, g)).argsort(axis=1)[:, :k], axis=1)


def inner_factors(generators: FloatArray, rng: np.random.Generator, count: int) -> FloatArray:
    """Factors (P, count, g) of points of zonotopes with generators (P, n, g), uniform by volume.

    A zonotope is tiled by one parallelotope for each independent choice of n generators; the factors of the others
    are ±1, told by random heights to which the generators are lifted ([GK10] for the volumes). Uniform up to
    ``CHOICES`` choices; beyond, over the tiles drawn. Flat sets are sampled in the flat that they span.
    """
    result = rng.uniform(-1.0, 1.0, (len(generators), count, generators.shape[-1]))
    for rank, rows, flat in _by_rank(generators):
        columns = choices(flat.shape[-1], rank, rng)
        tiles = np.abs(np.linalg.det(np.moveaxis(flat[..., columns], -2, 1)))
        chosen = columns[_draw(tiles, rng, count)]
        basis = _columns(flat, chosen)
        heights = rng.normal(size=(len(rows), 1, flat.shape[-1]))
        own = np.take_along_axis(np.broadcast_to(heights, (len(rows), count, flat.shape[-1])), chosen, axis=-1)
        slope = np.linalg.solve(np.swapaxes(basis, -1, -2), own[..., None])[..., 0]
        signs = np.where(heights - slope @ flat < 0, 1.0, -1.0)
        np.put_along_axis(signs, chosen, rng.uniform(-1.0, 1.0, chosen.shape), axis=-1)
        result[rows] = signs
    return result


def boundary_factors(generators: FloatArray, rng: np.random.Generator, count: int) -> FloatArray:
    """Factors (P, count, g) of points on the boundaries of zonotopes with generators (P, n, g); of flat sets, on the
    border within the flat.

    A facet is spanned by a choice of n - 1 generators, drawn by its area; the other factors are the signs that carry
    the support along its normal. Uniform by area in general position, as ``inner_factors``.
    """
    result = rng.uniform(-1.0, 1.0, (len(generators), count, generators.shape[-1]))
    for rank, rows, flat in _by_rank(generators):
        columns = choices(flat.shape[-1], rank - 1, rng)
        spanned = np.moveaxis(flat[..., columns], -2, 1)
        gram = np.swapaxes(spanned, -1, -2) @ spanned
        chosen = columns[_draw(np.sqrt(np.maximum(np.linalg.det(gram), 0.0)), rng, count)]
        normal = np.linalg.svd(_columns(flat, chosen), full_matrices=True)[0][..., -1]
        slope = normal @ flat
        size = np.sqrt((flat**2).sum(axis=1))[:, None, :]
        parallel = np.abs(slope) <= FLAT * size
        np.put_along_axis(parallel, chosen, True, axis=-1)
        side = np.where(rng.random((len(rows), count, 1)) < 0.5, -1.0, 1.0)
        result[rows] = np.where(parallel, result[rows], side * np.sign(slope))
    return result


def any_factors(generators: FloatArray, rng: np.random.Generator, count: int) -> FloatArray:
    """Factors (P, count, g), independent of each other; in three points of ten all are at their bounds."""
    factors = rng.uniform(-1.0, 1.0, (len(generators), count, generators.shape[-1]))
    extreme = rng.random((len(generators), count, 1)) < 0.3
    return np.where(extreme, np.where(factors < 0, -1.0, 1.0), factors)


def _by_rank(generators: FloatArray) -> list[tuple[int, np.ndarray[tuple[int], np.dtype[np.intp]], FloatArray]]:
    """Sets grouped by their dimension: (rank, which, generators (P', rank, g) in coordinates of the flat)."""
    size = np.abs(generators).sum(axis=-1, keepdims=True)
    axes, lengths, _ = np.linalg.svd(generators / np.where(size > 0, size, 1.0), full_matrices=False)
    ranks = (lengths > FLAT * lengths.max(axis=-1, keepdims=True, initial=0.0)).sum(axis=-1)
    found = []
    for rank in np.unique(ranks[ranks > 0]).tolist():
        rows = np.flatnonzero(ranks == rank)
        if rank == generators.shape[-2]:
            found.append((rank, rows, _of_size_one(generators[rows])))
        else:
            scaled = generators[rows] / np.where(size[rows] > 0, size[rows], 1.0)
            found.append((rank, rows, np.swapaxes(axes[rows][..., :rank], -1, -2) @ scaled))
    return found


def _of_size_one(generators: FloatArray) -> FloatArray:
    return np.asarray(generators / np.abs(generators).max(axis=(-2, -1), keepdims=True))


def _columns(flat: FloatArray, chosen: np.ndarray[tuple[int, ...], np.dtype[np.intp]]) -> FloatArray:
    """Matrices (P, count, n, k) of the chosen columns (P, count, k)."""
    rows = np.arange(len(flat))[:, None, None]
    return np.asarray(np.moveaxis(np.swapaxes(flat, -1, -2)[rows, chosen], -1, -2))


def _draw(weights: FloatArray, rng: np.random.Generator, count: int) -> np.ndarray[tuple[int, int], np.dtype[np.intp]]:
    """Indices (P, count) drawn with probabilities proportional to the weights (P, S)."""
    total = weights.sum(axis=-1, keepdims=True)
    weights = np.where(total > 0, weights, 1.0)
    share = np.cumsum(weights, axis=-1) / weights.sum(axis=-1, keepdims=True)
    sets, size = weights.shape
    offset = 2.0 * np.arange(sets)[:, None]
    index = np.searchsorted((share + offset).ravel(), (rng.random((sets, count)) + offset).ravel(), side="right")
    return np.asarray(np.clip(index.reshape(sets, count) - size * np.arange(sets)[:, None], 0, size - 1))
