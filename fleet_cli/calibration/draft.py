"""A profile completed from what a recording says: columns, units, roles by the names that the field uses."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from fleet_bus.errors import ProfileError
from fleet_bus.keys import ID_PATTERN
from vehicle_agent.recording import Recording

#: Names by which a role is recognised, in the order of preference; compared in lower case.
_POSITIONS: Final = (("x", "y"), ("px", "py"), ("pos_x", "pos_y"), ("x1", "x2"), ("east", "north"), ("e", "n"))
_HEADINGS: Final = ("yaw", "heading", "theta", "psi", "x3")
_SPEEDS: Final = ("v", "speed", "vx", "v_x", "velocity", "v_encoder", "x4")
_LATERAL: Final = ("vy", "v_y", "lateral_speed")
_YAW_RATES: Final = ("yaw_rate", "yawrate", "omega", "r", "wz", "w_z")
_STEERING: Final = re.compile(r"steer|delta|curvature", re.IGNORECASE)
_ANGLE: Final = re.compile(r"yaw|heading|theta|psi|angle|course|azimuth", re.IGNORECASE)
_NOTHING: Final = 1e-12
_RATE: Final = re.compile(r"rate|dot|omega", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class Choice:
    """One field of a profile, and where its value comes from: ``given``, ``guessed`` (from names) or ``estimated``."""

    field: str
    value: Any
    origin: str
    why: str


def complete(given: Mapping[str, Any], recordings: list[Recording], name: str) -> tuple[dict[str, Any], list[Choice]]:
    """Fields of a profile with columns, units, angles and roles filled in where none are given, and what was filled in.

    ``name`` names the class where none does. The values themselves are checked where the profile is made. Raises
    ``ProfileError`` where the recordings do not have the same columns and the profile does not choose among them.
    """
    fields, choices = dict(given), list[Choice]()

    def guess(field: str, value: Any, why: str) -> None:
        fields[field] = value
        choices.append(Choice(field, list(value) if field in ("state", "inputs") else value, "guessed", why))

    if "class" not in fields:
        guess("class", _identifier(name), "from the name of the file")
    first = recordings[0]
    for field, names, units in (
        ("state", first.state_names, first.state_units),
        ("inputs", first.input_names, first.input_units),
    ):
        if field not in fields:
            _same_columns(field, recordings)
            guess(field, {n: _quantity(n, u, field) for n, u in zip(names, units, strict=True)}, "columns recorded")
        elif isinstance(fields[field], Mapping):
            fields[field] = _with_units(fields[field], dict(zip(names, units, strict=True)), field)
    if "roles" not in fields and isinstance(fields["state"], Mapping):
        roles = _roles(fields["state"], fields["inputs"] if isinstance(fields["inputs"], Mapping) else {})
        guess("roles", roles, "from the names of the columns" if roles else "no known names")
    if "frame" not in fields and isinstance(fields["roles"], Mapping):
        body = {"position", "heading"} <= fields["roles"].keys()
        why = "position and heading are known" if body else "no position and heading are named"
        guess("frame", "body" if body else "world", why)
    if "future_inputs" not in fields:
        guess("future_inputs", "learned", "nothing is said about inputs to come")
    return fields, choices


def observed_limits(recordings: list[Recording], inputs: Mapping[str, Any]) -> dict[str, tuple[float, float]]:
    """Range of each input over all recordings, rounded outwards, where the profile states no limits."""
    found = {}
    for name, spec in inputs.items():
        if isinstance(spec, Mapping) and spec.get("limits") is not None:
            continue
        columns = [r.u[:, r.input_names.index(name)] for r in recordings if name in r.input_names]
        values = np.concatenate(columns) if columns else np.zeros(0)
        values = values[np.isfinite(values)]
        if len(values):
            found[name] = (0.0 - round_up(-float(values.min())), round_up(float(values.max())))
    return found


def round_up(value: float, digits: int = 2) -> float:
    """The next value upwards with ``digits`` significant digits; 0 for what is rounding of a solver."""
    if abs(value) < _NOTHING:
        return 0.0
    step = 10.0 ** (np.floor(np.log10(abs(value))) - digits + 1)
    return float(f"{np.ceil(value / step - 1e-9) * step:.{digits + 2}g}")


def _identifier(name: str) -> str:
    text = re.sub(r"[^A-Za-z0-9_.-]+", "-", name).strip("-.") or "vehicle"
    return text if ID_PATTERN.fullmatch(text) else "vehicle"


def _same_columns(field: str, recordings: list[Recording]) -> None:
    for other in recordings[1:]:
        ours = recordings[0].state_names if field == "state" else recordings[0].input_names
        theirs = other.state_names if field == "state" else other.input_names
        if ours != theirs:
            raise ProfileError(
                f"{field}: {recordings[0].name} has the columns {list(ours)}, {other.name} {list(theirs)}: "
                f"name the wanted ones in the profile"
            )


def _quantity(name: str, unit: str, field: str) -> Any:
    angle = field == "state" and unit == "rad" and _ANGLE.search(name) and not _RATE.search(name)
    return {"unit": unit, "angle": True} if angle else unit


def _with_units(specs: Mapping[str, Any], units: Mapping[str, str], field: str) -> dict[str, Any]:
    """The quantities with the recorded unit where none is given."""
    filled = {}
    for name, spec in specs.items():
        if spec is None and name in units:
            spec = _quantity(name, units[name], field)
        elif isinstance(spec, Mapping) and "unit" not in spec and name in units:
            spec = {"unit": units[name], **spec}
        filled[name] = spec
    return filled


def _roles(state: Mapping[str, Any], inputs: Mapping[str, Any]) -> dict[str, Any]:
    names = {name.lower(): name for name in state}
    angles = [n for n, spec in state.items() if isinstance(spec, Mapping) and spec.get("angle")]
    roles: dict[str, Any] = {}
    for pair in _POSITIONS:
        if set(pair) <= names.keys():
            roles["position"] = [names[pair[0]], names[pair[1]]]
            break
    for role, known in (("speed", _SPEEDS), ("lateral_speed", _LATERAL), ("yaw_rate", _YAW_RATES)):
        if found := [names[n] for n in known if n in names]:
            roles[role] = found[0]
    headings = [names[n] for n in _HEADINGS if n in names and names[n] in angles]
    if headings or len(angles) == 1:
        roles["heading"] = (headings or angles)[0]
    if steering := [name for name in inputs if _STEERING.search(name)]:
        roles["steering"] = steering[0]
    return roles
