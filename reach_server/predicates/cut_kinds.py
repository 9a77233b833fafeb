"""Methods to cut a set by predicates, each with its properties."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from fleet_bus.messages.methods import CutMethod

__all__ = ["CUT_KINDS", "CutKind", "CutMethod"]


@dataclass(frozen=True, slots=True)
class CutKind:
    """A way to cut sets.

    Attributes:
        adds_constraints: cuts become constraints of the set, which is a zonotope no longer.
        keeps_larger_result: what comes out is taken even where it is larger than what was cut, as the paper's
            Algorithm 2 has it, which takes each strip once and as it is given.
        passes: how often all predicates cut, where some of them depend on what the others left.
    """

    adds_constraints: bool = False
    keeps_larger_result: bool = False
    passes: int = 1


CUT_KINDS: Final[Mapping[CutMethod, CutKind]] = {
    "zonotope": CutKind(passes=2),
    "constrained": CutKind(adds_constraints=True),
    "frobenius": CutKind(keeps_larger_result=True),
}
