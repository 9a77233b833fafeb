"""The side-info service on a real router."""

import queue
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
import zenoh
from structlog.testing import capture_logs

from fleet_bus import keys
from fleet_bus.errors import KeyIdError
from fleet_bus.messages import Assignment, ScenarioDocument, ServiceStatus, StateFlag, StateSample
from fleet_bus.messages.state import ENCODING
from fleet_bus.pubsub import (
    CachedPublisher,
    Received,
    declare_cached_publisher,
    declare_recovering_subscriber,
    watch_alive,
)
from fleet_bus.router import Router
from fleet_bus.sessions import Role, open_session
from side_info import Scenario, ScenarioError
from side_info.service.service import SideInfoService
from tests.side_info.corpus import DOCUMENT
from tests.waiting import DEADLINE, wait_until

pytestmark = pytest.mark.integration

LOT = Scenario.parse(DOCUMENT)
PLANNED = Scenario.parse(DOCUMENT.replace("lot", "planned").replace("on_start", '"2026-05-01T12:00:00Z"'))
PLANNED_ZERO = 1777636800 * 10**9
NEW, HISTORY, NONE = StateFlag.NEW_TRAJECTORY, StateFlag.HISTORY, StateFlag.NONE


@pytest.fixture
def router() -> Iterator[Router]:
    with Router(["tcp/127.0.0.1:0"]) as running:
        yield running


@pytest.fixture
def session(router: Router) -> Iterator[zenoh.Session]:
    with open_session(Role.SERVICE, router.endpoints) as opened:
        yield opened


@pytest.fixture
def agent(router: Router) -> Iterator[zenoh.Session]:
    with open_session(Role.AGENT, router.endpoints) as opened:
        wait_until(lambda: list(opened.info.routers_zid()))
        yield opened


@pytest.fixture
def viewer(router: Router) -> Iterator[zenoh.Session]:
    with open_session(Role.VIEWER, router.endpoints) as opened:
        yield opened


@contextmanager
def running(service: SideInfoService) -> Iterator[None]:
    stop = threading.Event()
    with ThreadPoolExecutor(1) as pool:
        run = pool.submit(service.run, stop)
        try:
            yield
        finally:
            stop.set()
        run.result(DEADLINE)


@contextmanager
def listening(session: zenoh.Session, key: str) -> Iterator[Callable[[], Received]]:
    """Next sample on ``key``, also of publishers that were or come later."""
    arrived: queue.Queue[Received] = queue.Queue()
    with declare_recovering_subscriber(session, key, arrived.put, history=10, late_publishers=True):
        yield lambda: arrived.get(timeout=DEADLINE)


def publisher(session: zenoh.Session, vehicle: str) -> CachedPublisher:
    return declare_cached_publisher(session, keys.state(vehicle), ENCODING, cache=100)


def put(publisher: CachedPublisher, *samples: tuple[int, StateFlag]) -> None:
    for t, flags in samples:
        publisher.put(StateSample(1, t, t, np.zeros(2), np.zeros(0), flags).encode())


def assignment(received: Received) -> tuple[str, str, int]:
    found = Assignment.decode(received.payload, received.encoding)
    assert received.key == keys.assignment(found.scenario, found.vehicle)
    return found.scenario, found.vehicle, found.time_zero


def version(received: Received) -> int:
    return ScenarioDocument.decode(received.payload, received.encoding).version


def status(received: Received) -> ServiceStatus:
    return ServiceStatus.decode(received.payload, received.encoding)


def test_documents_are_published_as_they_were_written(session: zenoh.Session, viewer: zenoh.Session) -> None:
    with running(SideInfoService(session, [LOT, PLANNED], {}, "a")), listening(viewer, keys.ALL_DOCUMENTS) as get:
        received = [get(), get()]
    documents = {r.key: ScenarioDocument.decode(r.payload, r.encoding) for r in received}
    assert documents == {
        keys.document(s.name): ScenarioDocument(scenario=s.name, version=1, text=s.text) for s in (LOT, PLANNED)
    }


def test_a_service_that_starts_late_learns_the_start_from_the_cache(
    session: zenoh.Session, agent: zenoh.Session, viewer: zenoh.Session
) -> None:
    with publisher(agent, "svea1") as states, listening(viewer, keys.ALL_ASSIGNMENTS) as get:
        put(states, (100, NEW | HISTORY), (200, HISTORY), (1000, NEW), (1050, NONE), (1100, NONE))
        with running(SideInfoService(session, [LOT], {"*": "lot"}, "a")):
            assert assignment(get()) == ("lot", "svea1", 1000)


def test_a_new_trajectory_moves_time_zero(session: zenoh.Session, agent: zenoh.Session, viewer: zenoh.Session) -> None:
    service = SideInfoService(session, [LOT], {"svea1": "lot"}, "a", clock_offset=0.02)
    with publisher(agent, "svea1") as states, listening(viewer, keys.ALL_ASSIGNMENTS) as get, running(service):
        put(states, (1000, NEW), (1050, NONE))
        first = get()
        assert Assignment.decode(first.payload).clock_offset == 0.02
        assert assignment(first) == ("lot", "svea1", 1000)
        put(states, (2000, NEW), (2050, NONE))
        assert assignment(get()) == ("lot", "svea1", 2000)


def test_a_start_that_was_missed_is_fetched_from_the_vehicle(
    session: zenoh.Session, agent: zenoh.Session, viewer: zenoh.Session
) -> None:
    # With so short a history the service is where it is with a vehicle that connects later.
    service = SideInfoService(session, [LOT], {"*": "lot"}, "a", history=1)
    with publisher(agent, "svea1") as states, listening(viewer, keys.ALL_ASSIGNMENTS) as get:
        put(states, (1000, NEW), (1050, NONE))
        with running(service):
            assert assignment(get()) == ("lot", "svea1", 1000)


def test_without_a_start_nothing_is_guessed(
    session: zenoh.Session, agent: zenoh.Session, viewer: zenoh.Session
) -> None:
    service = SideInfoService(session, [LOT], {"*": "lot"}, "a")
    status = keys.service_status("side-info", "a")
    with (
        publisher(agent, "svea1") as states,
        listening(viewer, keys.ALL_ASSIGNMENTS) as get,
        listening(viewer, status) as get_status,
    ):
        put(states, (900, HISTORY), (1000, NONE), (1050, NONE))
        with running(service):
            wait_until(lambda: ServiceStatus.decode(get_status().payload).gauges["starts_not_seen"] == 1)
            put(states, (2000, NEW))
            assert assignment(get()) == ("lot", "svea1", 2000)


def test_a_scenario_with_an_instant_needs_no_sample_of_a_vehicle_that_is_named(
    session: zenoh.Session, agent: zenoh.Session, viewer: zenoh.Session
) -> None:
    assign = {"svea1": "planned", "*": "planned", "svea2": "lot"}
    with listening(viewer, keys.ALL_ASSIGNMENTS) as get, running(SideInfoService(session, [LOT, PLANNED], assign, "a")):
        assert assignment(get()) == ("planned", "svea1", PLANNED_ZERO)
        with publisher(agent, "svea3") as states, publisher(agent, "svea2") as others:
            put(states, (5, NONE))
            assert assignment(get()) == ("planned", "svea3", PLANNED_ZERO)
            put(others, (7, NEW))
            assert assignment(get()) == ("lot", "svea2", 7)


def test_bad_samples_are_counted_and_harm_nobody(
    session: zenoh.Session, agent: zenoh.Session, viewer: zenoh.Session
) -> None:
    status = keys.service_status("side-info", "a")
    service = SideInfoService(session, [LOT], {"*": "lot"}, "a")
    with (
        listening(viewer, status) as get_status,
        listening(viewer, keys.ALL_ASSIGNMENTS) as get,
        publisher(agent, "svea1") as states,
        publisher(agent, "svea2") as others,
    ):
        others.put(b"\xc1")
        others.put(b"")
        put(states, (1000, NEW))
        with running(service):
            assert assignment(get()) == ("lot", "svea1", 1000)
            agent.put("fleet/bad name/state", b"", encoding=ENCODING)

            def latest() -> dict[str, int]:
                return ServiceStatus.decode(get_status().payload).refused

            wait_until(lambda: latest() == {"malformed": 2, "key": 1})


def test_the_service_is_seen_while_it_runs(session: zenoh.Session, viewer: zenoh.Session) -> None:
    seen: queue.Queue[tuple[str, bool]] = queue.Queue()
    with watch_alive(viewer, "svc/side-info/*", lambda key, alive: seen.put((key, alive))):
        with running(SideInfoService(session, [LOT], {}, "a")):
            assert seen.get(timeout=DEADLINE) == ("svc/side-info/a", True)
        assert seen.get(timeout=DEADLINE) == ("svc/side-info/a", False)


def test_a_changed_file_is_published_and_a_bad_one_refused(
    session: zenoh.Session, viewer: zenoh.Session, tmp_path: Path
) -> None:
    path = tmp_path / "lot.yaml"
    path.write_text(DOCUMENT, encoding="utf-8")
    second = DOCUMENT.replace("version: 1", "version: 2")
    service = SideInfoService(session, [LOT, PLANNED], {}, "a", files={"lot": path})
    with (
        listening(viewer, keys.document("lot")) as get,
        listening(viewer, keys.service_status("side-info", "a")) as get_status,
        running(service),
    ):
        assert version(get()) == 1
        path.write_text(DOCUMENT + "# a word more\n", encoding="utf-8")
        wait_until(lambda: status(get_status()).refused == {"document_version": 1})
        path.write_text(second, encoding="utf-8")
        assert version(get()) == 2
        path.unlink()
        wait_until(lambda: "document_unreadable" in status(get_status()).refused)
        last = status(get_status())
    assert last.refused == {"document_version": 1, "document_unreadable": 1}
    assert last.counters["documents_published"] == 3
    assert (last.gauges["scenarios"], last.gauges["documents_behind"]) == (2, 1)


def test_the_log_shows_where_a_document_is_wrong_that_it_is_mended_and_who_takes_part(
    session: zenoh.Session, viewer: zenoh.Session, tmp_path: Path
) -> None:
    path = tmp_path / "planned.yaml"
    path.write_text(PLANNED.text, encoding="utf-8")
    service = SideInfoService(session, [PLANNED], {"svea1": "planned"}, "a", files={"planned": path})
    with (
        capture_logs() as logs,
        listening(viewer, keys.service_status("side-info", "a")) as get_status,
        running(service),
    ):
        path.write_text(PLANNED.text.replace("](P) and", "](Q) and"), encoding="utf-8")
        wait_until(lambda: status(get_status()).refused == {"document_invalid": 1})
        path.write_text(PLANNED.text, encoding="utf-8")
        wait_until(lambda: status(get_status()).gauges["documents_behind"] == 0)
    taking_part, refused, again = logs
    assert taking_part == {
        "event": "takes part", "log_level": "info", "vehicle": "svea1", "scenario": "planned",
        "time_zero": "2026-05-01T12:00:00.000Z",
    }  # fmt: skip
    first, shown, caret, stays = refused["event"].splitlines()
    assert first.startswith(f"document refused: {path}:10:21: 'Q' is not declared")
    assert shown[caret.index("^")] == "Q"
    assert stays == "version 1 stays published"
    assert (again["event"], again["log_level"]) == ("document as published again", "info")


def test_a_new_time_zero_moves_the_assignments(
    session: zenoh.Session, agent: zenoh.Session, viewer: zenoh.Session, tmp_path: Path
) -> None:
    path = tmp_path / "lot.yaml"
    path.write_text(DOCUMENT, encoding="utf-8")
    arrived: list[tuple[str, int, bool]] = []

    def keep(received: Received) -> None:
        if received.key.endswith("document"):
            arrived.append(("document", version(received), True))
        else:
            found = Assignment.decode(received.payload, received.encoding)
            arrived.append((found.vehicle, found.time_zero, found.active))

    def write(version: int, zero: str) -> None:
        text = DOCUMENT.replace("version: 1", f"version: {version}").replace("on_start", zero)
        path.write_text(text, encoding="utf-8")

    service = SideInfoService(session, [LOT], {"*": "lot", "svea2": "lot"}, "a", files={"lot": path})
    with (
        publisher(agent, "svea1") as states,
        declare_recovering_subscriber(viewer, "spec/**", keep, history=10, late_publishers=True),
        running(service),
    ):
        put(states, (1000, NEW))
        wait_until(lambda: len(arrived) == 2)
        assert sorted(arrived) == [("document", 1, True), ("svea1", 1000, True)]
        arrived.clear()
        write(2, '"2026-05-01T12:00:00Z"')
        wait_until(lambda: len(arrived) == 4)
        # svea1 is out of the scenario before the new document comes, and in it again afterwards.
        assert arrived[:2] == [("svea1", 1000, False), ("document", 2, True)]
        assert sorted(arrived[2:]) == [("svea1", PLANNED_ZERO, True), ("svea2", PLANNED_ZERO, True)]
        arrived.clear()
        write(3, "on_start")
        wait_until(lambda: len(arrived) == 4)
        # Of svea2 no start was seen.
        assert sorted(arrived[:2]) == [("svea1", PLANNED_ZERO, False), ("svea2", PLANNED_ZERO, False)]
        assert arrived[2:] == [("document", 3, True), ("svea1", 1000, True)]


def test_who_comes_late_gets_the_newest_by_subscribing_and_by_a_plain_query(
    session: zenoh.Session, agent: zenoh.Session, viewer: zenoh.Session, tmp_path: Path
) -> None:
    path = tmp_path / "lot.yaml"
    path.write_text(DOCUMENT, encoding="utf-8")
    service = SideInfoService(session, [LOT, PLANNED], {"svea1": "planned"}, "a", files={"lot": path})
    with listening(viewer, keys.document("lot")) as get, running(service):
        assert version(get()) == 1
        path.write_text(DOCUMENT.replace("version: 1", "version: 2"), encoding="utf-8")
        assert version(get()) == 2
        with listening(viewer, "spec/**") as get_late:
            late = {received.key: received.payload for received in (get_late(), get_late(), get_late())}
        for selector, found in (
            ("spec/lot/document", {keys.document("lot")}),
            ("spec/*/document", {keys.document("lot"), keys.document("planned")}),
            ("spec/**", {keys.document("lot"), keys.document("planned"), keys.assignment("planned", "svea1")}),
            ("spec/nowhere/document", set()),
        ):
            replies = [reply.ok for reply in agent.get(selector, timeout=DEADLINE)]
            answers = {str(ok.key_expr): ok.payload.to_bytes() for ok in replies if ok is not None}
            assert answers == {key: late[key] for key in found}
            assert len(replies) == len(found)
        (reply,) = [reply.ok for reply in agent.get("spec/lot/document", timeout=DEADLINE)]
    assert reply is not None
    assert ScenarioDocument.decode(reply.payload.to_bytes(), str(reply.encoding)).version == 2


@pytest.mark.parametrize(
    ("assign", "words"),
    [
        ({"svea1": "nowhere"}, "svea1 is assigned to scenario 'nowhere': loaded are lot, planned"),
        ({"*": ""}, "scenario ''"),
    ],
)
def test_an_assignment_to_what_is_not_loaded_is_refused(
    session: zenoh.Session, assign: dict[str, str], words: str
) -> None:
    with pytest.raises(ScenarioError, match=words):
        SideInfoService(session, [LOT, PLANNED], assign, "a")


def test_other_refusals(session: zenoh.Session) -> None:
    with pytest.raises(ScenarioError, match="two scenarios have one name: lot, lot"):
        SideInfoService(session, [LOT, LOT], {}, "a")
    with pytest.raises(ScenarioError, match=r"yard\.yaml: scenario 'yard' is not loaded: loaded are lot"):
        SideInfoService(session, [LOT], {}, "a", files={"yard": Path("yard.yaml")})
    for offset in (-1.0, 3600.1, 1e300, float("nan"), float("inf")):
        with pytest.raises(ScenarioError, match="the clock offset"):
            SideInfoService(session, [LOT], {}, "a", clock_offset=offset)
    with pytest.raises(KeyIdError, match="'a b'"):
        SideInfoService(session, [LOT], {"a b": "lot"}, "a")
    with pytest.raises(KeyIdError, match="service id"):
        SideInfoService(session, [LOT], {}, "a/b")
