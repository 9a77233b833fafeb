"""A vehicle whose scenarios are watched as it drives, for tests of what they come to."""

from collections.abc import Sequence

import numpy as np

from fleet_bus.messages import VehicleProfile
from reach_server.data.events import EngineEvent
from reach_server.data.window import Block
from reach_server.numeric.types import FloatArray, IntArray
from reach_server.side_information.scenarios import Assignments
from side_info import Scenario
from tests.reach_server.scenarios import PROFILE, scenario

S = 10**9
START = 10**18
#: The class samples every 0.1 s.
STEP = PROFILE.sample_time_ns
NOISE = 0.01 * np.eye(3)
INSIDE, OUTSIDE = [0.0, 0.0, 0.0], [0.0, 9.0, 0.0]


def box(name: str = "box", window: str = "1:3 s") -> Scenario:
    return scenario(f"always[{window}](P)", "{P: {box: {x1: [-1, 2]}}}", name)


class Watched:
    """Vehicles whose samples are handed to the assignments of a class."""

    def __init__(
        self, vehicles: int = 1, received: FloatArray | None = NOISE, profile: VehicleProfile = PROFILE
    ) -> None:
        self.made = Assignments(profile, np.zeros((3, 0)), received)
        self.names = [f"car-{slot}" for slot in range(vehicles)]
        self.samples: list[list[tuple[int, list[float]]]] = [[] for _ in range(vehicles)]

    def block(self, slots: "np.ndarray[tuple[int], np.dtype[np.intp]]", length: int) -> Block:
        """The newest samples of vehicles, 200 at most."""
        size = min(length, 200)
        t, x = np.zeros((len(slots), size), dtype=np.int64), np.zeros((len(slots), size, 3))
        valid = np.zeros((len(slots), size), dtype=bool)
        for row, slot in enumerate(slots.tolist()):
            for place, (stamp, state) in enumerate(reversed(self.samples[slot][-size:]), 1):
                t[row, -place], x[row, -place], valid[row, -place] = stamp, state, True
        return Block(t, x, np.zeros((len(slots), size, 0)), valid, valid, valid)

    def sample(self, slot: int, seconds: float, x: Sequence[float] = INSIDE) -> None:
        """A sample comes, and nobody looks yet."""
        self.samples[slot].append((START + round(seconds * S), list(x)))

    def look(self, *slots: int) -> list[EngineEvent]:
        """What the samples since the last look contradict."""
        chosen = np.array(slots, dtype=np.intp)
        newest: IntArray = np.array([self.samples[slot][-1][0] for slot in slots], dtype=np.int64)
        return self.made.receive(chosen, self.names, newest, self.block)

    def see(self, slot: int, seconds: float, x: Sequence[float] = INSIDE) -> list[EngineEvent]:
        """A sample comes and is looked at."""
        self.sample(slot, seconds, x)
        return self.look(slot)

    def asked(self, slot: int, steps: int = 0) -> list[set[str]]:
        """Names that each obligation of a vehicle asks for, in every alternative, ``steps`` after its newest sample."""
        _, obligations, _ = self.made.obligations(np.array([slot]))
        found = []
        for obligation in obligations.tolist():
            ahead = {obligation}
            for _ in range(steps):
                ahead = {a.next for o in ahead for a in self.made.table.alternatives(o)}
            literals = [a.literals for o in ahead for a in self.made.table.alternatives(o)]
            found.append({self.made.literals.name(i) for i in frozenset.intersection(*literals)})
        return found
