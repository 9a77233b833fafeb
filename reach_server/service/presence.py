"""Which vehicles are gone: a token that goes is news only where the samples stop as well."""

from dataclasses import dataclass, field
from typing import Final

#: Seconds without samples after which a vehicle without a token is gone; and sample intervals that it is at least.
SILENCE: Final = 2.5
INTERVALS: Final = 5.0
#: Seconds between two looks after which a server may not have heard what was sent; it looks once a second, or as soon
#: after that as its round is over.
STARVED: Final = 2.0


@dataclass(slots=True)
class Presence:
    """Tokens that have gone, and since when (s), until their vehicles are heard again or are told as gone."""

    _missing: dict[str, float] = field(default_factory=dict)
    _last_round: float | None = None

    def token(self, vehicle: str, alive: bool, now: float) -> None:
        """A token has come or gone."""
        if alive:
            self._missing.pop(vehicle, None)
        else:
            self._missing[vehicle] = now

    def gone(self, heard: dict[str, float], interval: dict[str, float], now: float) -> list[str]:
        """Vehicles of which it is certain at ``now`` that they are gone, each told once.

        ``heard`` has when samples of the vehicles in ``waiting`` came last (s), ``interval`` their sample times (s).
        """
        last, self._last_round = self._last_round, now
        if last is not None and now - last > STARVED:
            # Whoever was sending meanwhile has not been heard: silence counts from now on.
            self._missing = dict.fromkeys(self._missing, now)
        gone = []
        for vehicle, since in list(self._missing.items()):
            silence = max(SILENCE, INTERVALS * interval.get(vehicle, 0.0))
            if heard.get(vehicle, -float("inf")) > since:
                # It was heard after its token went: it is there, its token was lost on the way.
                if now - heard[vehicle] <= silence:
                    continue
                since = heard[vehicle]
            if now - since > silence:
                del self._missing[vehicle]
                gone.append(vehicle)
        return gone

    @property
    def waiting(self) -> tuple[str, ...]:
        """Vehicles without a token of which nothing has been told yet."""
        return tuple(self._missing)

    def forget(self, vehicle: str) -> None:
        """A vehicle is not known any more."""
        self._missing.pop(vehicle, None)
