"""The clock of a process, as something that can be handed in."""

import time
from threading import Event
from typing import Final, Protocol


class Clock(Protocol):
    """Tells the time and passes it."""

    def monotonic(self) -> float:
        """Seconds that never go back, from any origin."""

    def time_ns(self) -> int:
        """Time of day, ns since the Unix epoch."""

    def wait(self, event: Event, seconds: float) -> bool:
        """Wait until an event is set, ``seconds`` at most; whether it is."""


class SystemClock:
    """The clocks of this machine."""

    def monotonic(self) -> float:
        """See ``Clock``."""
        return time.monotonic()

    def time_ns(self) -> int:
        """See ``Clock``."""
        return time.time_ns()

    def wait(self, event: Event, seconds: float) -> bool:
        """See ``Clock``."""
        return event.wait(seconds)


SYSTEM: Final = SystemClock()
