"""The tableau ``B⁻¹ [A | I | b]`` of a basis of the rows ``Aβ = b``: filled, pivoted, factorised anew.

Rows are divided by a power of two near their greatest entry, which rounds nothing.
"""

import math

from reach_server.numeric.jit import ZERO, kernel
from reach_server.numeric.types import FloatArray, IntArray

#: A row is taken to depend on the others where elimination leaves no entry above this (rows have size 1).
DEPENDENT = 1e-10


@kernel
def load(matrix: FloatArray, offset: FloatArray, rows: FloatArray, scale: FloatArray, tableau: FloatArray) -> None:
    """Fill ``rows`` (m, g + 1) with the scaled ``[A | b]`` and the tableau (m, g + m + 1) with ``[A | I | b]``."""
    m, g = matrix.shape
    for i in range(m):
        largest = 0.0
        for j in range(g):
            largest = max(largest, abs(matrix[i, j]))
        if largest == 0.0:
            largest = abs(offset[i])
        exponent = math.frexp(largest)[1] if largest > 0.0 else 0
        scale[i] = math.ldexp(1.0, -exponent)
        for j in range(g):
            rows[i, j] = matrix[i, j] * scale[i]
        rows[i, g] = offset[i] * scale[i]
    refill(rows, tableau)


@kernel
def refill(rows: FloatArray, tableau: FloatArray) -> None:
    """The tableau of the empty basis."""
    m, g = rows.shape[0], rows.shape[1] - 1
    for i in range(m):
        for j in range(g):
            tableau[i, j] = rows[i, j]
        for j in range(m):
            tableau[i, g + j] = 0.0
        tableau[i, g + i] = 1.0
        tableau[i, g + m] = rows[i, g]


@kernel
def pivot(tableau: FloatArray, count: int, r: int, j: int) -> None:
    """Make column j a unit column with its 1 in row r, in the first ``count`` rows."""
    width = tableau.shape[1]
    factor = 1.0 / tableau[r, j]
    for k in range(width):
        tableau[r, k] *= factor
    tableau[r, j] = 1.0
    for i in range(count):
        if i != r:
            factor = tableau[i, j]
            if factor != 0.0:
                for k in range(width):
                    tableau[i, k] -= factor * tableau[r, k]
                tableau[i, j] = 0.0


@kernel
def factorise(rows: FloatArray, tableau: FloatArray, basis: IntArray, basic: IntArray, keep: bool) -> int:
    """Rank of the rows; ``basis`` gets one column for each independent row, which come first in the tableau.

    Elimination with complete pivoting; with ``keep`` only over the columns that ``basic`` names, as far as they go.
    """
    m, g = rows.shape[0], rows.shape[1] - 1
    width = tableau.shape[1]
    refill(rows, tableau)
    rank = ZERO
    while rank < m:
        best, row, column = 0.0, rank, rank
        for i in range(rank, m):
            for j in range(g):
                if abs(tableau[i, j]) > best and (not keep or basic[j] == 1):
                    best, row, column = abs(tableau[i, j]), i, j
        if best < DEPENDENT:
            if not keep:
                break
            keep = False
            for j in range(g):
                basic[j] = 0
            for i in range(rank):
                basic[basis[i]] = 1
            continue
        if row != rank:
            for k in range(width):
                tableau[row, k], tableau[rank, k] = tableau[rank, k], tableau[row, k]
        pivot(tableau, m, rank, column)
        basis[rank] = column
        rank += 1
    for j in range(g):
        basic[j] = 0
    for i in range(rank):
        basic[basis[i]] = 1
    return rank
