"""Predicates whose strips are the same for every set: half-spaces and strips, and the tangents of a bounded region.

A strip ``lower <= a·x <= upper`` about true states x is one about the states ``y = x + Nζ``, ``|ζ| <= 1``, that a set
holds, wider by ``|aN|₁`` on each side. Motion widens it likewise: a predicate that held up to s seconds from the
sample held of a state within ``s v`` of it, coordinate by coordinate, where v bounds the speeds.
"""

from dataclasses import dataclass, field

import numpy as np

from reach_server.numeric.jit import read_only
from reach_server.numeric.types import BoolArray, FloatArray
from reach_server.predicates.fixed_verdict import fixed_verdict
from reach_server.predicates.interface import Context, StateUncertainty, Strips, Verdict
from reach_server.predicates.interval_ad.linear_range import reach, spread
from reach_server.sets.halfspace import strip_bounds


@dataclass(frozen=True, slots=True, eq=False)
class FixedStrips:
    """C strips of true states, normal (C, n), lower and upper (C,), and the ``uncertainty`` of the states of a set.

    ``cut`` are the strips of the states that a set holds, ``moved`` those of true states at the sample: outer.
    """

    normal: FloatArray
    lower: FloatArray
    upper: FloatArray
    uncertainty: StateUncertainty
    cut: Strips = field(init=False)
    moved: Strips = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "cut", self._widened(self.uncertainty))
        object.__setattr__(self, "moved", self._widened(self.uncertainty.still()))

    def _widened(self, uncertainty: StateUncertainty) -> Strips:
        return Strips(self.normal, *spread(self.lower, self.upper, reach(self.normal, uncertainty.generators)))


@dataclass(frozen=True, slots=True, eq=False)
class HalfspaceEnclosure:
    """A half-space or strip, exactly: ``region`` has one row."""

    region: FixedStrips

    @property
    def fixed(self) -> bool:
        """True."""
        return True

    def verdict(self, center: FloatArray, generators: FloatArray, context: Context) -> Verdict:
        """See ``PredicateEnclosure``: exact, up to rounding."""
        region, moved = self.region, self.region.moved
        bounds = region.normal, region.lower, region.upper, moved.lower, moved.upper
        return fixed_verdict(*map(read_only, (*bounds, center, generators)))

    def strips(self, center: FloatArray, generators: FloatArray, context: Context) -> tuple[Strips, BoolArray]:
        """See ``PredicateEnclosure``."""
        return self.region.cut, missed(self.region.cut, center, generators)


def missed(strips: Strips, center: FloatArray, generators: FloatArray) -> BoolArray:
    """Where sets (R) certainly miss one of C strips, (R,)."""
    found = strip_bounds(center[:, None], generators[:, None], strips.normal, strips.lower, strips.upper)[3]
    return np.asarray(found.any(axis=1))


def verdict_of(holds: BoolArray, never: BoolArray) -> Verdict:
    """The verdict from what is certain; a contradiction, which only rounding makes, counts as ``MAY_HOLD``."""
    return np.where(holds == never, 0, np.where(holds, 1, -1)).astype(np.int8)
