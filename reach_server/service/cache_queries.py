"""What agents' caches still hold of what came before a server could hear them: asked for once per start of an agent."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Final

import structlog
import zenoh

from fleet_bus import keys
from fleet_bus.bus import Bus
from fleet_bus.pubsub import Received
from reach_server.service.fleet import Fleet

_log = structlog.get_logger(__name__)

#: Samples asked of each agent's cache when the server starts; more than any window holds.
HISTORY: Final = 100_000
#: A vehicle whose first samples, or whose profile, are still missing after this long gets one query of its cache.
GRACE_SECONDS: Final = 0.2
QUERY_SECONDS: Final = 2.0
#: Caches that are asked at once.
QUERIES: Final = 16


class CacheQueries:
    """Asks the caches of vehicles in threads of its own; ``take_in`` gets what they hold, on these threads. What is
    known already is dropped by the window. A context manager: queries that have not begun are given up at its end."""

    def __init__(self, bus: Bus, fleet: Fleet, take_in: Callable[[Received], None]) -> None:
        self._bus = bus
        self._fleet = fleet
        self._take_in = take_in
        #: When vehicles were first heard (s), epochs whose cache was asked for samples, and vehicles whose cache was
        #: asked for the profile.
        self._seen: dict[str, float] = {}
        self._asked: dict[str, int] = {}
        self._asked_profile: set[str] = set()
        self._pool = ThreadPoolExecutor(QUERIES, thread_name_prefix="cache-query")

    def see(self, vehicle: str, now: float) -> None:
        """A vehicle was heard at ``now`` (s)."""
        self._seen.setdefault(vehicle, now)

    def forget(self, vehicle: str) -> None:
        """Ask again when a vehicle comes back: its cache may hold what was missed meanwhile."""
        self._asked.pop(vehicle, None)
        self._asked_profile.discard(vehicle)
        self._seen.pop(vehicle, None)

    def ask(self, now: float) -> None:
        """Ask for what is still missing at ``now`` (s), once per start of an agent."""
        for vehicle, since in list(self._seen.items()):
            if now - since < GRACE_SECONDS:
                continue
            if vehicle not in self._asked_profile and self._fleet.waits_for_profile(vehicle):
                self._asked_profile.add(vehicle)
                self._pool.submit(self._fetch, keys.profile(vehicle), 1)
            first = self._fleet.first_sample(vehicle)
            if first is None or self._asked.get(vehicle) == first[0]:
                continue
            self._asked[vehicle] = first[0]
            if first[1] > 0:
                self._pool.submit(self._fetch, keys.state(vehicle), HISTORY)

    def _fetch(self, key: str, most: int) -> None:
        try:
            found = self._bus.query(key, max_samples=most, timeout=QUERY_SECONDS)
        except zenoh.ZError as error:
            _log.warning("cache query failed", key=key, error=str(error))
            return
        for received in found:
            self._take_in(received)

    def __enter__(self) -> "CacheQueries":
        return self

    def __exit__(self, *exc_info: object) -> None:
        self._pool.shutdown(wait=False, cancel_futures=True)
