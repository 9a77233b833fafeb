"""Whether a pose follows from the one before it: jumps, and poses that repeat although the vehicle moves."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fleet_bus.messages import VehicleProfile
from reach_server.numeric.jit import kernel
from reach_server.numeric.types import BoolArray, FloatArray

#: A pose jumps where it changes by more than this times what rates and speed limits allow,
ALLOWED_CHANGE = 2.0
#: or, without those, by more than this times every change between linked samples in the window,
SEEN_CHANGE = 10.0
#: and by more than this times what its own speed says.
OWN_SPEED = 3.0
#: A vehicle moves where its speed says more than this share of the greatest change of position in the window.
MOVING = 0.05
#: Links in the window below which nothing is said about the changes of a vehicle.
LEAST_LINKS = 50

#: Bits of a sample's status (``ring_buffer``): its pose follows, repeats, jumps, or makes up for a repeated one.
FOLLOWS, FROZEN, JUMPED, AFTER_FROZEN = 0, 16, 32, 128


class ContinuityRules(NamedTuple):
    """Limits within which one sample follows another: sample ``interval`` within ``slack`` (ns), and changes of pose.

    ``angle`` (n,); ``pose`` (n,) are the states that may jump, ``top`` (n,) how much they may change per second (inf
    where nothing is stated), ``margin`` (n,) what two measurement errors explain. ``first`` and ``second`` are the
    positions, whose change is their distance, and ``speed`` the state that says how fast it grows; -1 where no role
    names them.
    """

    interval: int
    slack: float
    angle: BoolArray
    pose: BoolArray
    top: FloatArray
    margin: FloatArray
    first: int
    second: int
    speed: int


def rules_of(profile: VehicleProfile) -> ContinuityRules:
    """The continuity rules of a profile."""
    states, roles = list(profile.state.values()), profile.roles
    top = np.array([np.inf if spec.rate is None else spec.rate for spec in states])
    error = np.zeros(len(states))
    if profile.noise.measurement is not None:
        error = np.abs(profile.noise.measurement.matrix()).sum(axis=1)
    named = roles.position is not None
    first, second = profile.position if named else (-1, -1)
    speed = -1 if roles.speed is None else profile.state_names.index(roles.speed)
    pose = np.ones(len(states), dtype=bool)
    if named:
        pose = np.isin(np.arange(len(states)), [first, second, -1 if profile.heading is None else profile.heading])
        allowed = np.hypot(top[first], top[second])
        limits = states[speed].limits if speed >= 0 else None
        if limits is not None and speed not in (first, second):
            allowed = min(allowed, max(abs(limits[0]), abs(limits[1])))
        top[[first, second]] = allowed
        error[[first, second]] = np.hypot(error[first], error[second])
    return ContinuityRules(
        profile.sample_time_ns, profile.tolerance * profile.sample_time_ns, profile.angles, pose, top, 2 * error,
        first, second, speed,
    )  # fmt: skip


@kernel
def broken_by(
    x: FloatArray, run: NDArray[np.int32], slot: int, before: int, held: int, elapsed: float, rules: ContinuityRules
) -> int:
    """JUMPED, FROZEN or AFTER_FROZEN where the pose after index ``before`` does not follow from the one there."""
    size = x.shape[1]
    index = (before + 1) % size
    said = 0.0
    if rules.speed >= 0:
        said = max(abs(x[slot, before, rules.speed]), abs(x[slot, index, rules.speed])) * elapsed
    for i in range(len(rules.pose)):
        change = _change(x, slot, before, index, i, rules)
        if change <= rules.margin[i]:
            continue
        if rules.top[i] < np.inf:
            if change > ALLOWED_CHANGE * rules.top[i] * elapsed + rules.margin[i]:
                return JUMPED
        elif rules.pose[i]:
            own = said if i in (rules.first, rules.second) else 0.0
            if change > OWN_SPEED * own and _exceeds(x, run, slot, before, held, i, change, SEEN_CHANGE, rules):
                return JUMPED
    if rules.speed < 0 or rules.first < 0 or said <= rules.margin[rules.first]:
        return FOLLOWS
    repeats = _is_still(x, slot, before, index, rules)
    # What follows a repeated pose makes up for it: an increment of two intervals.
    after = held > 1 and run[slot, before] == 0 and _is_still(x, slot, (before - 1) % size, before, rules)
    if (repeats or after) and _exceeds(x, run, slot, before, held, rules.first, said, MOVING, rules):
        return FROZEN if repeats else AFTER_FROZEN
    return FOLLOWS


@kernel
def _is_still(x: FloatArray, slot: int, before: int, index: int, rules: ContinuityRules) -> bool:
    first, second = rules.first, rules.second
    return bool(x[slot, index, first] == x[slot, before, first] and x[slot, index, second] == x[slot, before, second])


@kernel
def _change(x: FloatArray, slot: int, before: int, index: int, i: int, rules: ContinuityRules) -> float:
    """Magnitude of the change of a state: the distance for positions, the lesser turn for angles."""
    if i in (rules.first, rules.second):
        return math.hypot(
            x[slot, index, rules.first] - x[slot, before, rules.first],
            x[slot, index, rules.second] - x[slot, before, rules.second],
        )
    change = abs(x[slot, index, i] - x[slot, before, i])
    if rules.angle[i] and change > math.pi:
        change %= 2 * math.pi
        change = min(change, 2 * math.pi - change)
    return float(change)


@kernel
def _exceeds(
    x: FloatArray, run: NDArray[np.int32], slot: int, newest: int, held: int, i: int, change: float, share: float,
    rules: ContinuityRules,
) -> bool:  # fmt: skip
    """Whether ``change`` exceeds ``share`` times every change of state i between linked ones of the ``held`` samples up
    to ``newest``, some change among enough links presupposed."""
    size = x.shape[1]
    links, moved = 0, False
    for back in range(held - 1):
        index = (newest - back) % size
        if run[slot, index] > 0:
            seen = _change(x, slot, (index - 1) % size, index, i, rules)
            if change <= share * seen:
                return False
            links += 1
            moved = moved or seen > 0.0
    return moved and links >= LEAST_LINKS
