"""Whatever fails while something is set up, all that it had opened until then is closed again."""

import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import pytest
import zenoh

import fleet_bus.router
import reach_server.service.server
from fleet_bus import Role, open_session
from fleet_bus.pubsub import Declared
from fleet_bus.router import Router
from fleet_bus.zenoh_bus import ZenohBus
from fleet_cli.monitor import Monitor
from reach_server.service.server import ReachServer
from side_info.documents.scenario import Scenario
from side_info.service.publications import Publications
from side_info.service.service import SideInfoService
from tests.waiting import wait_until
from vehicle_agent import svea
from vehicle_agent.agent import Agent
from vehicle_agent.filters import PassThrough
from vehicle_agent.route import load_route
from vehicle_agent.sources import SimulatedSource

pytestmark = pytest.mark.integration


class InjectedError(Exception):
    """What these tests let fail."""


@dataclass
class Faults:
    """Every session that is opened and everything that is declared, the ``fails_at``-th of them with a failure."""

    fails_at: int = 0
    count: int = 0
    sessions: list[zenoh.Session] = field(default_factory=list)
    declared: list[Declared] = field(default_factory=list)

    def step(self) -> None:
        self.count += 1
        if self.count == self.fails_at:
            raise InjectedError

    def begin(self, fails_at: int) -> None:
        self.fails_at, self.count = fails_at, 0
        self.sessions.clear()
        self.declared.clear()

    def all_closed(self) -> bool:
        return all(session.is_closed() for session in self.sessions) and all(
            declared._handle is None for declared in self.declared
        )


@pytest.fixture
def faults(monkeypatch: pytest.MonkeyPatch) -> Iterator[Faults]:
    found = Faults()
    really_open, really_declare = zenoh.open, Declared.__init__

    def opening(config: zenoh.Config) -> zenoh.Session:
        found.step()
        session = really_open(config)
        found.sessions.append(session)
        return session

    def declaring(self: Declared, *arguments: object) -> None:
        found.step()
        really_declare(self, *arguments)  # type: ignore[arg-type]
        found.declared.append(self)

    monkeypatch.setattr(zenoh, "open", opening)
    monkeypatch.setattr(Declared, "__init__", declaring)
    yield found
    for session in found.sessions:
        if not session.is_closed():
            session.close()  # type: ignore[no-untyped-call]


def fail_everywhere(faults: Faults, begin: Callable[[], object], at_least: int) -> None:
    """Let ``begin`` fail at the first thing that it opens, at the second and so on, until it does not."""
    for fails_at in range(1, 100):
        faults.begin(fails_at)
        try:
            begin()
        except InjectedError:
            assert faults.all_closed(), f"something stays open after failure {fails_at}"
            continue
        assert fails_at > at_least
        assert faults.count == fails_at - 1
        return
    pytest.fail("it never succeeded")


def test_a_reach_server(router: Router, faults: Faults) -> None:
    def begin() -> None:
        with ReachServer("one", router.endpoints):
            pass

    fail_everywhere(faults, begin, at_least=8)
    assert faults.all_closed()


def test_a_reach_server_whose_last_step_fails(router: Router, faults: Faults, monkeypatch: pytest.MonkeyPatch) -> None:
    class Log:
        def info(self, *_: object, **__: object) -> None:
            raise InjectedError

    monkeypatch.setattr(reach_server.service.server, "_log", Log())
    with pytest.raises(InjectedError), ReachServer("one", router.endpoints):
        pytest.fail("it began")
    assert faults.sessions
    assert faults.all_closed()


def test_a_reach_server_of_which_something_cannot_be_closed(router: Router, faults: Faults) -> None:
    class Stuck(Declared):
        def close(self) -> None:
            raise InjectedError

    with pytest.raises(InjectedError), ReachServer("one", router.endpoints) as server:
        server._outbox._publishers["car"] = Stuck(faults.sessions[0], None)  # type: ignore[arg-type,assignment]
    assert all(session.is_closed() for session in faults.sessions)


def test_a_router(faults: Faults, monkeypatch: pytest.MonkeyPatch) -> None:
    really = fleet_bus.router._locators

    def fail(session: zenoh.Session) -> tuple[str, ...]:
        raise InjectedError

    monkeypatch.setattr(fleet_bus.router, "_locators", fail)
    with pytest.raises(InjectedError):
        Router(["tcp/127.0.0.1:0"])
    assert len(faults.sessions) == 1
    assert faults.all_closed()
    monkeypatch.setattr(fleet_bus.router, "_locators", really)
    with Router(["tcp/127.0.0.1:0"]) as router:
        assert router.endpoints


def test_a_side_info_service(router: Router, faults: Faults) -> None:
    with open_session(Role.SERVICE, router.endpoints) as session:

        def begin() -> None:
            stop = threading.Event()
            stop.set()
            SideInfoService(session, [Scenario.load("parking-lot")], {}, "one").run(stop)

        fail_everywhere(faults, begin, at_least=3)
        assert faults.all_closed()


def test_publications_of_which_one_cannot_be_queried() -> None:
    declared: list[str] = []

    class Queryable:
        def undeclare(self) -> None:
            declared.pop()

    class Session:
        def declare_queryable(self, key: str, *_: object, **__: object) -> Queryable:
            if declared:
                raise InjectedError
            declared.append(key)
            return Queryable()

    bus = ZenohBus(Session())  # type: ignore[arg-type]
    publications = Publications(bus, "spec/*/document", "spec/*/assignment/*")
    with pytest.raises(InjectedError), publications:
        pytest.fail("it began")
    assert declared == []


def test_an_agent(router: Router, faults: Faults) -> None:
    with open_session(Role.AGENT, router.endpoints) as session:

        def begin() -> None:
            source = SimulatedSource(load_route("parking-lot"), seed=1, history=0)
            with Agent(session, "car", svea.profile(), source, PassThrough()):
                pass

        fail_everywhere(faults, begin, at_least=3)
        assert faults.all_closed()


def test_a_monitor(router: Router, faults: Faults) -> None:
    def begin() -> None:
        with Monitor(router.endpoints):
            pass

    fail_everywhere(faults, begin, at_least=6)
    wait_until(faults.all_closed)
