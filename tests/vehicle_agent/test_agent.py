"""The agent: what it publishes, what it skips, and how the loop keeps time."""

import itertools
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, cast

import numpy as np
import pytest
import zenoh

from fleet_bus import keys
from fleet_bus.errors import KeyIdError, ProfileError, UsageError
from fleet_bus.messages import StateFlag, StateSample, VehicleProfile, parse_profile
from fleet_bus.pubsub import Received, query_cache, subscribe, watch_alive
from fleet_bus.router import Router
from fleet_bus.sessions import Role, open_session
from tests.waiting import DEADLINE, wait_until
from vehicle_agent import agent as agent_module
from vehicle_agent import svea
from vehicle_agent.agent import Agent, run
from vehicle_agent.filters import PassThrough, filter_for
from vehicle_agent.route import load_route
from vehicle_agent.sources import Reading, SimulatedSource

PROFILE = parse_profile(
    {"class": "cart", "state": {"x": "m"}, "inputs": {"u": "m/s"}, "sample_time": 0.1, "window": 8,
     "future_inputs": "plan"}
)  # fmt: skip


@dataclass
class Bus:
    """Stands in for the network: keeps what is put and declared, in order."""

    puts: list[tuple[str, bytes]] = field(default_factory=list)
    caches: dict[str, int] = field(default_factory=dict)
    declared: list[str] = field(default_factory=list)
    closed: list[str] = field(default_factory=list)
    broken: bool = False
    on_put: Any = None

    def publisher(self, session: object, key: str, encoding: str, *, cache: int) -> "Handle":
        self.caches[key] = cache
        self.declared.append(key)
        return Handle(self, key)

    def alive(self, session: object, key: str) -> "Handle":
        self.declared.append(key)
        self.puts.append((key, b""))
        return Handle(self, key)

    def samples(self, key: str = "fleet/car/state") -> list[StateSample]:
        return [StateSample.decode(payload) for at, payload in self.puts if at == key]


@dataclass
class Handle:
    bus: Bus
    key: str

    def put(self, payload: bytes) -> None:
        if self.bus.broken:
            raise zenoh.ZError("closed")
        self.bus.puts.append((self.key, payload))
        if self.bus.on_put is not None:
            self.bus.on_put()

    def __enter__(self) -> "Handle":
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.bus.closed.append(self.key)


@dataclass
class ListSource:
    """Readings from a list; an exception in it is raised."""

    readings: list[Reading | Exception]
    state_names: tuple[str, ...] = ("x",)
    input_names: tuple[str, ...] = ("u",)
    sample_time: float | None = None
    history: int = 0
    knows_truth: bool = False

    def __iter__(self) -> Iterator[Reading]:
        for reading in self.readings:
            if isinstance(reading, Exception):
                raise reading
            yield reading


class Clock(threading.Event):
    """Stands in for the module ``time`` and the event that ends a run: waiting passes the time at once."""

    def __init__(self) -> None:
        super().__init__()
        self.now = 0.0

    def monotonic(self) -> float:
        return self.now

    def time_ns(self) -> int:
        return 10**18 + round(self.now * 1e9)

    def wait(self, timeout: float | None = None) -> bool:
        self.now += timeout or 0.0
        return self.is_set()


class BrittleFilter(PassThrough):
    """Fails at 1, gives NaN at 2."""

    def update(self, t: int, measured: np.ndarray[Any, np.dtype[np.float64]]) -> Any:
        if measured[0] == 1:
            raise np.linalg.LinAlgError("singular")
        return measured * (np.nan if measured[0] == 2 else 1)


def reading(t: int, x: float = 0.0, **changes: Any) -> Reading:
    fields: dict[str, Any] = {"t": t, "due": t / 1e9, "measured": np.array([x]), "u": np.array([0.5])}
    return Reading(**{**fields, **changes})


@pytest.fixture
def bus(monkeypatch: pytest.MonkeyPatch) -> Bus:
    stand_in = Bus()
    monkeypatch.setattr(agent_module, "declare_cached_publisher", stand_in.publisher)
    monkeypatch.setattr(agent_module, "declare_alive", stand_in.alive)
    return stand_in


SESSION = cast("zenoh.Session", None)


def make(source: Any, vehicle: str = "car", profile: VehicleProfile = PROFILE, **options: Any) -> Agent:
    return Agent(SESSION, vehicle, profile, source, options.get("filter", PassThrough()))


def test_profile_history_token_then_live(bus: Bus) -> None:
    truth = np.array([7.0])
    past = [reading(-200, flags=StateFlag.HISTORY | StateFlag.NEW_TRAJECTORY, due=0.0, truth=truth),
            reading(-100, flags=StateFlag.HISTORY, due=0.0, truth=truth)]  # fmt: skip
    live = [reading(0, 1.0, flags=StateFlag.NEW_TRAJECTORY, truth=truth), reading(100, 2.0, truth=truth)]
    source = ListSource([*past, *live], history=2, knows_truth=True)
    before = time.time_ns()
    with make(source) as agent:
        reports = run([agent], threading.Event())
    assert [key.rpartition("/")[2] for key, _ in bus.puts] == [
        "profile", "state", "state", "alive", "state", "truth", "state", "truth",
    ]  # fmt: skip
    assert VehicleProfile.decode(bus.puts[0][1]) == PROFILE
    samples = bus.samples()
    assert [s.seq for s in samples] == [0, 1, 2, 3]
    assert len({s.epoch for s in samples}) == 1
    assert samples[0].epoch >= before
    assert samples[1].t - samples[0].t == samples[3].t - samples[2].t == 100
    assert samples[1].t < samples[2].t
    assert samples[0].flags == StateFlag.HISTORY | StateFlag.NEW_TRAJECTORY
    assert samples[2].flags == StateFlag.NEW_TRAJECTORY
    truths = bus.samples("fleet/car/truth")
    assert [(s.seq, s.t, s.x[0]) for s in truths] == [(s.seq, s.t, 7.0) for s in samples[2:]]
    assert reports["car"].published == 4
    assert not reports["car"].skipped
    assert sorted(bus.closed) == sorted(bus.declared)


def test_the_cache_holds_window_lags_and_history(bus: Bus) -> None:
    profile = svea.profile()
    source = SimulatedSource(load_route("roundabout"), 1, history=100)
    with make(source, profile=profile):
        assert bus.caches == {"fleet/car/profile": 1, "fleet/car/state": 1066, "fleet/car/truth": 64}
    longer = ListSource([], history=5000)
    with make(longer, "cart"):
        assert bus.caches["fleet/cart/state"] >= 5000
        assert "fleet/cart/truth" not in bus.caches


def test_what_cannot_be_published_is_counted(bus: Bus) -> None:
    source = ListSource(
        [
            reading(0, flags=StateFlag.NEW_TRAJECTORY, measured=np.array([np.nan])),
            reading(10, 3.0),
            reading(10, 4.0),
            reading(5, 5.0),
            reading(20, u=np.array([np.inf])),
            reading(30, truth=np.array([np.nan])),
            reading(40, measured=np.zeros(2)),
            reading(50, u=np.zeros(0)),
            reading(60, 1.0),
            reading(70, 2.0),
            reading(80, 6.0),
            OSError("unplugged"),
            reading(90, 7.0),
        ]
    )
    with make(source, filter=BrittleFilter()) as agent:
        report = run([agent], threading.Event())["car"]
    samples = bus.samples()
    assert [s.x[0] for s in samples] == [3.0, 6.0]
    assert [s.seq for s in samples] == [0, 1]
    # The mark of the skipped first reading went to the next one.
    assert [s.flags for s in samples] == [StateFlag.NEW_TRAJECTORY, StateFlag.NONE]
    assert report.published == 2
    assert report.skipped == {"not_finite": 4, "stamp": 2, "shape": 2, "filter": 1, "source": 1}


def test_what_a_server_would_refuse_is_not_sent(bus: Bus) -> None:
    source = ListSource(
        [
            reading(0, 1.0),
            reading(10, 1e31),
            reading(20, 2.0, u=np.array([-1e31])),
            reading(30, 3.0, plan=np.array([[1e31]])),
            reading(40, 4.0, truth=np.array([1e31])),
            reading(50, 5.0, plan=np.zeros((600, 1))),
            reading(60, 6.0, plan=np.zeros((505, 1))),
            reading(2**63, 7.0, due=0.06),
            reading(70, 8.0),
        ],
        knows_truth=True,
    )
    with make(source) as agent:
        report = run([agent], threading.Event())["car"]
    assert [s.x[0] for s in bus.samples()] == [1.0, 8.0]
    assert [s.seq for s in bus.samples()] == [0, 1]
    assert (report.published, report.skipped) == (2, {"range": 6, "too_large": 1})


def test_a_network_in_trouble_does_not_stop_the_loop(bus: Bus) -> None:
    source = ListSource([reading(k, float(k)) for k in range(5)])
    with make(source) as agent:
        agent.start(time.time_ns())
        bus.broken = True
        report = run_live(agent)
        assert (report.published, report.skipped) == (0, {"put": 5})


def run_live(agent: Agent) -> Any:
    while agent.upcoming is not None:
        agent.publish(time.time_ns())
    return agent.report


def test_one_failing_source_does_not_stop_the_others(bus: Bus) -> None:
    good = make(ListSource([reading(k * 1000, float(k)) for k in range(5)]), "good")
    bad = make(ListSource([reading(0), RuntimeError("broken")]), "bad")
    with good, bad:
        reports = run([bad, good], threading.Event())
    assert reports["good"].published == 5
    assert (reports["bad"].published, reports["bad"].skipped) == (1, {"source": 1})


def test_agents_are_served_in_the_order_of_due_times(bus: Bus) -> None:
    first = make(ListSource([reading(t) for t in (0, 3_000_000, 4_000_000)]), "a")
    second = make(ListSource([reading(t) for t in (1_000_000, 2_000_000, 5_000_000)]), "b")
    with first, second:
        run([first, second], threading.Event())
    order = [keys.vehicle_of(key) for key, _ in bus.puts if key.endswith("state")]
    assert order == ["a", "b", "b", "a", "a", "b"]


@pytest.mark.parametrize("speed", [1.0, 4.0])
def test_readings_go_out_when_they_are_due(bus: Bus, speed: float, monkeypatch: pytest.MonkeyPatch) -> None:
    clock = Clock()
    monkeypatch.setattr(agent_module, "time", clock)
    times: list[float] = []
    bus.on_put = lambda: times.append(clock.now)
    with make(ListSource([reading(k * 40_000_000) for k in range(6)])) as agent:
        run([agent], clock, speed)
    # The profile goes out first, with the start.
    np.testing.assert_allclose(times, [0.0, *(0.04 / speed * np.arange(6))], atol=1e-9)


def test_a_loop_that_has_fallen_behind_publishes_what_is_due_without_waiting(
    bus: Bus, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = Clock()
    monkeypatch.setattr(agent_module, "time", clock)
    times: list[float] = []

    def put() -> None:
        # The second reading takes as long as three.
        clock.now += 0.12 if len(times) == 2 else 0.0
        times.append(clock.now)

    bus.on_put = put
    with make(ListSource([reading(k * 40_000_000) for k in range(6)])) as agent:
        run([agent], clock)
    np.testing.assert_allclose(times, [0.0, 0.0, 0.16, 0.16, 0.16, 0.16, 0.2], atol=1e-9)


def test_stop_ends_a_wait(bus: Bus) -> None:
    stop = threading.Event()
    with make(ListSource([reading(0), reading(3_600_000_000_000)])) as agent:
        loop = threading.Thread(target=run, args=([agent], stop))
        loop.start()
        wait_until(lambda: agent.report.published == 1)
        stop.set()
        loop.join(DEADLINE)
        assert not loop.is_alive()
    assert len(bus.samples()) == 1


def test_a_stop_before_the_start_publishes_nothing(bus: Bus) -> None:
    stop = threading.Event()
    stop.set()
    with make(ListSource([reading(0)])) as agent:
        assert run([agent], stop)["car"].published == 0
    assert not bus.puts


def test_source_and_profile_must_fit(bus: Bus) -> None:
    with pytest.raises(ProfileError, match=r"gives the states \['y'\]"):
        make(ListSource([], state_names=("y",)))
    with pytest.raises(ProfileError, match=r"gives the inputs \[\]"):
        make(ListSource([], input_names=()))
    with pytest.raises(ProfileError, match=r"samples every 0\.2 s"):
        make(ListSource([], sample_time=0.2))
    with pytest.raises(KeyIdError):
        make(ListSource([]), "no such/vehicle")
    assert not bus.declared


def test_misuse_of_run(bus: Bus) -> None:
    with make(ListSource([])) as one, make(ListSource([])) as other:
        with pytest.raises(UsageError, match="may occur once"):
            run([one, other], threading.Event())
        with pytest.raises(UsageError, match="must be positive"):
            run([one], threading.Event(), 0.0)
    assert run([], threading.Event()) == {}


def test_what_is_published_of_a_simulated_car_is_within_its_profile(bus: Bus) -> None:
    profile = svea.profile()
    source = SimulatedSource(load_route("roundabout"), 2, history=64)
    with make(source, profile=profile, filter=filter_for(profile)) as agent:
        origin = time.time_ns()
        agent.start(origin)
        for _ in range(300):
            agent.publish(origin)
    samples, truths = bus.samples()[64:], bus.samples("fleet/car/truth")
    assert [s.t for s in samples] == [origin + k * 50_000_000 for k in range(300)]
    error = np.array([s.x - true.x for s, true in zip(samples, truths, strict=True)])
    error[:, 2] = np.angle(np.exp(1j * error[:, 2]))
    assert profile.noise.measurement is not None
    assert (np.abs(error) <= np.array(profile.noise.measurement.box)).all()


def live(received: list[Received], vehicle: str) -> int:
    """How many samples of a vehicle have come that are no history."""
    samples = [StateSample.decode(r.payload, r.encoding) for r in list(received) if r.key == keys.state(vehicle)]
    return sum(StateFlag.HISTORY not in sample.flags for sample in samples)


@pytest.mark.integration
def test_over_a_router(request: pytest.FixtureRequest) -> None:
    profile = svea.profile()
    received: list[Received] = []
    tokens: list[tuple[str, bool]] = []
    stop = threading.Event()
    with (
        Router(["tcp/127.0.0.1:0"]) as router,
        open_session(Role.SERVICE, router.endpoints) as reader,
        subscribe(reader, keys.ALL_STATES, received.append),
        watch_alive(reader, keys.ALL_ALIVE, lambda key, alive: tokens.append((key, alive))),
        open_session(Role.AGENT, router.endpoints) as session,
    ):
        agents = [
            Agent(
                session,
                f"svea{i}",
                profile,
                SimulatedSource(load_route("roundabout"), i, 64),
                filter_for(profile),
            )
            for i in range(2)
        ]
        loop = threading.Thread(target=run, args=(agents, stop))
        loop.start()
        wait_until(lambda: len(tokens) == 2)
        # Tokens come after the histories, which may be all that there is yet.
        wait_until(lambda: all(live(received, vehicle) > 5 for vehicle in ("svea0", "svea1")))
        kept = query_cache(reader, keys.state("svea0"), max_samples=2000, timeout=DEADLINE)
        stop.set()
        loop.join(DEADLINE)
        for agent in agents:
            agent.close()
        wait_until(lambda: len(tokens) == 4)
    assert sorted(tokens) == [(keys.alive(f"svea{i}"), alive) for i in range(2) for alive in (False, True)]
    samples = sorted((StateSample.decode(r.payload, r.encoding) for r in kept), key=lambda s: s.seq)
    assert [s.seq for s in samples] == list(range(len(samples)))
    assert [StateFlag.HISTORY in s.flags for s in samples[:65]] == [True] * 64 + [False]
    assert all(b.t > a.t for a, b in itertools.pairwise(samples))
