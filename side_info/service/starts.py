"""When a vehicle started, from the samples it publishes."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Final

from fleet_bus.messages import StateFlag
from fleet_bus.writers import Change, Source, Turn, Writer

#: Seconds after which a silent agent may be followed by another, and after which one of two has left.
PATIENCE: Final = 1.0
LEAVE: Final = 4.0
#: Samples of another source that are held; those that begin a trajectory come first.
MOST_HELD: Final = 4096


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
    writer: Writer = field(default_factory=Writer)
    held: list[tuple[int, int]] = field(default_factory=list)

    def take_in(self, source: Source, samples: Sequence[tuple[int, int]], now: float) -> bool:
        """Take in stamps and flags of samples of one source, at ``now`` (s); whether they count.

        Those of a second source are held until the first has been silent: what somebody else puts must not move time
        zero.
        """
        turn, change = self.writer.judge(source, len(samples), now, PATIENCE, LEAVE)
        self._settle(change)
        if turn is Turn.ACCEPT:
            self.see(samples)
        elif turn is Turn.HOLD:
            self.held += samples[: MOST_HELD - len(self.held)]
        return turn is Turn.ACCEPT

    def elapse(self, now: float) -> bool:
        """Whether another source counts from ``now`` (s) on."""
        change = self.writer.elapse(now, PATIENCE, LEAVE)
        self._settle(change)
        return change in (Change.TAKEN_OVER, Change.LOST)

    def _settle(self, change: Change) -> None:
        if change in (Change.NONE, Change.CONFLICT):
            return
        held, self.held = self.held, []
        if change in (Change.TAKEN_OVER, Change.LOST):
            self.see(held)

    def see(self, samples: Iterable[tuple[int, int]]) -> None:
        """Take in stamps and flags of samples, in the order in which they were published."""
        for t, flags in samples:
            if flags & StateFlag.HISTORY:
                continue
            self.seen = True
            if flags & StateFlag.NEW_TRAJECTORY:
                self.time_zero = t
