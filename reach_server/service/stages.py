"""Where the time of a round goes: seconds by stage."""

from typing import Final

from fleet_bus.clock import Clock

#: The stages of a round, in order: rare messages; payloads read; samples let in; samples stored, predictions checked;
#: scenarios shown what was measured; models learned; sets computed and cut; tubes encoded and put; and the rest.
STAGES: Final = (
    "control", "decode", "admit", "append", "side_information", "learn", "sets", "publish", "upkeep",
)  # fmt: skip


class Stages:
    """``seconds`` spent so far, by stage; one thread measures, any may read."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._last = clock.monotonic()
        self.seconds: dict[str, float] = dict.fromkeys(STAGES, 0.0)

    def begin(self) -> None:
        """A round begins."""
        self._last = self._clock.monotonic()

    def passed(self, stage: str) -> None:
        """A stage is over: the time since the one before it was its own."""
        now = self._clock.monotonic()
        self.seconds[stage] += now - self._last
        self._last = now
