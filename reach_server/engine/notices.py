"""What an operator is told about the samples and the record of a vehicle: events, in words."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fleet_bus.messages import Audit, EventKind
from reach_server.audit.coverage import FORGIVEN, CoverageRecord, Miss
from reach_server.audit.prediction_check import RECENT
from reach_server.data import ring_buffer as ring
from reach_server.data.events import EngineEvent
from reach_server.data.window import AppendReport, SampleBatch, Window


def jumps(
    batch: SampleBatch, appended: AppendReport, names: Sequence[str], record: CoverageRecord
) -> list[EngineEvent]:
    """Poses that jumped, each; the record is told of them, too."""
    events: list[EngineEvent] = []
    for row in appended.rows(ring.JUMPED) if appended.jumped else ():
        slot = int(batch.vehicle[row])
        message = f"the pose of {names[slot]} jumped: a new trajectory begins"
        if record.jumped(slot):
            message += (
                f"; it jumped more than {FORGIVEN} times within {RECENT} predictions: until it no longer does, its "
                "tubes are labelled contradicted"
            )
        events.append(EngineEvent(EventKind.JUMP, names[slot], int(batch.t[row]), message))
    return events


class Leaps:
    """What is told about samples that leap away from those before them: the first that is refused, and where a run of
    them is believed after all. Others are counted only, until a window has passed."""

    def __init__(self) -> None:
        #: By slot how many samples were held when one was last told of.
        self._told: dict[int, int] = {}

    def forget(self, slot: int) -> None:
        """Tell of the next one of a vehicle."""
        self._told.pop(slot, None)

    def of(self, batch: SampleBatch, appended: AppendReport, names: Sequence[str], window: Window) -> list[EngineEvent]:
        """The events of a batch."""
        events: list[EngineEvent] = []
        for row in _one_a_vehicle(batch, appended.rows(ring.LEAP)) if appended.leaped else ():
            slot = int(batch.vehicle[row])
            told, count = self._told.get(slot), int(window.count[slot])
            if told is None or not told <= count < told + window.size:
                self._told[slot] = count
                message = (
                    f"a sample of {names[slot]} leaps away from those before it and is refused: {_key(batch, row)}"
                )
                events.append(_leap(batch, row, names[slot], message, believed=False))
        for row in appended.rows(ring.RESYNCED) if appended.resynced else ():
            slot = int(batch.vehicle[row])
            self.forget(slot)
            message = f"refused samples of {names[slot]} agree with each other and are taken from here on: "
            events.append(_leap(batch, row, names[slot], message + _key(batch, row), believed=True))
        return events


def _one_a_vehicle(batch: SampleBatch, rows: list[int]) -> list[int]:
    _, first = np.unique(batch.vehicle[rows], return_index=True)
    return [rows[k] for k in first.tolist()]


def _key(batch: SampleBatch, row: int) -> str:
    return f"epoch {int(batch.epoch[row])}, number {int(batch.seq[row])}, stamp {int(batch.t[row])} ns"


def _leap(batch: SampleBatch, row: int, vehicle: str, message: str, *, believed: bool) -> EngineEvent:
    return EngineEvent(EventKind.LEAP, vehicle, int(batch.t[row]), message, {"believed": believed})


def miss(vehicle: str, found: Miss) -> EngineEvent:
    """A miss that refutes a stated bound."""
    message = (
        f"the measured state lay outside its predicted set by {found.excess:.3g}: a stated bound is wrong, widen it"
    )
    return EngineEvent(EventKind.MISS, vehicle, found.t, message, {"excess": found.excess})


def restored(vehicle: str, t: int) -> EngineEvent:
    """Refuted bounds have held since."""
    message = (
        f"the stated bounds of {vehicle} were refuted, but none of the data that did so is left, and the predictions "
        "since have held: its tubes have their label again"
    )
    return EngineEvent(EventKind.COVERAGE, vehicle, t, message)


def coverage(vehicle: str, t: int, what: str, audit: Audit, confidence: float) -> EngineEvent:
    """The rate of a vehicle has left its band, or is back: ``what``."""
    missed = audit.recent - audit.recent_inside
    message = (
        f"the rate of {vehicle} {what}: {missed} of the newest {audit.recent} predictions missed, up to "
        f"{audit.band} are explained by confidence {confidence:g}"
    )
    details = {"missed": missed, "checked": audit.recent, "band": audit.band}
    return EngineEvent(EventKind.COVERAGE, vehicle, t, message, details)


def newest_stamps(batch: SampleBatch, slots: NDArray[np.intp]) -> dict[int, int]:
    """The stamps of the last samples of a batch, of vehicles some of which are looked for."""
    return dict(zip(batch.vehicle.tolist(), batch.t.tolist(), strict=True)) if len(slots) else {}
