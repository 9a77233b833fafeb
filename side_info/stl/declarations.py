"""The names that a formula may use."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

#: Functions, with the least and the largest number of their arguments (None: any).
FUNCTIONS: Final[Mapping[str, tuple[int, int | None]]] = {
    "abs": (1, 1), "sqrt": (1, 1), "exp": (1, 1), "log": (1, 1), "sin": (1, 1), "cos": (1, 1), "tan": (1, 1),
    "atan2": (2, 2), "hypot": (1, None), "norm": (1, None), "sumsqr": (1, None), "min": (1, None), "max": (1, None),
}  # fmt: skip

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
