"""How far a vehicle's clock is from the server's, from the stamps of its samples and the times at which they come."""

from dataclasses import dataclass
from typing import Final

#: Samples of at least this long, and at most twice as long, say what the offset is now (s).
PERIOD: Final = 10.0
#: Offset at which an operator is told, and within which a scenario with a time zero of its own is believed (s).
CLOCK_BOUND: Final = 1.0


@dataclass(slots=True)
class ClockOffset:
    """Greatest and least of stamp minus time of arrival (s), over the last period.

    A message takes no negative time, so the vehicle's clock is ahead of the server's by at least the greatest
    difference; by how much more, the way that the fastest message took, nobody can tell from one side. The spread says
    how much that way varies.
    """

    greatest: float = -float("inf")
    _least: float = float("inf")
    _before: tuple[float, float] = (-float("inf"), float("inf"))
    _since: float = -float("inf")
    off: bool = False

    def see(self, difference: float, now: float) -> None:
        """Take in stamp minus time of arrival (s) of a live sample, at ``now`` (s)."""
        if now - self._since > PERIOD:
            # What is older than two periods says nothing any more.
            stale = now - self._since > 2 * PERIOD
            self._before = (-float("inf"), float("inf")) if stale else (self.greatest, self._least)
            self.greatest, self._least, self._since = -float("inf"), float("inf"), now
        self.greatest = max(self.greatest, difference)
        self._least = min(self._least, difference)

    @property
    def offset(self) -> float:
        """By how much the vehicle's clock is ahead, at least (s)."""
        return max(self.greatest, self._before[0])

    @property
    def spread(self) -> float:
        """How much less other samples said (s)."""
        return max(0.0, self.offset - min(self._least, self._before[1]))

    @property
    def known(self) -> bool:
        """Whether any live sample has come."""
        return self.offset > -float("inf")

    def crossed(self, bound: float = CLOCK_BOUND) -> bool:
        """Whether the offset has left the bound, or has come back into half of it, since the last call."""
        was, size = self.off, abs(self.offset)
        self.off = size > bound if not was else size > bound / 2
        return self.off != was
