"""A profile completed from what a recording says: columns, units, roles by the names that the field uses."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from fleet_bus.errors import ProfileError
from fleet_bus.keys import ID_PATTERN
from fleet_lab.identification.motion import agreement
from fleet_lab.identification.names import in_words, may_be_speeds, quantity, roles_of
from vehicle_agent.recording import Recording

_NOTHING: Final = 1e-12
#: How far the way that the positions move may be from that by a speed for it to be the speed of the vehicle.
_ALIKE: Final = 1.3


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
            empty = _never_recorded(recordings) if field == "inputs" else []
            why = "columns recorded" + (f"; NaN throughout, left out: {', '.join(empty)}" if empty else "")
            found = {n: quantity(n, u, field) for n, u in zip(names, units, strict=True) if n not in empty}
            guess(field, found, why)
        elif isinstance(fields[field], Mapping):
            fields[field] = _with_units(fields[field], dict(zip(names, units, strict=True)), field)
    if "roles" not in fields and isinstance(fields["state"], Mapping):
        roles = roles_of(fields["state"], fields["inputs"] if isinstance(fields["inputs"], Mapping) else {})
        why = f"by name: {in_words(roles)}" if roles else "no known names"
        if "speed" not in roles and (moving := _moves_as(recordings, fields["state"], roles)) is not None:
            roles["speed"] = moving
            why += f"; {moving} as speed, because the position moves by it"
        guess("roles", roles, why)
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


def _never_recorded(recordings: list[Recording]) -> list[str]:
    """Inputs that are NaN in all rows."""
    missing = np.isnan(np.concatenate([recording.u for recording in recordings])).all(axis=0)
    return [name for i, name in enumerate(recordings[0].input_names) if missing[i]]


def _moves_as(recordings: list[Recording], state: Mapping[str, Any], roles: Mapping[str, Any]) -> str | None:
    """The state without role by which the positions move, if it is one."""
    there = set(recordings[0].state_names).intersection(*(recording.state_names for recording in recordings))
    if not there.issuperset(roles.get("position", [""])):
        return None
    found = []
    for name in may_be_speeds({n: spec for n, spec in state.items() if n in there}, roles):
        ratio = agreement(recordings, roles["position"], name)
        if ratio is not None and 1 / _ALIKE <= ratio <= _ALIKE:
            found.append(name)
    return found[0] if len(found) == 1 else None


def _with_units(specs: Mapping[str, Any], units: Mapping[str, str], field: str) -> dict[str, Any]:
    """The quantities with the recorded unit where none is given."""
    filled = {}
    for name, spec in specs.items():
        if spec is None and name in units:
            spec = quantity(name, units[name], field)
        elif isinstance(spec, Mapping) and "unit" not in spec and name in units:
            spec = {"unit": units[name], **spec}
        filled[name] = spec
    return filled
