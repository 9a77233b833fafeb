"""The agent: what it publishes, what it skips, and how the loop keeps time."""

import itertools
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
import zenoh

from fleet_bus import keys
from fleet_bus.errors import KeyIdError, ProfileError, UsageError
from fleet_bus.messages import StateFlag, StateSample, VehicleProfile, parse_profile
from fleet_bus.pubsub import Received, query_cache, subscribe, watch_alive
from fleet_bus.router import Router
from fleet_bus.sessions import Role, open_session
from tests.memory_bus import Network
from tests.waiting import DEADLINE, wait_until
from vehicle_agent import svea
from vehicle_agent.agent import Agent, Report, run
from vehicle_agent.filters import PassThrough, filter_for
from vehicle_agent.route import load_route
from vehicle_agent.sources import Reading, SimulatedSource

PROFILE = parse_profile(
    {"class": "cart", "state": {"x": "m"}, "inputs": {"u": "m/s"}, "sample_time": 0.1, "window": 8,
     "future_inputs": "plan"}
)  # fmt: skip


def published(bus: Network, key: str = "fleet/car/state") -> list[StateSample]:
    """What was put on a key."""
    return [StateSample.decode(message.payload) for message in bus.puts if message.key == key]


def caches(bus: Network) -> dict[str, int | None]:
    """How many messages the publishers keep, by key."""
    return {publisher.key: publisher.cache.maxlen for publisher in bus.publishers}


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
def bus() -> Network:
    return Network()


def make(bus: Network, source: Any, vehicle: str = "car", profile: VehicleProfile = PROFILE, **options: Any) -> Agent:
    return Agent(bus.bus(), vehicle, profile, source, options.get("filter", PassThrough()), bus.time)


def go(bus: Network, *agents: Agent, speed: float = 1.0) -> dict[str, Report]:
    """Run agents to the end of their sources, in no time."""
    return run(agents, threading.Event(), speed, bus.time)


def test_profile_history_token_then_live(bus: Network) -> None:
    truth = np.array([7.0])
    past = [reading(-200, flags=StateFlag.HISTORY | StateFlag.NEW_TRAJECTORY, due=0.0, truth=truth),
            reading(-100, flags=StateFlag.HISTORY, due=0.0, truth=truth)]  # fmt: skip
    live = [reading(0, 1.0, flags=StateFlag.NEW_TRAJECTORY, truth=truth), reading(100, 2.0, truth=truth)]
    source = ListSource([*past, *live], history=2, knows_truth=True)
    with make(bus, source) as agent:
        reports = go(bus, agent)
    assert [key.rpartition("/")[2] for key in bus.log] == [
        "profile", "state", "state", "alive", "state", "truth", "state", "truth",
    ]  # fmt: skip
    assert VehicleProfile.decode(bus.puts[0].payload) == PROFILE
    samples = published(bus)
    assert [s.seq for s in samples] == [0, 1, 2, 3]
    assert len({s.epoch for s in samples}) == 1
    assert samples[0].epoch == 10**18
    assert samples[1].t - samples[0].t == samples[3].t - samples[2].t == 100
    assert samples[1].t < samples[2].t
    assert samples[0].flags == StateFlag.HISTORY | StateFlag.NEW_TRAJECTORY
    assert samples[2].flags == StateFlag.NEW_TRAJECTORY
    truths = published(bus, "fleet/car/truth")
    assert [(s.seq, s.t, s.x[0]) for s in truths] == [(s.seq, s.t, 7.0) for s in samples[2:]]
    assert reports["car"].published == 4
    assert not reports["car"].skipped
    assert sorted(bus.closed) == sorted(bus.declared)


def test_the_cache_holds_window_lags_and_history(bus: Network) -> None:
    profile = svea.profile()
    source = SimulatedSource(load_route("roundabout"), 1, history=100)
    with make(bus, source, profile=profile):
        assert caches(bus) == {"fleet/car/profile": 1, "fleet/car/state": 1066, "fleet/car/truth": 64}
    longer = ListSource([], history=5000)
    with make(bus, longer, "cart"):
        assert (caches(bus)["fleet/cart/state"] or 0) >= 5000
        assert "fleet/cart/truth" not in caches(bus)


def test_what_cannot_be_published_is_counted(bus: Network) -> None:
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
    with make(bus, source, filter=BrittleFilter()) as agent:
        report = go(bus, agent)["car"]
    samples = published(bus)
    assert [s.x[0] for s in samples] == [3.0, 6.0]
    assert [s.seq for s in samples] == [0, 1]
    # The mark of the skipped first reading went to the next one.
    assert [s.flags for s in samples] == [StateFlag.NEW_TRAJECTORY, StateFlag.NONE]
    assert report.published == 2
    assert report.skipped == {"not_finite": 4, "stamp": 2, "shape": 2, "filter": 1, "source": 1}


def test_what_a_server_would_refuse_is_not_sent(bus: Network) -> None:
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
    with make(bus, source) as agent:
        report = go(bus, agent)["car"]
    assert [s.x[0] for s in published(bus)] == [1.0, 8.0]
    assert [s.seq for s in published(bus)] == [0, 1]
    assert (report.published, report.skipped) == (2, {"range": 6, "too_large": 1})


def test_a_network_in_trouble_does_not_stop_the_loop(bus: Network) -> None:
    source = ListSource([reading(k, float(k)) for k in range(5)])
    with make(bus, source) as agent:
        agent.start(bus.time.time_ns())
        bus.broken = zenoh.ZError("closed")
        report = run_live(bus, agent)
        assert (report.published, report.skipped) == (0, {"put": 5})


def run_live(bus: Network, agent: Agent) -> Any:
    while agent.upcoming is not None:
        agent.publish(bus.time.time_ns())
    return agent.report


def test_one_failing_source_does_not_stop_the_others(bus: Network) -> None:
    good = make(bus, ListSource([reading(k * 1000, float(k)) for k in range(5)]), "good")
    bad = make(bus, ListSource([reading(0), RuntimeError("broken")]), "bad")
    with good, bad:
        reports = go(bus, bad, good)
    assert reports["good"].published == 5
    assert (reports["bad"].published, reports["bad"].skipped) == (1, {"source": 1})


def test_agents_are_served_in_the_order_of_due_times(bus: Network) -> None:
    first = make(bus, ListSource([reading(t) for t in (0, 3_000_000, 4_000_000)]), "a")
    second = make(bus, ListSource([reading(t) for t in (1_000_000, 2_000_000, 5_000_000)]), "b")
    with first, second:
        go(bus, first, second)
    order = [keys.vehicle_of(key) for key in bus.log if key.endswith("state")]
    assert order == ["a", "b", "b", "a", "a", "b"]


@pytest.mark.parametrize("speed", [1.0, 4.0])
def test_readings_go_out_when_they_are_due(bus: Network, speed: float) -> None:
    times: list[float] = []
    bus.on_put = lambda: times.append(bus.time.now)
    with make(bus, ListSource([reading(k * 40_000_000) for k in range(6)])) as agent:
        go(bus, agent, speed=speed)
    # The profile goes out first, with the start.
    np.testing.assert_allclose(times, [0.0, *(0.04 / speed * np.arange(6))], atol=1e-9)


def test_a_loop_that_has_fallen_behind_publishes_what_is_due_without_waiting(bus: Network) -> None:
    times: list[float] = []

    def put() -> None:
        # The second reading takes as long as three.
        bus.time.now += 0.12 if len(times) == 2 else 0.0
        times.append(bus.time.now)

    bus.on_put = put
    with make(bus, ListSource([reading(k * 40_000_000) for k in range(6)])) as agent:
        go(bus, agent)
    np.testing.assert_allclose(times, [0.0, 0.0, 0.16, 0.16, 0.16, 0.16, 0.2], atol=1e-9)


def test_stop_ends_a_wait(bus: Network) -> None:
    stop = threading.Event()
    with make(bus, ListSource([reading(0), reading(3_600_000_000_000)])) as agent:
        loop = threading.Thread(target=run, args=([agent], stop))
        loop.start()
        wait_until(lambda: agent.report.published == 1)
        stop.set()
        loop.join(DEADLINE)
        assert not loop.is_alive()
    assert len(published(bus)) == 1


def test_a_stop_before_the_start_publishes_nothing(bus: Network) -> None:
    stop = threading.Event()
    stop.set()
    with make(bus, ListSource([reading(0)])) as agent:
        assert run([agent], stop)["car"].published == 0
    assert not bus.puts


def test_source_and_profile_must_fit(bus: Network) -> None:
    with pytest.raises(ProfileError, match=r"gives the states \['y'\]"):
        make(bus, ListSource([], state_names=("y",)))
    with pytest.raises(ProfileError, match=r"gives the inputs \[\]"):
        make(bus, ListSource([], input_names=()))
    with pytest.raises(ProfileError, match=r"samples every 0\.2 s"):
        make(bus, ListSource([], sample_time=0.2))
    with pytest.raises(KeyIdError):
        make(bus, ListSource([]), "no such/vehicle")
    assert not bus.declared


def test_misuse_of_run(bus: Network) -> None:
    with make(bus, ListSource([])) as one, make(bus, ListSource([])) as other:
        with pytest.raises(UsageError, match="may occur once"):
            go(bus, one, other)
        with pytest.raises(UsageError, match="must be positive"):
            run([one], threading.Event(), 0.0)
    assert run([], threading.Event()) == {}


def test_what_is_published_of_a_simulated_car_is_within_its_profile(bus: Network) -> None:
    profile = svea.profile()
    source = SimulatedSource(load_route("roundabout"), 2, history=64)
    with make(bus, source, profile=profile, filter=filter_for(profile)) as agent:
        origin = bus.time.time_ns()
        agent.start(origin)
        for _ in range(300):
            agent.publish(origin)
    samples, truths = published(bus)[64:], published(bus, "fleet/car/truth")
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
