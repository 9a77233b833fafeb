"""A drive that is known as a whole, held against a scenario."""

import numpy as np

from fleet_bus.errors import UsageError
from fleet_bus.messages import VehicleProfile
from reach_server.data.window import Block
from reach_server.numeric.types import FloatArray, IntArray
from reach_server.side_information.scenarios import Assignments
from side_info import Scenario


def first_contradiction(
    scenario: Scenario, profile: VehicleProfile, t: IntArray, x: FloatArray, time_zero: int | None = None
) -> float | None:
    """Seconds after time zero at which a drive left its scenario no way to be true, or None if it never did.

    Exact for the samples given: states are taken as true ones, and what happened between samples is not known.

    Args:
        scenario: what the drive should obey.
        profile: its class, which says how often it is sampled.
        t: stamps (T,) in ns since the Unix epoch, oldest first; those before time zero do not count.
        x: states (T, n) in the units of the profile.
        time_zero: in ns since the Unix epoch; by default the scenario's own, or the first stamp.

    Raises ``UsageError`` for arrays of other shapes, numbers that are not finite and stamps that go backwards,
    ``ScenarioError`` if the states of the scenario do not fit those of the profile.
    """
    n = len(profile.state)
    t, x = np.asarray(t, dtype=np.int64), np.asarray(x, dtype=float)
    if t.ndim != 1 or x.shape != (len(t), n):
        raise UsageError(f"stamps {t.shape} and states {x.shape} are no drive: expected (T,) and (T, {n})")
    if not np.isfinite(x).all():
        raise UsageError("a state of the drive is not finite")
    if (np.diff(t) < 0).any():
        raise UsageError("a stamp of the drive lies before the one ahead of it: give samples oldest first")
    exact = np.zeros((n, 0))
    assignments = Assignments(profile, exact, exact)
    if time_zero is None:
        time_zero = scenario.time_zero
    zero = int(t.min(initial=np.iinfo(np.int64).max)) if time_zero is None else time_zero
    assignments.assign(0, scenario, zero, 0.0)
    kept = t >= zero
    if not kept.any():
        return None
    t, x = t[None, kept], x[None, kept]
    yes = np.ones(t.shape, dtype=bool)
    drive = Block(t, x, np.zeros((*t.shape, 0)), yes, yes, yes)
    events = assignments.receive(np.array([0]), ["drive"], t[:, -1], lambda slots, length: drive)
    return float(events[0].details["elapsed"]) if events else None
