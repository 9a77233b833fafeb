"""When a vehicle started, from the samples it publishes."""

from collections.abc import Iterable
from dataclasses import dataclass

from fleet_bus.messages import StateFlag


@dataclass(slots=True)
class VehicleStart:
    """Start of a vehicle's current trajectory, in ns since the Unix epoch, as far as its samples tell.

    ``time_zero`` is the stamp of the sample that came last of those that begin a trajectory; None while none has been
    seen. ``seen`` says whether there was any sample. What was recorded before the agent started
    (``StateFlag.HISTORY``) does not count. Nothing is guessed: a time zero that is too late would cut sets by what
    does not hold yet.
    """

    time_zero: int | None = None
    seen: bool = False

    def see(self, samples: Iterable[tuple[int, int]]) -> None:
        """Take in stamps and flags of samples, in the order in which they were published."""
        for t, flags in samples:
            if flags & StateFlag.HISTORY:
                continue
            self.seen = True
            if flags & StateFlag.NEW_TRAJECTORY:
                self.time_zero = t
