"""The agent: publishes the readings of one vehicle; ``run`` drives any number of agents in one process.

The only module of the package that knows clocks and the network.
"""

import heapq
import math
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Self

import numpy as np
import structlog

from fleet_bus import keys
from fleet_bus.bus import Bus, Publisher
from fleet_bus.clock import SYSTEM, Clock
from fleet_bus.errors import MessageError, ProfileError, UsageError
from fleet_bus.messages import StateFlag, StateSample, VehicleProfile
from fleet_bus.messages.state import ENCODING
from fleet_bus.rejections import Rejections
from fleet_bus.zenoh_bus import as_bus
from vehicle_agent.filters import Filter
from vehicle_agent.sources import Reading, Source

if TYPE_CHECKING:
    import zenoh

_log = structlog.get_logger(__name__)

#: Samples kept for latecomers beyond what they need.
SPARE: Final = 64

#: Why a reading is not published (``Report.skipped``).
REASONS: Final[Mapping[str, str]] = {
    "stamp": "its time is not after that of the sample before",
    "shape": "its state or input has another length than the profile says",
    "not_finite": "it, or what the filter made of it, holds NaN or an infinity",
    "range": "a number of it lies outside of what a message may hold, as the log says",
    "too_large": "its plan is longer than a message may be",
    "filter": "the filter failed",
    "source": "the source failed; it is not asked again",
    "put": "the session did not take it",
}


@dataclass(frozen=True, slots=True)
class Report:
    """What an agent did: samples published, readings skipped by reason (see ``REASONS``), and how often the filter lost
    the vehicle and began anew."""

    vehicle: str
    published: int
    skipped: Mapping[str, int]
    restarts: int = 0


class Agent:
    """Publishes profile, states and, where the source knows them, the true states of the live drive.

    The state cache holds the window with its lags and the history, so that a server that comes later finds
    all of it. The liveliness token appears with ``start``, after the history: who sees it can fetch
    everything at once. ``session`` may be any ``Bus``; ``clock`` tells the time of the start.

    Raises ``KeyIdError`` for an unusable vehicle id, ``ProfileError`` if source and profile do not fit.
    """

    def __init__(
        self,
        session: "zenoh.Session | Bus",
        vehicle: str,
        profile: VehicleProfile,
        source: Source,
        filter: Filter,
        clock: Clock = SYSTEM,
    ) -> None:
        keys.check_id(vehicle)
        _check_fit(profile, source)
        self.vehicle = vehicle
        self._bus = as_bus(session)
        self._profile = profile
        self._filter = filter
        self._readings: Iterator[Reading] = iter(source)
        self._upcoming: Reading | None = None
        self._epoch = clock.time_ns()
        self._seq = 0
        self._last_t = 0
        self._new_trajectory = False
        self._skips = Rejections()
        self._declared = ExitStack()
        cache = max(profile.window + profile.input_lags, source.history) + SPARE
        try:
            self._profiles = self._publisher(keys.profile(vehicle), VehicleProfile.encoding(), 1)
            self._states = self._publisher(keys.state(vehicle), ENCODING, cache)
            truth = keys.truth(vehicle)
            self._truths = self._publisher(truth, ENCODING, SPARE) if source.knows_truth else None
        except BaseException:
            self._declared.close()
            raise

    def _publisher(self, key: str, encoding: str, cache: int) -> Publisher:
        return self._declared.enter_context(self._bus.publisher(key, encoding, cache=cache))

    def close(self) -> None:
        """Take everything back from the bus; closing again does nothing."""
        self._declared.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.close()

    @property
    def report(self) -> Report:
        """What has been done so far."""
        return Report(self.vehicle, self._seq, self._skips.snapshot(), self._filter.restarts)

    @property
    def upcoming(self) -> Reading | None:
        """The reading to publish next, or None when the source has ended; the same until ``publish``."""
        if self._upcoming is None:
            try:
                self._upcoming = next(self._readings, None)
            # A source is somebody else's code: it must not stop the other vehicles.
            except Exception as error:
                self._skip("source", f"{type(error).__name__}: {error}")
                self._readings = iter(())
        return self._upcoming

    def start(self, origin: int) -> None:
        """Publish the profile and the history, its stamps before ``origin`` (Unix ns); then be alive."""
        self._profiles.put(self._profile.encode())
        while (reading := self.upcoming) is not None and StateFlag.HISTORY in reading.flags:
            self.publish(origin)
        self._declared.enter_context(self._bus.alive(keys.alive(self.vehicle)))

    def publish(self, origin: int) -> None:
        """Publish ``upcoming``, stamped ``origin`` (Unix ns) plus its own time, or count why not."""
        reading, self._upcoming = self.upcoming, None
        if reading is None:
            return
        # The mark of a reading that is skipped must not be lost: the next one does not follow either.
        self._new_trajectory |= StateFlag.NEW_TRAJECTORY in reading.flags
        try:
            sample, truth = self._sample(reading, origin + reading.t)
            # What a server would refuse is not sent.
            state, true_state = sample.encode(), None if truth is None else truth.encode()
        except MessageError as error:
            self._skips.count(error, keys.state(self.vehicle))
            return
        try:
            self._states.put(state)
            self._seq, self._last_t, self._new_trajectory = sample.seq + 1, sample.t, False
            if true_state is not None and self._truths is not None and StateFlag.HISTORY not in reading.flags:
                self._truths.put(true_state)
        # A network in trouble must not stop the loop either.
        except Exception as error:
            self._skip("put", f"{type(error).__name__}: {error}")

    def _sample(self, reading: Reading, t: int) -> tuple[StateSample, StateSample | None]:
        """Filtered sample and true one at ``t``; raise ``MessageError`` with one of ``REASONS``."""
        n, m = len(self._profile.state), len(self._profile.inputs)
        truth = reading.truth
        if reading.measured.shape != (n,) or reading.u.shape != (m,) or (truth is not None and truth.shape != (n,)):
            raise MessageError("shape", f"state {reading.measured.shape}, input {reading.u.shape}; expected {n}, {m}")
        if t <= self._last_t:
            raise MessageError("stamp", f"{t} ns does not come after {self._last_t} ns")
        for what, values in (
            ("state", reading.measured),
            ("input", reading.u),
            ("true state", truth),
            ("plan", reading.plan),
        ):
            if values is not None and not np.isfinite(values).all():
                raise MessageError("not_finite", f"{what} {values.tolist()}")
        try:
            if self._new_trajectory:
                self._filter.reset()
            x = self._filter.update(t, reading.measured)
        # Linear algebra fails in many ways.
        except Exception as error:
            self._filter.reset()
            raise MessageError("filter", f"{type(error).__name__}: {error}") from None
        if not np.isfinite(x).all():
            self._filter.reset()
            raise MessageError("not_finite", f"filtered state {x.tolist()}")
        flags = reading.flags | (StateFlag.NEW_TRAJECTORY if self._new_trajectory else StateFlag.NONE)
        sample = StateSample(self._epoch, self._seq, t, x, reading.u, flags, plan=reading.plan)
        true = None if truth is None else StateSample(self._epoch, self._seq, t, truth, reading.u, flags)
        return sample, true

    def _skip(self, reason: str, detail: str) -> None:
        self._skips.count(MessageError(reason, detail), keys.state(self.vehicle))


def run(agents: Sequence[Agent], stop: threading.Event, speed: float = 1.0, clock: Clock = SYSTEM) -> dict[str, Report]:
    """Publish the readings of ``agents`` as they fall due, ``speed`` times as fast, till ``stop`` or the end.

    Histories go out first, at once; then all live drives start together, their stamps counted from that
    instant. A loop that has fallen behind publishes what is due without waiting. Returns the report of each
    vehicle.

    Raises ``UsageError`` for a speed that is not positive or two agents of one vehicle.
    """
    if not (speed > 0 and math.isfinite(speed)):
        raise UsageError(f"speed {speed} must be positive: 1 is real time")
    if len({agent.vehicle for agent in agents}) != len(agents):
        raise UsageError(f"vehicles {sorted(agent.vehicle for agent in agents)}: an id may occur once")
    for agent in agents:
        if stop.is_set():
            break
        agent.start(clock.time_ns())
    origin, began = clock.time_ns(), clock.monotonic()
    queue: list[tuple[float, int]] = []

    def enqueue(index: int) -> None:
        if (reading := agents[index].upcoming) is not None:
            heapq.heappush(queue, (reading.due / speed, index))

    for index in range(len(agents)):
        enqueue(index)
    while queue:
        due, index = queue[0]
        if clock.wait(stop, max(0.0, began + due - clock.monotonic())):
            break
        heapq.heappop(queue)
        agents[index].publish(origin)
        enqueue(index)
    reports = {agent.vehicle: agent.report for agent in agents}
    published, restarts = (sum(getattr(r, name) for r in reports.values()) for name in ("published", "restarts"))
    _log.info("agents done", vehicles=len(reports), published=published, filter_restarts=restarts)
    return reports


def _check_fit(profile: VehicleProfile, source: Source) -> None:
    for what, found, wanted in (
        ("states", source.state_names, profile.state_names),
        ("inputs", source.input_names, profile.input_names),
    ):
        if tuple(found) != wanted:
            raise ProfileError(
                f"the source gives the {what} {list(found)}, profile {profile.vehicle_class!r} lists "
                f"{list(wanted)}: use the profile of this source, or select the columns of the recording"
            )
    if source.sample_time is not None and not math.isclose(source.sample_time, profile.sample_time):
        raise ProfileError(
            f"the source samples every {source.sample_time} s, profile {profile.vehicle_class!r} says "
            f"{profile.sample_time} s"
        )
