"""A fleet that is driven on a bus in memory, and recorded as a recorder would: all that was put, in order."""

import threading
from collections.abc import Callable, Mapping

from fleet_bus import keys
from fleet_bus.bus import Publisher
from fleet_bus.messages import Assignment, ScenarioDocument, StateSample, VehicleProfile
from fleet_bus.messages.state import ENCODING
from fleet_bus.pubsub import Received
from reach_server.service.server import ReachServer
from tests.memory_bus import MemoryHandle, Network, Time
from tests.reach_server.drives import PROFILE, START, SVEA, history
from tests.reach_server.service.fleet_desk import SMALL

#: A second of samples, about; and those that are there when a drive begins.
SECOND = round(1 / SVEA.dt)
BEFORE = 130

#: A profile of each kind of method, with windows as short as the method allows.
PROFILES: Mapping[str, VehicleProfile] = {
    "set_membership": SMALL,
    "hull": PROFILE.model_copy(update={"window": 100, "method": "residual_hull"}),
    "lti": PROFILE.model_copy(update={"window": 110, "method": "lti", "frame": "world", "lipschitz": None}),
}


class Car:
    """An agent that publishes the samples of a drive."""

    def __init__(
        self, network: Network, vehicle: str, profile: VehicleProfile, *, seed: int = 0, late_profile: bool = False
    ) -> None:
        bus = network.bus()
        self.vehicle = vehicle
        self.token = bus.alive(keys.alive(vehicle))
        self.profiles: Publisher = bus.publisher(keys.profile(vehicle), VehicleProfile.encoding(), cache=1)
        self.states: Publisher = bus.publisher(keys.state(vehicle), ENCODING, cache=1000)
        self._history = history(seed)
        self._next = 0
        if not late_profile:
            self.profiles.put(profile.encode())

    def drive(self, samples: int) -> None:
        for k in range(self._next, self._next + samples):
            x, u, plan = (a[k] for a in (self._history.measured, self._history.inputs, self._history.inputs))
            follows = self._history.inputs[k + 1 : k + 10]
            tolerance = 0.0 * plan
            sample = StateSample(1, k, START + k * SVEA.dt_ns, x, u, plan=follows, plan_tolerance=tolerance)
            self.states.put(sample.encode())
        self._next += samples


class SideInfo:
    """A service that publishes scenarios and who takes part."""

    def __init__(self, network: Network) -> None:
        self._bus = network.bus()
        self._publishers: dict[str, Publisher] = {}

    def _put(self, key: str, payload: bytes, encoding: str) -> None:
        if key not in self._publishers:
            self._publishers[key] = self._bus.publisher(key, encoding, cache=1)
        self._publishers[key].put(payload)

    def publish(self, scenario: ScenarioDocument) -> None:
        self._put(keys.document(scenario.scenario), scenario.encode(), ScenarioDocument.encoding())

    def assign(self, scenario: str, vehicle: str, at: int, *, active: bool = True) -> None:
        message = Assignment(scenario=scenario, vehicle=vehicle, time_zero=START + at * SVEA.dt_ns, active=active)
        self._put(keys.assignment(scenario, vehicle), message.encode(), Assignment.encoding())


def region(name: str, half: float, *, version: int = 1, at: int = BEFORE) -> ScenarioDocument:
    """A scenario: a car stays within a square around where it is at a sample, or beside it, and comes to rest."""
    here = history(0).truth[at, :2]
    low, high = here - half, here + half
    text = (
        f"scenario: {name}\nversion: {version}\nstate: {{x1: m, x2: m, v: m/s}}\n"
        "time: {zero: on_start, semantics: sampled}\n"
        "regions:\n"
        f"  P: {{box: {{x1: [{low[0]}, {high[0]}], x2: [{low[1]}, {high[1]}]}}}}\n"
        f"  O: {{box: {{x1: [{high[0]}, {high[0] + 9}], x2: [{low[1]}, {high[1]}]}}}}\n"
        "assume: always[0:6 s](P or O) and always[0:0.2 s](x1**2 + 0.5 * sin(x2) >= -1e3)\n"
        "monitor: {rests: 'eventually[0:2 s](v <= 0.01)'}\n"
    )
    return ScenarioDocument(scenario=name, version=version, text=text)


class World:
    """Cars, a side-info service and a server on one network; ``messages`` has all that was put."""

    def __init__(self) -> None:
        self.network = Network(Time(0.0, START))
        self.side_info = SideInfo(self.network)
        self.cars: list[Car] = []
        self.done = 0

    @property
    def messages(self) -> list[Received]:
        return list(self.network.puts)

    def add(self, vehicle: str, profile: VehicleProfile, **options: int) -> Car:
        car = Car(self.network, vehicle, profile, seed=options.get("seed", 0), late_profile=bool(options.get("late")))
        self.cars.append(car)
        return car

    def record(self, name: str = "one") -> MemoryHandle:
        """A recorder comes; what is given back goes with it."""
        return self.network.bus().alive(keys.service("recorder", name))

    def before(self, samples: int = BEFORE) -> None:
        """All cars drive, and time passes, before there is a server."""
        for car in self.cars:
            car.drive(samples)
        self.network.time.now += samples * SVEA.dt
        self.done += samples

    def serve(
        self, seconds: float, each_sample: Mapping[int, Callable[[], object]] | None = None, instance: str = "one"
    ) -> ReachServer:
        """A server that runs for so long while all cars drive; what is to happen at a sample is done before it."""
        stop, began, first = threading.Event(), self.network.time.now, self.done

        def waited(now: float) -> None:
            while (self.done - first) * SVEA.dt <= now - began:
                (each_sample or {}).get(self.done - first, bool)()
                for car in self.cars:
                    car.drive(1)
                self.done += 1
            if now - began >= seconds:
                stop.set()

        self.network.time.on_wait = waited
        with ReachServer(instance, clock=self.network.time, connect=self.network.bus) as server:
            server.run(stop)
        return server


def a_drive(seconds: float = 1.5) -> World:
    """Three cars of different classes, one of whose profiles comes late, and two scenarios; one car changes its
    profile, a scenario its version, and the server starts anew in the middle."""
    world = World()
    first = world.add("a", PROFILES["set_membership"])
    world.add("b", PROFILES["hull"], seed=1)
    late = world.add("c", PROFILES["lti"], seed=2, late=1)
    world.before()
    world.record()
    info = world.side_info
    info.publish(region("near", 1.0))
    info.publish(region("far", 30.0))
    for vehicle, scenario in (("a", "near"), ("a", "far"), ("b", "far"), ("c", "far")):
        info.assign(scenario, vehicle, BEFORE)
    world.serve(
        seconds,
        {
            5: lambda: late.profiles.put(PROFILES["lti"].encode()),
            10: lambda: first.profiles.put(SMALL.model_copy(update={"window": 110}).encode()),
            15: lambda: info.publish(region("far", 20.0, version=2)),
            20: lambda: info.assign("far", "b", BEFORE, active=False),
        },
    )
    world.serve(seconds)
    return world
