"""When a vehicle started, from the samples it publishes."""

from collections.abc import Iterable
from dataclasses import dataclass

from fleet_bus.messages import StateFlag


@dataclass(slots=True)
class VehicleStart:
    """Start of a vehicle's current trajectory, in ns since the Unix epoch, as far as its samples tell.

    ``started`` is the stamp of the sample that came last of those that begin a trajectory, ``first`` the
    earliest stamp of any; what was recorded before the agent started (``StateFlag.HISTORY``) does not count.
    """

    started: int | None = None
    first: int | None = None

    @property
    def time_zero(self) -> int | None:
        """``started`` where it is known, else ``first``: a guess, which can only be late."""
        return self.first if self.started is None else self.started

    def see(self, samples: Iterable[tuple[int, int]]) -> None:
        """Take in stamps and flags of samples, in the order in which they were published."""
        for t, flags in samples:
            if flags & StateFlag.HISTORY:
                continue
            if flags & StateFlag.NEW_TRAJECTORY:
                self.started = t
            self.first = t if self.first is None else min(self.first, t)
