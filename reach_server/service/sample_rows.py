"""From samples of one vehicle as they come from the bus to rows of its class: what fits its profile, and its plans."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fleet_bus.messages import StateBatch, StateFlag, VehicleProfile
from reach_server.data.input_sets import limits
from reach_server.data.window import SampleBatch
from reach_server.engine.engine import PlannedInputs
from reach_server.numeric.types import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """Inputs (steps, m) within a tolerance (m) that follow the sample ``key`` (epoch, seq)."""

    key: tuple[int, int]
    inputs: FloatArray
    tolerance: FloatArray


def rows_of(states: StateBatch, rows: NDArray[np.intp]) -> StateBatch:
    """Some rows (K,) of a batch."""

    def take(array: FloatArray | None) -> FloatArray | None:
        return None if array is None else array[rows]

    return StateBatch(
        states.index[rows], states.epoch[rows], states.seq[rows], states.t[rows], states.flags[rows],
        states.x[rows], states.u[rows], take(states.bound), take(states.plan), take(states.plan_tolerance),
    )  # fmt: skip


def samples_of(states: StateBatch, slot: int) -> SampleBatch:
    """The samples of one vehicle as rows of its class."""
    slots = np.full(len(states.t), slot, dtype=np.intp)
    return SampleBatch(slots, states.epoch, states.seq, states.t, states.flags, states.x, states.u)


def contradiction(profile: VehicleProfile, states: StateBatch) -> str | None:
    """What about some samples of equal layout contradicts the profile, or None."""
    n, m = len(profile.state), len(profile.inputs)
    if states.x.shape[1] != n or states.u.shape[1] != m:
        return f"{states.x.shape[1]} states and {states.u.shape[1]} inputs came, the profile has {n} and {m}"
    if states.bound is not None and profile.noise.measurement is not None:
        stated = np.abs(profile.noise.measurement.matrix()).sum(axis=1)
        if (states.bound > stated * (1 + 1e-9)).any():
            came = states.bound.max(axis=0).tolist()
            return f"a state error of up to {came} came, the profile bounds it by {stated.tolist()}"
    return None


def input_beyond_limits(profile: VehicleProfile, states: StateBatch) -> str | None:
    """Name of an input that leaves the limits of the profile, or None."""
    low, high = limits(profile)
    known = (states.flags & int(StateFlag.INPUT_MISSING) == 0)[:, None]
    beyond = ((states.u < low - 1e-9) | (states.u > high + 1e-9)) & known
    return profile.input_names[int(np.argmax(beyond.any(axis=0)))] if beyond.any() else None


def newest_plan(states: StateBatch) -> Plan | None:
    """The plan of the newest of some samples, if they carry any."""
    if states.plan is None:
        return None
    newest = int(np.lexsort((states.seq, states.epoch))[-1])
    tolerance = np.zeros(states.u.shape[1]) if states.plan_tolerance is None else states.plan_tolerance[newest]
    return Plan((int(states.epoch[newest]), int(states.seq[newest])), states.plan[newest], tolerance)


def by_plan(
    slots: NDArray[np.intp], newest: list[tuple[int, int]], plans: list[Plan | None], needed: int
) -> list[tuple[NDArray[np.intp], PlannedInputs | None]]:
    """Slots (B,) with a plan of at least ``needed`` steps that came with their ``newest`` sample, with it; and the
    others. The plan of an older sample does not say what follows the newest one."""
    usable = [
        plan if plan is not None and plan.key == key and len(plan.inputs) >= needed else None
        for key, plan in zip(newest, plans, strict=True)
    ]
    has = np.array([plan is not None for plan in usable], dtype=bool)
    groups: list[tuple[NDArray[np.intp], PlannedInputs | None]] = []
    if has.any():
        chosen = [plan for plan in usable if plan is not None]
        known = PlannedInputs(np.stack([p.inputs[:needed] for p in chosen]), np.stack([p.tolerance for p in chosen]))
        groups.append((slots[has], known))
    if not has.all():
        groups.append((slots[~has], None))
    return groups
