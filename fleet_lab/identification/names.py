"""Roles of columns by the names that the field uses."""

import re
from collections.abc import Mapping
from typing import Any, Final

from fleet_bus.units import canonical

#: Names by which a role is recognised, in the order of preference; compared in lower case, without separators.
POSITIONS: Final = (
    ("x", "y"), ("px", "py"), ("posx", "posy"), ("positionx", "positiony"), ("posex", "posey"), ("xpos", "ypos"),
    ("x1", "x2"), ("xm", "ym"), ("east", "north"), ("easting", "northing"), ("e", "n"),
)  # fmt: skip
HEADINGS: Final = (
    "yaw", "heading", "theta", "psi", "yawangle", "headingangle", "hdg", "orientation", "course", "th", "phi", "x3",
)  # fmt: skip
SPEEDS: Final = (
    "v", "speed", "vel", "velocity", "vx", "velx", "velocityx", "speedx", "vlon", "vlong", "vehiclespeed", "carspeed",
    "longitudinalspeed", "longitudinalvelocity", "linearvelocity", "linearspeed", "linearvel", "linvel", "linearx",
    "forwardspeed", "forwardvelocity", "groundspeed", "velocitymps", "speedmps", "velmps", "vencoder", "wheelspeed",
    "odomspeed", "odomvel", "odomv", "vodom", "vmeas", "vmeasured", "x4",
)  # fmt: skip
LATERAL: Final = ("vy", "vely", "velocityy", "speedy", "vlat", "lateralspeed", "lateralvelocity", "lineary")
YAW_RATES: Final = (
    "yawrate", "omega", "r", "wz", "omegaz", "angularvelocity", "angularspeed", "angularvel", "angvel", "angularz",
    "angularvelocityz", "gyroz", "turnrate", "yawdot", "thetadot", "psidot", "headingrate", "dyaw", "dtheta", "dpsi",
)  # fmt: skip
STEERING: Final = re.compile(r"steer|delta|curvature|wheel_?angle", re.IGNORECASE)
_ANGLE: Final = re.compile(r"yaw|heading|theta|psi|angle|course|azimuth|hdg|orientation", re.IGNORECASE)
_RATE: Final = re.compile(r"rate|dot|omega|vel|speed", re.IGNORECASE)
#: Units that a speed along the way may have.
_OF_SPEEDS: Final = ("m/s", "km/h", "mm/s", "cm/s")


def plain(name: str) -> str:
    """The name in lower case without what separates its words."""
    return re.sub(r"[^a-z0-9]", "", name.lower())


def is_heading(name: str) -> bool:
    """Whether a state of that name can be the heading."""
    return plain(name) in HEADINGS or bool(_ANGLE.search(name) and not _RATE.search(name))


def quantity(name: str, unit: str, field: str) -> Any:
    """The spec of a column. A heading is an angle in rad, whatever it was recorded in: it has to be converted."""
    if field == "state" and is_heading(name) and canonical(unit) in ("rad", "deg"):
        return {"unit": "rad", "angle": True}
    return unit


def roles_of(state: Mapping[str, Any], inputs: Mapping[str, Any]) -> dict[str, Any]:
    """The roles that the names of states and inputs tell."""
    names = {plain(name): name for name in reversed(list(state))}
    angles = [n for n, spec in state.items() if isinstance(spec, Mapping) and spec.get("angle")]
    roles: dict[str, Any] = {}
    for pair in POSITIONS:
        if set(pair) <= names.keys():
            roles["position"] = [names[pair[0]], names[pair[1]]]
            break
    for role, known in (("speed", SPEEDS), ("lateral_speed", LATERAL), ("yaw_rate", YAW_RATES)):
        if found := [names[n] for n in known if n in names and names[n] not in angles]:
            roles[role] = found[0]
    headings = [names[n] for n in HEADINGS if n in names and names[n] in angles]
    if headings or len(angles) == 1:
        roles["heading"] = (headings or angles)[0]
    if steering := [name for name in inputs if STEERING.search(name)]:
        roles["steering"] = steering[0]
    return roles


def may_be_speeds(state: Mapping[str, Any], roles: Mapping[str, Any]) -> list[str]:
    """States in a unit of speed that have no role."""
    taken = [name for role in roles.values() for name in ([role] if isinstance(role, str) else role)]
    units = {name: spec.get("unit") if isinstance(spec, Mapping) else spec for name, spec in state.items()}
    free = {name: unit for name, unit in units.items() if name not in taken and isinstance(unit, str)}
    return [name for name, unit in free.items() if canonical(unit) in _OF_SPEEDS]


def in_words(roles: Mapping[str, Any]) -> str:
    """Which column was taken for what."""
    named = {role: [names] if isinstance(names, str) else names for role, names in roles.items()}
    return ", ".join(f"{' and '.join(names)} as {role.replace('_', ' ')}" for role, names in named.items())
