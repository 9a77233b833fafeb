"""Arguments of sine, cosine and tangent, less a multiple of π/2: the rest has a small error of its own size.

A library that reduces an argument may leave an absolute error, which near a multiple of π is all that there is of a
sine. Here π/2 is a sum of five numbers, four of them of at most 27 bits, so that their products with a whole number
below 2²⁶ are exact; the difference is summed with what each step loses. The last product, π/2 beyond 2⁻¹⁶⁸ and the sum
of the losses are off by less than 2⁻¹⁰⁰ in all unless the rest is above 2⁻⁵⁰, where they are by less than 2⁻¹⁰⁰ of it.
Of all numbers up to ``FARTHEST``, 45.553093477052 is nearest to a multiple of π/2: 2⁻⁶⁰·⁵ from it.
"""

from typing import Final, NamedTuple

import numpy as np

from reach_server.numeric.types import BoolArray, FloatArray

#: Beyond this an argument is not reduced.
FARTHEST: Final = 1e8
#: Below this there is nothing to reduce.
_NEAR: Final = 0.75
#: π/2, to 2⁻¹⁶⁰.
_PARTS: Final = tuple(
    map(
        float.fromhex,
        ("0x1.921fb54p+0", "0x1.10b461p-30", "0x1.a62633p-58", "0x1.45c06ep-86", "0x1.cd129024e088ap-115"),
    )
)


class Reduced(NamedTuple):
    """Arguments (...,) as ``turns · π/2 + rest``, with ``|rest| <= π/4`` but for rounding; ``rest`` is 0 for 0 only."""

    turns: FloatArray
    rest: FloatArray


def reduced(argument: FloatArray) -> Reduced:
    """Arguments of absolute value up to ``FARTHEST``, reduced; ``rest`` to half an ulp."""
    argument = np.asarray(argument)
    if not (np.abs(argument) > _NEAR).any():
        return Reduced(np.zeros_like(argument), argument)
    turns = np.rint(argument * (2 / np.pi))
    rest, lost = argument, np.zeros_like(argument)
    for part in _PARTS:
        product = turns * part
        total = rest - product
        back = total - rest
        lost = lost + ((rest - (total - back)) - (product + back))
        rest = total
    return Reduced(turns, rest + lost)


def passes(low: Reduced, high: Reduced, place: int, period: int) -> BoolArray:
    """Where ``(place + k · period) π/2`` lies between two arguments for some whole k: exact."""
    first = low.turns + (low.rest > 0)
    last = high.turns - (high.rest < 0)
    return np.asarray(np.floor((last - place) / period) >= np.ceil((first - place) / period))
