"""The scenarios of the paper over a recorded drive: the tables' sets, and those of the reach server."""

import time
from collections import Counter
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from fleet_bus.errors import RecordingError
from fleet_bus.messages import VehicleProfile
from fleet_lab.evaluation.trials import linked, samples
from fleet_lab.paper.drives import Track
from fleet_lab.paper.formulas import FORMULAS, Formula
from fleet_lab.paper.scenario_registration import Placement, place, widened_motion
from reach_server.audit import prediction_check as audit
from reach_server.data.window import SampleBatch
from reach_server.engine.engine import Engine
from reach_server.numeric.types import FloatArray
from reach_server.sets.raw import join_sets
from side_info import Scenario
from vehicle_agent.recording import Recording
from vehicle_agent.sources import PAUSE_NS

#: Part of a recording of one segment that is history.
_HISTORY: Final = 0.4
#: Part of the median interval by which one may differ from it: other transitions are left out.
_EVEN: Final = 0.3
#: Fewest transitions of history, and of what is tested.
_FEWEST: Final = 200


@dataclass(frozen=True, slots=True, eq=False)
class Laid:
    """A formula over a recorded drive: ``formula`` in the size and time of ``placement``; with the reason in its place
    where the drive cannot satisfy it, ``missing``."""

    key: str
    formula: Formula | None
    placement: Placement | None
    missing: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Recorded:
    """A recording split in two: ``history`` and ``tested`` (rows of ``recording``), and the latter as a track."""

    recording: Recording
    profile: VehicleProfile
    history: tuple[slice, ...]
    tested: slice
    noise: FloatArray

    @property
    def track(self) -> Track:
        """What is tested."""
        return self.track_of(self.tested)

    def track_of(self, rows: slice) -> Track:
        """Some rows of one segment as a track; the input is the velocity over the interval before each sample."""
        axes = list(self.profile.position)
        t, position = self.recording.t[rows], self.recording.x[rows][:, axes]
        velocity = np.diff(position, axis=0) / np.diff(t)[:, None]
        heading = self.recording.x[rows, self.profile.state_names.index(str(self.profile.roles.heading))][1:]
        return Track(self.recording.name, t[1:], position[1:], heading, velocity)


def split(recording: Recording, profile: VehicleProfile) -> Recorded:
    """The longest segment after the first is tested and the others are history, or the first part of a single one.

    Raises ``RecordingError`` for a recording that lacks the profile's columns, position or heading, or is too short.
    """
    recording = recording.select(profile)
    if profile.roles.position is None or profile.roles.heading is None:
        raise RecordingError(
            f"profile {profile.vehicle_class}: names no roles.position and roles.heading, which scenarios need"
        )
    segments = list(recording.segments())
    if len(segments) == 1:
        (only,) = segments
        middle = only.start + round(_HISTORY * (only.stop - only.start))
        segments = [slice(only.start, middle), slice(middle, only.stop)]
    longest = max(range(1, len(segments)), key=lambda i: (segments[i].stop - segments[i].start, i))
    history = tuple(segment for i, segment in enumerate(segments) if i != longest)
    known = sum(segment.stop - segment.start for segment in history)
    if known < _FEWEST or segments[longest].stop - segments[longest].start < _FEWEST:
        raise RecordingError(
            f"{recording.name}: {known} samples of history and {segments[longest].stop - segments[longest].start} in "
            f"the longest other segment; at least {_FEWEST} of each are needed"
        )
    measured = profile.noise.measurement
    axes = list(profile.position)
    noise = np.zeros((2, 0)) if measured is None else measured.matrix()[axes]
    return Recorded(recording, profile, history, segments[longest], noise)


def lay_all(recorded: Recorded) -> list[Laid]:
    """Every formula over what is tested, those of one example in the same place."""
    found: dict[tuple[object, ...], Placement | None] = {}
    laid = []
    for formula in FORMULAS:
        regions = (formula.strips, formula.discs)
        if regions not in found:
            found[regions] = place(formula, recorded.track)
        placement, motion = found[regions], formula.motion
        if placement is None:
            laid.append(Laid(formula.key, None, None, "no part of the drive satisfies it, in whatever place and size"))
            continue
        if motion is not None:
            motion = widened_motion(motion, placement.track(recorded.track), recorded.noise)
            if motion is None:
                laid.append(Laid(formula.key, None, None, "the vehicle leaves any T(x), sideways or backwards"))
                continue
        fitted = replace(formula.laid_over(placement.size, placement.stretch), motion=motion)
        laid.append(Laid(formula.key, fitted, placement))
    return laid


def history_tracks(recorded: Recorded, placement: Placement) -> list[Track]:
    """The history as tracks in the frame of a placement, without transitions over uneven intervals."""
    tracks = []
    for rows in recorded.history:
        track = recorded.track_of(rows)
        turned = replace(placement, begin=0, end=len(track.t)).track(track)
        breaks = [0, *(np.flatnonzero(~_even(turned.t)) + 1).tolist(), len(turned.t)]
        for start, stop in pairwise(breaks):
            if stop - start > 1:
                part = slice(start, stop)
                kept = (getattr(turned, name)[part] for name in ("t", "position", "heading", "velocity"))
                tracks.append(Track(turned.name, *kept))
    return tracks


def even_steps(track: Track) -> NDArray[np.bool_]:
    """Which steps of a track have an interval near the median, as those of the data have."""
    return _even(track.t)


def _even(t: FloatArray) -> NDArray[np.bool_]:
    interval = np.diff(t)
    even: NDArray[np.bool_] = np.abs(interval - np.median(interval)) <= _EVEN * np.median(interval)
    return even


@dataclass(frozen=True, slots=True)
class Served:
    """What the reach server makes of the drive, at the first and the last step of the horizon: by step, mean area in m²
    with and without side information, and measured states that lay inside, of those checked."""

    step: int
    area: float
    area_free: float
    inside: int
    inside_free: int
    checked: int
    labels: dict[str, int]
    microseconds: float

    def as_json(self) -> dict[str, object]:
        """The fields by name."""
        return asdict(self)


def serve(recorded: Recorded, laid: Laid, tell: Callable[[float], None]) -> list[Served]:
    """The engine with the profile's own method, over the part of the drive that the scenario speaks about.

    T(x) is about one sample ahead: with it the horizon is one step.
    """
    assert laid.formula is not None
    assert laid.placement is not None
    placement, profile = laid.placement, recorded.profile
    names = profile.state_names
    axes = list(profile.position)
    heading = names.index(str(profile.roles.heading))
    x = np.array(recorded.recording.x)
    x[:, axes] = placement.positions(x[:, axes])
    x[:, heading] += placement.angle
    turned = replace(recorded.recording, x=x)
    maps = {"x1": names[axes[0]], "x2": names[axes[1]], "yaw": names[heading]}
    profile = profile.model_copy(update={"maps_to": maps})
    engine = Engine(profile, horizon=1 if laid.formula.motion is not None else None)
    slot = engine.add("vehicle")
    history = samples([_rows(turned, recorded.history)], 0, PAUSE_NS)
    engine.append(SampleBatch.of(slot, history))
    tested = samples([_rows(turned, (recorded.tested,))], 1, history[-1].t + PAUSE_NS)
    # A track begins one sample late: its first input is the difference of two positions.
    begin, end = placement.begin + 1, placement.end + 1
    engine.append(SampleBatch.of(slot, tested[:begin]))
    engine.assign("vehicle", Scenario.parse(laid.formula.document()), tested[begin].t)
    found, seconds, rows, labels = [], [], [], Counter[str]()
    for k in range(begin, end):
        began = time.perf_counter()
        tubes = engine.step(SampleBatch.of(slot, tested[k : k + 1]))
        if tubes.vehicles:
            seconds.append(time.perf_counter() - began)
            found.append(tubes)
            rows.append(k)
            labels[str(tubes.labels[0])] += 1
        tell((k + 1 - begin) / (end - begin))
    if not found:
        return []
    follows = np.concatenate([[0], np.cumsum(~linked(profile, tested))])
    states, angles = np.stack([sample.x for sample in tested]), tuple(np.flatnonzero(profile.angles).tolist())
    served = []
    for step in sorted({1, engine.horizon}):
        wanted = np.array([k + step < end and follows[k + step + 1] == follows[k + 1] for k in rows])
        which = np.flatnonzero(wanted)
        if not len(which):
            continue
        counts = []
        for name in ("steps", "free"):
            sets = join_sets([getattr(found[i], name)[step - 1] for i in which])
            truth = states[[rows[i] + step for i in which]]
            counts.append(int(audit.inside(sets, engine.noise_of_claim, truth, angles)[0].sum()))
        area, free = (
            float(np.mean([getattr(found[i], name)[0, step - 1] for i in which])) for name in ("area", "area_free")
        )
        took = float(np.median(seconds)) * 1e6
        served.append(Served(step, area, free, counts[0], counts[1], len(which), dict(labels), took))
    return served


def _rows(recording: Recording, parts: tuple[slice, ...]) -> Recording:
    index = np.concatenate([np.arange(part.start, part.stop) for part in parts])
    return replace(
        recording, t=recording.t[index], x=recording.x[index], u=recording.u[index], segment=recording.segment[index]
    )
