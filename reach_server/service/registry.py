"""Who is known: the vehicles, the class of each, and one engine a class."""

from collections.abc import Callable
from typing import Final

import structlog

from fleet_bus.errors import MessageError, UsageError
from fleet_bus.messages import VehicleProfile
from reach_server.engine.engine import Engine
from reach_server.service.vehicle import Vehicle

_log = structlog.get_logger(__name__)

#: Seconds of silence after which a vehicle may be let go, and after which it is; and how many silent ones are kept.
SILENT: Final = 30.0
LET_GO: Final = 600.0
LEAST_SILENT_KEPT: Final = 16
#: Vehicles that are known at once, those without a profile among them.
MOST_VEHICLES: Final = 20_000


class VehicleRegistry:
    """Vehicles by id, and engines by the shape of their profiles.

    ``stamp`` tells the time of events that no sample tells (ns since the Unix epoch); without it the newest time that
    was handed in does.
    """

    def __init__(self, stamp: Callable[[], int] | None = None) -> None:
        self._stamp = stamp
        self._engines: dict[tuple[object, ...], Engine] = {}
        self._now = 0.0
        self.vehicles: dict[str, Vehicle] = {}
        #: Vehicles whose clocks are not believed, and what their tubes say.
        self.clocks_off: dict[str, str] = {}

    @property
    def engines(self) -> tuple[Engine, ...]:
        """One engine per vehicle class."""
        return tuple(self._engines.values())

    @property
    def stamp(self) -> int:
        """The time of now as a stamp (ns)."""
        return max(1, int(self._now * 1e9)) if self._stamp is None else self._stamp()

    def advance(self, now: float | None) -> float:
        """Take in the time (s), if it is told, and return the newest one."""
        if now is not None:
            self._now = max(self._now, now)
        return self._now

    @property
    def full(self) -> str:
        """Why one more vehicle cannot be known."""
        return f"{MOST_VEHICLES} vehicles are known already"

    def known(self, vehicle: str) -> Vehicle | None:
        """What is known of a vehicle, which is known from now on; None where ``MOST_VEHICLES`` others are."""
        known = self.vehicles.get(vehicle)
        if known is None and len(self.vehicles) < MOST_VEHICLES:
            known = self.vehicles[vehicle] = Vehicle()
        return known

    def check_usable(self, profile: VehicleProfile) -> None:
        """Raise ``MessageError`` for a profile that no engine can work with."""
        if profile.shape_key() in self._engines:
            return
        try:
            Engine(profile)
        # Whatever it is about a profile that no engine can be made for: the one before, if there is one, stays.
        except UsageError as error:
            raise MessageError("fields", str(error)) from None
        except Exception as error:
            _log.exception("no engine for a profile")
            raise MessageError("fields", f"no engine can work with it: {type(error).__name__}: {error}") from None

    def enter(self, vehicle: str, known: Vehicle, profile: VehicleProfile) -> None:
        """Give a vehicle a slot of its class."""
        key = profile.shape_key()
        engine = self._engines.get(key)
        if engine is None:
            engine = self._engines[key] = Engine(profile)
        known.engine, known.slot = engine, engine.add(vehicle)

    def leave(self, vehicle: str, engine: Engine) -> None:
        """Take a vehicle out of a class; a class that nobody is left in goes."""
        engine.remove(vehicle)
        if not engine.count:
            self._engines = {key: other for key, other in self._engines.items() if other is not engine}

    def let_go(self, now: float) -> list[str]:
        """Forget vehicles that have been silent for long, or that more than enough are silent beside; their ids."""
        silent = sorted(
            (known.seen, vehicle) for vehicle, known in self.vehicles.items() if known.gone or now - known.seen > SILENT
        )
        live = len(self.vehicles) - len(silent)
        # While nobody is heard it is the network that is silent.
        most = max(LEAST_SILENT_KEPT, live // 4) if live else len(silent)
        surplus = max(len(silent) - most, 0)
        gone = [vehicle for index, (seen, vehicle) in enumerate(silent) if index < surplus or now - seen > LET_GO]
        for vehicle in gone:
            self.clocks_off.pop(vehicle, None)
            engine = self.vehicles.pop(vehicle).engine
            if engine is not None:
                self.leave(vehicle, engine)
        return gone
