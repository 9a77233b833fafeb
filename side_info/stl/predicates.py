"""What an atom of a formula means: a set of states in a normal form that can be cut with."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

from fleet_bus.errors import ScenarioError
from side_info.stl.expression import Expression, names_of


@dataclass(frozen=True, slots=True)
class LinearPredicate:
    """``lower <= sum of coefficients[s] * s <= upper``: a strip, or a half-space where one bound is infinite.

    Units are those of the scenario's states. Raises ``ScenarioError`` for what is no such set.
    """

    name: str
    coefficients: Mapping[str, float]
    lower: float
    upper: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "coefficients", dict(self.coefficients))
        if not self.coefficients or not all(math.isfinite(c) and c for c in self.coefficients.values()):
            raise ScenarioError(f"{self.name}: coefficients {dict(self.coefficients)} must be finite and none zero")
        if not self.lower <= self.upper or not (math.isfinite(self.lower) or math.isfinite(self.upper)):
            raise ScenarioError(f"{self.name}: no state lies between {self.lower:g} and {self.upper:g}, or all do")

    def __hash__(self) -> int:
        return hash((self.name, frozenset(self.coefficients.items()), self.lower, self.upper))

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the states that it speaks about."""
        return tuple(self.coefficients)


@dataclass(frozen=True, slots=True)
class DiscPredicate:
    """The Euclidean distance of two states from ``center`` is at most ``radius`` (> 0); units of the states.

    Raises ``ScenarioError`` for what is no disc.
    """

    name: str
    center: Mapping[str, float]
    radius: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "center", dict(self.center))
        if len(self.center) != 2 or not all(map(math.isfinite, self.center.values())):
            raise ScenarioError(f"{self.name}: the center {dict(self.center)} must be two finite coordinates")
        if not (math.isfinite(self.radius) and self.radius > 0):
            raise ScenarioError(f"{self.name}: the radius {self.radius:g} must be finite and positive")

    def __hash__(self) -> int:
        return hash((self.name, frozenset(self.center.items()), self.radius))

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the states that it speaks about."""
        return tuple(self.center)


@dataclass(frozen=True, slots=True)
class NonlinearPredicate:
    """``expression >= 0``, where it is defined; where it is not, the predicate says nothing.

    The expression may speak about states, ``t``, ``k`` and the last received state. It has no kink in a state: ``abs``,
    ``min`` and ``max`` are applied to what is no state only.
    """

    name: str
    expression: Expression

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the states that it speaks about, not those inside ``last``, in alphabetical order."""
        return tuple(sorted(names_of(self.expression)))


Predicate = LinearPredicate | DiscPredicate | NonlinearPredicate
"""What an atom of a formula can mean."""
