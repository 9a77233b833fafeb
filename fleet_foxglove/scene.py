"""Pure functions from messages of the bus to messages of Foxglove.

Positions are doubles in poses, and the vertices below a pose are the outline as the tube has it, relative to the
center: graphics cards compute in single precision, in which a vertex a thousand kilometres from the origin would jump
by centimetres. Every orientation is written out: one that is left out is read as four zeros, which is no rotation.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np
from foxglove.messages import (
    ArrowPrimitive,
    Color,
    Duration,
    FrameTransform,
    KeyValuePair,
    LinePrimitive,
    LinePrimitiveLineType,
    Log,
    LogLevel,
    Point3,
    Pose,
    Quaternion,
    SceneEntity,
    SceneUpdate,
    TextPrimitive,
    Timestamp,
    TriangleListPrimitive,
    Vector3,
)
from numpy.typing import NDArray

from fleet_bus.errors import MessageError
from fleet_bus.messages import Event, EventKind, Label, ReachTube, StateSample, VehicleProfile
from fleet_foxglove.topics import FLEET, WORLD, vehicle_frame

#: How long a tube is shown if none follows: so many of its steps, in these bounds (ns).
LIFETIME_STEPS: Final = 5
SHORTEST_LIFETIME: Final = 2 * 10**9
LONGEST_LIFETIME: Final = 300 * 10**9

#: Stamps of Foxglove have 32 bits for seconds: they end in February 2106.
LATEST: Final = 2**32 * 10**9

#: Red, green and blue of each label: #1b7837, #2166ac, #e08214, #b2182b.
COLORS: Final[Mapping[Label, tuple[float, float, float]]] = {
    Label.GUARANTEED: (27 / 255, 120 / 255, 55 / 255),
    Label.CALIBRATED: (33 / 255, 102 / 255, 172 / 255),
    Label.UNCOVERED: (224 / 255, 130 / 255, 20 / 255),
    Label.CONTRADICTED: (178 / 255, 24 / 255, 43 / 255),
}
_REGION_COLOR: Final = (0.6, 0.6, 0.6)
#: Opacity of the first and of the last outline, and of what is filled.
_NEAR, _FAR, _FILLED = 1.0, 0.3, 0.15

#: What an operator must not overlook, and what is good news; all else is worth a look.
_ERRORS: Final = {
    EventKind.CONTRADICTION, EventKind.DATA_CONTRADICTED, EventKind.PROFILE_CONTRADICTED, EventKind.PROFILE_REFUSED,
    EventKind.SCENARIO_REFUSED, EventKind.SECOND_SERVER, EventKind.TWO_SOURCES,
}  # fmt: skip
_NEWS: Final = {EventKind.ONE_SOURCE, EventKind.PROFILE_CHANGED}


class Region(NamedTuple):
    """A region of a scenario by the lines around it: each (K, 2), in the units of the scenario's first two states."""

    name: str
    outlines: Sequence[NDArray[np.float64]]


class Regions(NamedTuple):
    """What can be drawn of a scenario: regions in the plane of two states, and why each other one is left out."""

    scenario: str
    names: tuple[str, str]
    regions: Sequence[Region]
    left_out: Mapping[str, str]


def timestamp(t: int) -> Timestamp:
    """Stamp of a time in Unix ns; raise ``MessageError("range")`` for one that Foxglove has none for."""
    if not 0 <= t < LATEST:
        raise MessageError("range", f"t is {t}: Foxglove's stamps end at {LATEST} ns")
    return Timestamp(*divmod(t, 10**9))


def tube_update(tube: ReachTube, profile: VehicleProfile | None) -> SceneUpdate:
    """Scene of one tube: all outlines, the last set filled, a text, and an arrow if ``profile`` names a heading.

    Raises ``MessageError("range")`` for times beyond those of Foxglove.
    """
    stamp, lifetime = timestamp(tube.t), _lifetime(tube)
    steps = len(tube.times)
    centers = tube.center[:, list(tube.position)]
    fading = np.linspace(_NEAR, _FAR, steps)
    lines = [
        LinePrimitive(
            type=LinePrimitiveLineType.LineLoop,
            pose=_pose(centers[h]),
            thickness=2.0,
            scale_invariant=True,
            points=_points(tube.outline[h]),
            color=_color(tube.label, fading[h]),
        )
        for h in range(steps)
        if tube.outline.shape[1]
    ]
    entity = SceneEntity(
        timestamp=stamp,
        frame_id=WORLD,
        id=f"tube/{tube.vehicle}",
        lifetime=lifetime,
        metadata=[KeyValuePair(key=key, value=value) for key, value in _metadata(tube)],
        lines=lines,
        triangles=_filled(tube, centers[-1]),
        texts=[
            TextPrimitive(
                pose=_pose(centers[0]),
                billboard=True,
                font_size=14.0,
                scale_invariant=True,
                color=_color(tube.label, 1.0),
                text=f"{tube.vehicle} {tube.label}",
            )
        ],
    )
    entities = [entity]
    if profile is not None and profile.heading is not None:
        entities.append(_heading(tube, stamp, lifetime))
    return SceneUpdate(entities=entities)


def _heading(tube: ReachTube, stamp: Timestamp, lifetime: Duration) -> SceneEntity:
    """Arrow along the vehicle's frame, in that frame: arrows are placed in single precision."""
    return SceneEntity(
        timestamp=stamp,
        frame_id=vehicle_frame(tube.vehicle),
        id=f"heading/{tube.vehicle}",
        lifetime=lifetime,
        frame_locked=True,
        arrows=[
            ArrowPrimitive(
                pose=_pose((0.0, 0.0)),
                shaft_length=0.3,
                shaft_diameter=0.08,
                head_length=0.15,
                head_diameter=0.16,
                color=_color(tube.label, 1.0),
            )
        ],
    )


def _filled(tube: ReachTube, center: NDArray[np.float64]) -> list[TriangleListPrimitive]:
    corners = tube.outline.shape[1]
    if corners < 3:
        return []
    # An outline is convex: all its triangles can begin at its first vertex.
    fan = [i for k in range(1, corners - 1) for i in (0, k, k + 1)]
    color = _color(tube.label, _FILLED)
    return [TriangleListPrimitive(pose=_pose(center), points=_points(tube.outline[-1]), color=color, indices=fan)]


def _metadata(tube: ReachTube) -> list[tuple[str, str]]:
    return [
        ("label", str(tube.label)),
        ("method", tube.method),
        ("sample", f"{tube.epoch}/{tube.seq}"),
        ("server", tube.server),
        *(("cut", f"{cut.scenario} {cut.predicate}, steps {cut.first} to {cut.last}") for cut in tube.cuts),
        *(("note", note) for note in tube.notes),
        *tube.verdicts.items(),
    ]


def _lifetime(tube: ReachTube) -> Duration:
    wanted = LIFETIME_STEPS * max(int(tube.times[0]) - tube.t, 0)
    return Duration(*divmod(min(max(wanted, SHORTEST_LIFETIME), LONGEST_LIFETIME), 10**9))


def vehicle_transform(vehicle: str, sample: StateSample, profile: VehicleProfile) -> FrameTransform:
    """Transform from the world to a vehicle's frame: its measured position, turned by its heading if it has one.

    Raises ``MessageError`` (profile, range) for a sample of another number of states, and for times beyond those of
    Foxglove.
    """
    if len(sample.x) != len(profile.state):
        raise MessageError("profile", f"{len(sample.x)} states came, the profile of {vehicle} has {len(profile.state)}")
    yaw = 0.0 if profile.heading is None else float(sample.x[profile.heading])
    x, y = (float(sample.x[i]) for i in profile.position)
    return FrameTransform(
        timestamp=timestamp(sample.t),
        parent_frame_id=WORLD,
        child_frame_id=vehicle_frame(vehicle),
        translation=Vector3(x=x, y=y, z=0.0),
        rotation=_turned(yaw),
    )


def origin_transform(t: int, origin: tuple[float, float]) -> FrameTransform:
    """Transform from the world to the frame ``fleet``, whose axes are those of the world."""
    x, y = origin
    return FrameTransform(
        timestamp=timestamp(t),
        parent_frame_id=WORLD,
        child_frame_id=FLEET,
        translation=Vector3(x=x, y=y, z=0.0),
        rotation=_turned(0.0),
    )


def regions_update(drawn: Regions, t: int) -> SceneUpdate:
    """Scene of one scenario: its regions outlined and named, until the next version of them."""
    lines, texts = [], []
    for region in drawn.regions:
        for outline in region.outlines:
            anchor = outline[0]
            lines.append(
                LinePrimitive(
                    type=LinePrimitiveLineType.LineStrip,
                    pose=_pose(anchor),
                    thickness=1.5,
                    scale_invariant=True,
                    points=_points(outline - anchor),
                    color=Color(**dict(zip("rgb", _REGION_COLOR, strict=True)), a=0.9),
                )
            )
        if region.outlines:
            texts.append(
                TextPrimitive(
                    pose=_pose(region.outlines[0][0]),
                    billboard=True,
                    font_size=12.0,
                    scale_invariant=True,
                    color=Color(**dict(zip("rgb", _REGION_COLOR, strict=True)), a=1.0),
                    text=f"{drawn.scenario}.{region.name}",
                )
            )
    # Without a lifetime it stays: a document is published once.
    entity = SceneEntity(
        timestamp=timestamp(t), frame_id=WORLD, id=f"scenario/{drawn.scenario}", lines=lines, texts=texts
    )
    return SceneUpdate(entities=[entity])


def event_log(event: Event) -> Log:
    """Log entry of an event; raise ``MessageError("range")`` for a time beyond those of Foxglove."""
    level = LogLevel.Error if event.kind in _ERRORS else LogLevel.Info if event.kind in _NEWS else LogLevel.Warning
    name = event.source if event.vehicle is None else f"{event.source}/{event.vehicle}"
    return Log(timestamp=timestamp(event.t), level=level, message=f"{event.kind}: {event.message}", name=name)


def numbers(tube: ReachTube, arrived_ns: int) -> dict[str, object]:
    """What can be plotted of a tube (``topics.NUMBERS_SCHEMA``); ``arrived_ns`` (Unix ns) is 0 where not known."""
    audit = tube.audit
    sec, nsec = divmod(tube.t, 10**9)
    return {
        "timestamp": {"sec": sec, "nsec": nsec},
        "vehicle": tube.vehicle,
        "label": str(tube.label),
        "method": tube.method,
        "server": tube.server,
        "area": float(tube.area[-1]),
        "area_free": float(tube.area_free[-1]),
        "first_area": float(tube.area[0]),
        "coverage": audit.recent_inside / audit.recent if audit.recent else None,
        "checked": audit.checked,
        "misses": audit.checked - audit.inside,
        "compute_ms": 1e3 * tube.compute_seconds,
        "age_ms": (arrived_ns - tube.t) / 1e6 if arrived_ns else None,
        "cuts": len(tube.cuts),
        "verdicts": [{"name": name, "verdict": verdict} for name, verdict in tube.verdicts.items()],
    }


def _pose(position: Sequence[float] | NDArray[np.float64]) -> Pose:
    x, y = (float(value) for value in position)
    return Pose(position=Vector3(x=x, y=y, z=0.0), orientation=_turned(0.0))


def _turned(yaw: float) -> Quaternion:
    return Quaternion(x=0.0, y=0.0, z=math.sin(yaw / 2), w=math.cos(yaw / 2))


def _points(outline: NDArray[np.floating]) -> list[Point3]:
    return [Point3(x=x, y=y, z=0.0) for x, y in outline.tolist()]


def _color(label: Label, opacity: float) -> Color:
    r, g, b = COLORS[label]
    return Color(r=r, g=g, b=b, a=float(opacity))
