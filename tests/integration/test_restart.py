"""A killed server and a stopped router cost no sample: the agents' caches are the database."""

import threading

import pytest

from fleet_bus import Role, keys, open_session
from fleet_bus.pubsub import Received, subscribe
from fleet_bus.router import Router
from reach_server.service.server import ReachServer
from tests.integration.conftest import Start, serving
from tests.waiting import DEADLINE, wait_until

pytestmark = pytest.mark.integration


def complete(held: list[tuple[int, int]]) -> bool:
    """One epoch, every seq from the first to the last, none twice."""
    return [seq for _, seq in held] == list(range(held[0][1], held[0][1] + len(held))) and len(
        {e for e, _ in held}
    ) == 1


def window_size(server: ReachServer) -> int:
    return next((engine.window.size for engine in server.fleet.engines), -1)


def test_windows_are_full_again_after_a_kill(router: Router, start: Start) -> None:
    endpoint = router.endpoints[0]
    vehicles = ["svea1", "svea2", "svea3"]
    first = start("reach", "--id", "reach-1", "--router", endpoint)
    first.expect("ready")
    tubes: set[str] = set()
    agents = start("agent", *(part for v in vehicles for part in ("--vehicle", v)), "--router", endpoint)
    with open_session(Role.VIEWER, [endpoint]) as session:

        def note(received: Received) -> None:
            tubes.add(keys.vehicle_of(received.key))

        with subscribe(session, keys.ALL_TUBES, note):
            wait_until(lambda: tubes == set(vehicles))
            first.process.kill()
            first.process.wait(DEADLINE)
            tubes.clear()
            with serving(endpoint) as server:
                wait_until(
                    lambda: (
                        all(server.fleet.profile_of(v) for v in vehicles)
                        and all(len(server.fleet.window_keys(v)) == window_size(server) for v in vehicles)
                    )
                )
                for vehicle in vehicles:
                    assert complete(server.fleet.window_keys(vehicle))
                wait_until(lambda: tubes == set(vehicles))
    assert agents.end() == 0


def test_a_router_away_for_five_seconds_loses_nothing(start: Start) -> None:
    router = Router(["tcp/127.0.0.1:0"])
    endpoint = router.endpoints[0]
    agent = start("agent", "--vehicle", "svea1", "--router", endpoint)
    agent.expect("agents ready")
    with serving(endpoint) as server:

        def newest() -> int:
            held = server.fleet.window_keys("svea1")
            return held[-1][1] if held else -1

        wait_until(lambda: newest() > 1030)
        router.close()
        before = newest()
        threading.Event().wait(5.0)  # the outage itself
        assert agent.process.poll() is None
        # What had come before the outage may still be on its way through a busy server.
        during = newest()
        with Router([endpoint]):
            wait_until(lambda: newest() > during + 110)
            held = server.fleet.window_keys("svea1")
            assert complete(held)
            assert held[0][1] < before
            assert agent.end() == 0
