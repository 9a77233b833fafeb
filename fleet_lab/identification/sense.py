"""Whether what was recorded makes sense: stamps, units and columns that contradict each other, each with what to do."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from fleet_bus.units import canonical, seconds
from fleet_lab.identification.estimates import intervals_of
from fleet_lab.identification.motion import agreement, heading_problem
from vehicle_agent.recording import Recording

#: Units of time that stamps are taken for, and how many of them are a second.
_UNITS: Final = {"ms": 1e3, "µs": 1e6, "ns": 1e9}
#: Median interval, s, from which stamps are doubted; those that are likely; and the longest that a profile takes.
_DOUBTFUL: Final = 0.9
_LIKELY: Final = (1e-3, 2.0)
_LONGEST: Final = 60.0
#: How far a ratio may be off what it is taken for, as a factor.
_NEAR: Final = 2.0
#: Part of the rows without an input from which it is told.
_GAPS: Final = 0.02


@dataclass(slots=True)
class Findings:
    """``problems`` make a calibration worthless, ``doubts`` are worth knowing; ``sample_time`` in s, where the stamps
    are in another unit."""

    problems: list[str] = field(default_factory=list)
    doubts: list[str] = field(default_factory=list)
    sample_time: float | None = None


def examine(recordings: Sequence[Recording], fields: Mapping[str, Any], *, guessed: bool) -> Findings:
    """What does not fit together, for the states, inputs and roles of ``fields``; ``guessed``: no roles were given."""
    found = Findings()
    roles = _roles(recordings, fields)
    ratio = None
    if "position" in roles and "speed" in roles:
        ratio = agreement(recordings, roles["position"], roles["speed"])
    _stamps(found, recordings, fields, ratio)
    if found.sample_time is None and ratio is not None:
        _speed(found, roles["position"], roles["speed"], ratio)
    _heading(found, recordings, roles)
    _inputs(found, recordings, fields)
    if guessed:
        _not_recognised(found, recordings, fields, roles)
    return found


def _roles(recordings: Sequence[Recording], fields: Mapping[str, Any]) -> dict[str, Any]:
    """The roles whose columns were recorded."""
    roles = fields.get("roles")
    if not isinstance(roles, Mapping):
        return {}
    there = set(recordings[0].state_names).intersection(*(r.state_names for r in recordings))
    found: dict[str, Any] = {}
    for role, names in roles.items():
        listed = names if role == "position" else [names]
        if isinstance(listed, list | tuple) and all(isinstance(n, str) and n in there for n in listed):
            found[role] = names
    if len(found.get("position", ())) != 2:
        found.pop("position", None)
    return found


def _stamps(found: Findings, recordings: Sequence[Recording], fields: Mapping[str, Any], ratio: float | None) -> None:
    median = float(np.median(intervals_of(recordings)))
    if median < _DOUBTFUL:
        return
    stated = _stated_sample_time(fields)
    for unit, per_second in _UNITS.items():
        if ratio is not None and _near(ratio * per_second, 1.0):
            why = f"the vehicle moves {ratio:.2g} of what speed times interval says"
        elif stated is not None and _near(median / per_second, stated):
            why = f"the sample_time given is {1e3 * stated:g} ms"
        elif ratio is None and stated is None and median > _LONGEST and _LIKELY[0] <= median / per_second <= _LIKELY[1]:
            why = f"a sample_time is at most {_LONGEST:g} s"
        else:
            continue
        found.sample_time = median / per_second
        found.problems.append(
            f"the stamps t look like {unit}, not s: their median interval is {median:.4g}, and {why}; divide t by "
            f"{per_second:.0e}".replace("e+0", "e")
        )
        return
    if median > _LONGEST:
        found.problems.append(
            f"the median sample interval is {median:.4g} s, more than the {_LONGEST:g} s that a sample_time may be: "
            "are the stamps t in seconds?"
        )
    elif ratio is None and stated is None:
        found.doubts.append(
            f"the median sample interval is {median:.4g} s, and no speed is there to check it by: if the stamps t are "
            "in ms, divide them by 1000"
        )


def _stated_sample_time(fields: Mapping[str, Any]) -> float | None:
    try:
        return seconds(fields["sample_time"])
    except (KeyError, ValueError):
        return None


def _speed(found: Findings, position: Sequence[str], speed: str, ratio: float) -> None:
    if 1 / _NEAR <= ratio <= _NEAR:
        return
    text = (
        f"{' and '.join(position)} move {ratio:.3g} times as far as {speed} times the interval says: one of the units "
        f"is wrong, or {speed} is not the speed of the vehicle"
    )
    if any(_near(ratio, power) for power in (1e-6, 1e-3, 1e-2, 1e2, 1e3, 1e6)):
        found.problems.append(
            f"{text}; convert the column that is wrong, or name another one under roles: {{speed: …}}"
        )
    else:
        kilometres = " (3.6: km/h)" if _near(ratio * 3.6, 1.0, 1.15) or _near(ratio / 3.6, 1.0, 1.15) else ""
        found.doubts.append(f"{text}{kilometres}; correct it, or name another one under roles: {{speed: …}}")


def _heading(found: Findings, recordings: Sequence[Recording], roles: Mapping[str, Any]) -> None:
    heading = roles.get("heading")
    if heading is None:
        return
    units = {canonical(r.state_units[r.state_names.index(heading)]) for r in recordings}
    convert = f'convert the column, x[:, {recordings[0].state_names.index(heading)}] = np.deg2rad(…), unit "rad"'
    if "deg" in units:
        found.problems.append(f"the heading {heading} is in degrees, angles of a profile are in rad: {convert}")
        return
    if "position" not in roles:
        return
    seems = heading_problem(recordings, roles["position"], heading)
    if seems is None:
        return
    what, sure = seems
    if sure:
        todo = (
            convert
            if what == "in degrees"
            else f"{convert}; " * ("degrees" in what)
            + ("make it counter-clockwise from the first position axis, yaw = π/2 - bearing for a compass")
        )
        found.problems.append(f"the heading {heading} is {what}, held against the motion of the position: {todo}")
    else:
        found.doubts.append(
            f"the heading {heading} is {what}: it should be in rad, counter-clockwise from {roles['position'][0]} to "
            f"{roles['position'][1]}; where it is not the direction of travel, leave it out of roles, with frame: world"
        )


def _inputs(found: Findings, recordings: Sequence[Recording], fields: Mapping[str, Any]) -> None:
    wanted = fields.get("inputs")
    names = [str(name) for name in wanted] if isinstance(wanted, Mapping) else []
    if not names:
        dropped = f" ({', '.join(recordings[0].input_names)} NaN throughout)" if recordings[0].input_names else ""
        found.doubts.append(
            f"no input is recorded{dropped}: what the driver does counts as error, and the sets are larger for it; "
            "record the commands (u, u_names, u_units)"
        )
        return
    for name in names:
        columns = [np.isnan(r.u[:, r.input_names.index(name)]) for r in recordings if name in r.input_names]
        missing = float(np.concatenate(columns).mean()) if columns else 0.0
        if missing == 1.0:
            found.problems.append(f"the input {name} is NaN in all rows: leave it out of inputs, or record it")
        elif missing > _GAPS:
            found.doubts.append(
                f"the input {name} is NaN in {100 * missing:.1f} % of the rows: no transition whose lags need it is "
                "used; record it, or leave it out of inputs"
            )


def _not_recognised(
    found: Findings, recordings: Sequence[Recording], fields: Mapping[str, Any], roles: Mapping[str, Any]
) -> None:
    taken = {name for names in roles.values() for name in ([names] if isinstance(names, str) else names)}
    state = fields.get("state")
    left = [str(n) for n in (state if isinstance(state, Mapping) else recordings[0].state_names) if n not in taken]
    for role, costs in (
        ("position", "there is no frame: body without it"),
        ("heading", "there is no frame: body without it"),
        ("speed", "no feature is made of it, and the sets are larger"),
    ):
        if role not in roles and left:
            example = "[x, y]" if role == "position" else "NAME"
            angle = ", and mark that state angle: true (rad)" if role == "heading" else ""
            found.doubts.append(
                f"no column is recognised as the {role} (left: {', '.join(left)}): {costs}; if one is, write roles: "
                f"{{{role}: {example}}} into the profile{angle}"
            )


def _near(value: float, wanted: float, factor: float = _NEAR) -> bool:
    return wanted / factor <= value <= wanted * factor
