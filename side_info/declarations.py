"""The names that a formula may use."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

#: Functions with a meaning in this version, and those that the language has but this version does not.
FUNCTIONS: Final = ("abs", "norm", "sumsqr")
LATER_FUNCTIONS: Final = (
    "sqrt", "exp", "log", "sin", "cos", "tan", "atan2", "hypot", "min", "max",
)  # fmt: skip

#: Words of the language: none of them can be the name of a state, region or parameter.
RESERVED: Final = frozenset(
    {
        "always", "globally", "alw", "G", "eventually", "finally", "ev", "F", "until", "U",
        "and", "or", "not", "implies", "in", *FUNCTIONS, *LATER_FUNCTIONS,
    }
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Declarations:
    """States, regions and parameters (numbers; durations in seconds) that a formula may name."""

    states: tuple[str, ...] = ()
    regions: tuple[str, ...] = ()
    parameters: Mapping[str, float] = field(default_factory=dict)

    def describe(self) -> str:
        """What is declared, in words."""
        kinds = (("states", self.states), ("regions", self.regions), ("parameters", tuple(self.parameters)))
        return "; ".join(f"{kind} {', '.join(names)}" for kind, names in kinds if names) or "nothing"
