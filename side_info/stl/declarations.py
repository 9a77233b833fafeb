"""The names that a formula may use."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

from side_info.stl.functions import FUNCTIONS

#: Words of the language: none of them can be the name of a state, region or parameter.
RESERVED: Final = frozenset(
    {
        "always", "globally", "alw", "G", "eventually", "finally", "ev", "F", "until", "U",
        "and", "or", "not", "implies", "in", "t", "k", "last", *FUNCTIONS,
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
