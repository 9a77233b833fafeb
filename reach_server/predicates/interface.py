"""The interface of predicates: strips, verdicts, the context, and the uncertainty of the states in a set."""

from dataclasses import dataclass, field
from typing import Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from reach_server.numeric.types import BoolArray, FloatArray

Verdict = NDArray[np.int8]
HOLDS: Final = 1
"""What ``verdict`` says of a set all of whose states certainly satisfy the predicate."""
MAY_HOLD: Final = 0
"""What ``verdict`` says of a set some of whose states may satisfy the predicate: nothing is known."""
NEVER: Final = -1
"""What ``verdict`` says of a set none of whose states satisfies the predicate, for certain."""


@dataclass(frozen=True, slots=True, eq=False)
class Context:
    """The quantities besides the state that predicates of R rows refer to.

    ``t`` (R,): seconds since the scenario's time zero. ``k`` (R,): samples ahead of the last received one. ``last_t``
    (R,): ``t`` of the last received sample. ``last_lower``, ``last_upper`` (R, n): a box around the true state at that
    sample. Nothing is known where a number is NaN. All times may be off by up to ``t_slack`` seconds. Rows may be the
    rows ``index`` (R,) of a ``cache``: what depends on the context alone is then computed for all of them at once.
    """

    t: FloatArray
    k: FloatArray
    last_t: FloatArray
    last_lower: FloatArray
    last_upper: FloatArray
    t_slack: float = 0.0
    cache: "ContextCache | None" = None
    index: NDArray[np.intp] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class ContextCache:
    """A context of many rows, and results computed for it, by predicate."""

    context: Context
    found: dict[Any, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, eq=False)
class Strips:
    """C strips ``lower <= normal·x <= upper`` for each of R sets: normal (C, n) or (R, C, n), lower and upper (C,) or
    (R, C). An infinite bound does not bind; every bound is outer."""

    normal: FloatArray
    lower: FloatArray
    upper: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class StateUncertainty:
    """How far the true state at the time a predicate speaks about may be from the state that a set holds.

    The true state at the sample is the set's plus ``noise`` (n, p) times factors from [-1, 1]; the predicate may speak
    about a time up to ``margin`` seconds away, when each state has moved by at most ``motion`` (n,).
    """

    noise: FloatArray
    motion: FloatArray
    margin: float

    @property
    def generators(self) -> FloatArray:
        """Noise and motion, (n, p + n): without the coordinates that do not move."""
        moving = np.flatnonzero(self.motion)
        return np.concatenate([self.noise, np.diag(self.motion)[:, moving]], axis=1)

    def still(self) -> "StateUncertainty":
        """The motion alone, without noise."""
        return StateUncertainty(np.zeros((len(self.motion), 0)), self.motion, self.margin)


class PredicateEnclosure(Protocol):
    """A predicate over the states of a class, enclosed over sets."""

    @property
    def fixed(self) -> bool:
        """Whether the strips depend neither on the set nor on the context."""

    def verdict(self, center: FloatArray, generators: FloatArray, context: Context) -> Verdict:
        """``HOLDS``, ``MAY_HOLD`` or ``NEVER`` (R,) for true states in zonotopes (R, n), (R, n, g)."""

    def strips(self, center: FloatArray, generators: FloatArray, context: Context) -> tuple[Strips, BoolArray]:
        """Strips that hold for every state of the sets whose true state may satisfy the predicate; and where there
        certainly is no such state, (R,)."""
