"""Where readings come from: a recording or a simulated car. Stamps are relative; the agent has the clock."""

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from fleet_bus.errors import UsageError
from fleet_bus.messages import StateFlag
from vehicle_agent.recording import Recording
from vehicle_agent.route import Route
from vehicle_agent.simulate import Drive, simulate_drive, simulate_history, stand_still
from vehicle_agent.svea import INPUT_NAMES, STATE_NAMES, SveaParameters

#: Pause between what was one after the other but does not follow from it.
PAUSE_NS: Final = 1_000_000_000

#: Enough to fill a window of 1000 with lagged inputs.
DEFAULT_HISTORY: Final = 1024


@dataclass(frozen=True, slots=True, eq=False)
class Reading:
    """One measurement and the input in force from it on.

    Attributes:
        t: nanoseconds since the start of the source; a history has negative ones.
        due: seconds after the start of the source at which to publish; a history is due at once.
        measured: state (n) as the sensor says, units of the profile.
        u: input (m); zeros where ``flags`` say that it is missing.
        flags: see ``StateFlag``.
        truth: the true state (n), known to simulators only.
        plan: inputs (steps, m) that will follow ``u``, or None where they are not known.
    """

    t: int
    due: float
    measured: NDArray[np.float64]
    u: NDArray[np.float64]
    flags: StateFlag = StateFlag.NONE
    truth: NDArray[np.float64] | None = None
    plan: NDArray[np.float64] | None = None


class Source(Protocol):
    """Readings of one vehicle in the order of their stamps, a history first; each ``iter`` starts anew."""

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of the n states."""

    @property
    def input_names(self) -> tuple[str, ...]:
        """Names of the m inputs."""

    @property
    def sample_time(self) -> float | None:
        """Sample time in s where it is fixed."""

    @property
    def history(self) -> int:
        """How many readings come from before the start."""

    @property
    def knows_truth(self) -> bool:
        """Whether readings carry the true state."""

    def __iter__(self) -> Iterator[Reading]:
        """The readings; may go on without end."""


class RecordingSource:
    """A recording, ``speed`` times as fast as it was; stamps keep the recorded intervals whatever the speed.

    A segment begins a trajectory, ``PAUSE_NS`` after the end of the one before. Where part of an input was
    not recorded the whole input is missing. Raises ``UsageError`` for a speed that is not positive.
    """

    history: Final = 0
    knows_truth: Final = False
    sample_time: Final = None

    def __init__(self, recording: Recording, speed: float = 1.0) -> None:
        if not 0 < speed < np.inf:
            raise UsageError(f"speed {speed} must be positive: 1 plays a recording as it was, 2 twice as fast")
        self._recording = recording
        self._speed = speed

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of the n states."""
        return self._recording.state_names

    @property
    def input_names(self) -> tuple[str, ...]:
        """Names of the m inputs."""
        return self._recording.input_names

    def __iter__(self) -> Iterator[Reading]:
        """One reading a row."""
        recording, begin = self._recording, 0
        for rows in recording.segments():
            stamps = begin + np.rint((recording.t[rows] - recording.t[rows.start]) * 1e9).astype(np.int64)
            flags = StateFlag.NEW_TRAJECTORY
            for t, x, u in zip(stamps.tolist(), recording.x[rows], recording.u[rows], strict=True):
                if np.isnan(u).any():
                    u, flags = np.zeros_like(u), flags | StateFlag.INPUT_MISSING
                yield Reading(t, t / 1e9 / self._speed, x, u, flags)
                flags = StateFlag.NONE
            begin = int(stamps[-1]) + PAUSE_NS


class SimulatedSource:
    """A simulated SVEA: a history of free driving, then its drive on ``route``, then it stands without end.

    Live stamps are k * dt; the history ends ``PAUSE_NS`` before the first. The drive is simulated at
    construction: raises ``UsageError`` where that fails (simulate.py). So each live reading can carry as its plan
    the ``plan_steps`` inputs that do follow.
    """

    state_names: Final = STATE_NAMES
    input_names: Final = INPUT_NAMES
    knows_truth: Final = True

    def __init__(
        self,
        route: Route,
        seed: int,
        history: int = DEFAULT_HISTORY,
        parameters: SveaParameters | None = None,
        plan_steps: int = 0,
    ) -> None:
        self._seed = seed
        self._plan_steps = plan_steps
        self._parameters = parameters or SveaParameters()
        self._history = simulate_history(seed, history, self._parameters)
        self._drive = simulate_drive(route, seed, self._parameters)

    @property
    def sample_time(self) -> float:
        """Sample time in s."""
        return self._parameters.dt

    @property
    def history(self) -> int:
        """How many readings come from before the start."""
        return len(self._history.truth)

    @property
    def drive(self) -> Drive:
        """The live drive, up to the end of the route."""
        return self._drive

    def __iter__(self) -> Iterator[Reading]:
        """History, drive, standing still."""
        dt = self._parameters.dt_ns
        first = StateFlag.NEW_TRAJECTORY
        for k in range(self.history):
            t = -PAUSE_NS - (self.history - 1 - k) * dt
            yield _of_drive(self._history, k, t, 0.0, StateFlag.HISTORY | first)
            first = StateFlag.NONE
        ahead: deque[Reading] = deque()
        for reading in self._live():
            ahead.append(reading)
            if len(ahead) > self._plan_steps:
                current = ahead.popleft()
                plan = np.array([later.u for later in ahead]) if ahead else None
                yield replace(current, plan=plan)

    def _live(self) -> Iterator[Reading]:
        dt, count = self._parameters.dt_ns, len(self._drive.truth)
        for k in range(count):
            flags = StateFlag.NONE if k else StateFlag.NEW_TRAJECTORY
            yield _of_drive(self._drive, k, k * dt, k * dt / 1e9, flags)
        for k, (truth, measured, u) in enumerate(stand_still(self._drive, self._seed, self._parameters), count):
            yield Reading(k * dt, k * dt / 1e9, measured, u, StateFlag.NONE, truth)


def _of_drive(drive: Drive, k: int, t: int, due: float, flags: StateFlag) -> Reading:
    return Reading(t, due, drive.measured[k], drive.inputs[k], flags, drive.truth[k])
