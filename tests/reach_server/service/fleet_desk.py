"""A fleet, its counters, and samples, documents and assignments as they come from the bus."""

import numpy as np

from fleet_bus.messages import Assignment, EventKind, ScenarioDocument, StateBatch, StateFlag
from fleet_bus.rejections import Rejections
from reach_server.data.events import EngineEvent
from reach_server.engine.results import Tubes
from reach_server.numeric.types import FloatArray
from reach_server.service.fleet import Fleet, Outcome
from reach_server.service.ingest import VehicleBatch
from tests.reach_server.drives import PROFILE, START, SVEA, history

SMALL = PROFILE.model_copy(update={"window": 120})
NOW = 200


class Desk:
    """A fleet, its counters, and samples of drives as they come from the bus."""

    def __init__(self) -> None:
        self.rejections = Rejections()
        self.fleet = Fleet(self.rejections)

    @property
    def refused(self) -> dict[str, int]:
        return self.rejections.snapshot()

    def states(
        self,
        vehicle: str,
        start: int,
        stop: int,
        *,
        planned: bool = False,
        dt_ns: int = SVEA.dt_ns,
        flags: StateFlag = StateFlag.NONE,
        x: FloatArray | None = None,
        u: FloatArray | None = None,
        bound: FloatArray | None = None,
        epoch: int = 1,
        session: str = "",
        late: float | None = None,
    ) -> VehicleBatch:
        """Samples ``start`` to ``stop`` of the drive; ``late``: how long (s) after its stamp each one came."""
        k, drive = np.arange(start, stop), history(0)
        plan = np.stack([drive.inputs[i + 1 : i + 10] for i in k]) if planned else None
        states = StateBatch(
            k,
            np.full(len(k), epoch, dtype=np.uint64),
            k.astype(np.uint64),
            START + k * dt_ns,
            np.full(len(k), int(flags), dtype=np.uint32),
            drive.measured[k] if x is None else x,
            drive.inputs[k] if u is None else u,
            bound,
            plan,
            None if plan is None else np.zeros((len(k), 2)),
        )
        arrived = None if late is None else states.t + int(late * 1e9)
        return VehicleBatch((vehicle,) * len(k), states, (session,) * len(k), arrived)

    def process(self, *batches: VehicleBatch, now: float | None = None) -> Outcome:
        return self.fleet.process(list(batches), now)

    def tubes(self, *batches: VehicleBatch) -> dict[str, Tubes]:
        return {v: tubes for _, tubes in self.process(*batches).tubes for v in tubes.vehicles}


def kinds(events: list[EngineEvent]) -> list[EventKind]:
    return [event.kind for event in events]


def document(half: float, *, name: str = "box", version: int = 1) -> ScenarioDocument:
    here = history(0).truth[NOW, :2]
    low, high = here - half, here + half
    text = (
        f"scenario: {name}\nversion: {version}\nstate: {{x1: m, x2: m}}\ntime: {{zero: on_start, semantics: sampled}}\n"
        f"regions: {{P: {{box: {{x1: [{low[0]}, {high[0]}], x2: [{low[1]}, {high[1]}]}}}}}}\n"
        "assume: always[0:100 s](P)\n"
    )
    return ScenarioDocument(scenario=name, version=version, text=text)


def assignment(active: bool = True) -> Assignment:
    return Assignment(scenario="box", vehicle="a", time_zero=START + NOW * SVEA.dt_ns, active=active)
