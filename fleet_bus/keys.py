"""Key expressions of the bus: role first, one id per chunk, no version in the key (docs/reference/wire.md)."""

import re
from typing import Final

from fleet_bus.errors import KeyIdError

ID_PATTERN: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}")

ALL_STATES: Final = "fleet/*/state"
ALL_PROFILES: Final = "fleet/*/profile"
ALL_ALIVE: Final = "fleet/*/alive"
ALL_TRUTHS: Final = "fleet/*/truth"
ALL_DOCUMENTS: Final = "spec/*/document"
ALL_ASSIGNMENTS: Final = "spec/*/assignment/*"
ALL_TUBES: Final = "reach/*/tube"
ALL_EVENTS: Final = "reach/*/event"
ALL_STATUS: Final = "svc/*/*/status"
ALL_SERVICE_EVENTS: Final = "svc/*/*/event"
ALL_JOURNALS: Final = "svc/reach/*/journal"
ALL_CHECKPOINTS: Final = "svc/reach/*/checkpoint"
ALL_RECORDERS: Final = "svc/recorder/*"


def check_id(text: str, what: str = "vehicle") -> str:
    """Return ``text`` unchanged if it can be one chunk of a key; raise ``KeyIdError`` otherwise.

    Zenoh itself would accept blanks, newlines and NUL, and hides a chunk that begins with ``@`` from
    wildcards; here an id is a letter or digit followed by at most 63 of ``A-Z a-z 0-9 _ . -``.
    """
    if ID_PATTERN.fullmatch(text) is None:
        raise KeyIdError(
            f"{what} id {text!r:.80} is not usable in a key: give a letter or digit followed by at most "
            "63 letters, digits, '_', '.' or '-'"
        )
    return text


def state(vehicle: str) -> str:
    """Key of the filtered states and inputs of a vehicle."""
    return f"fleet/{check_id(vehicle)}/state"


def truth(vehicle: str) -> str:
    """Key of the true states of a simulated vehicle (only simulators publish it)."""
    return f"fleet/{check_id(vehicle)}/truth"


def profile(vehicle: str) -> str:
    """Key of the profile of a vehicle."""
    return f"fleet/{check_id(vehicle)}/profile"


def alive(vehicle: str) -> str:
    """Key of the liveliness token of a vehicle."""
    return f"fleet/{check_id(vehicle)}/alive"


def document(scenario: str) -> str:
    """Key of a scenario document."""
    return f"spec/{check_id(scenario, 'scenario')}/document"


def assignment(scenario: str, vehicle: str) -> str:
    """Key of the assignment of a vehicle to a scenario."""
    return f"spec/{check_id(scenario, 'scenario')}/assignment/{check_id(vehicle)}"


def tube(vehicle: str) -> str:
    """Key of the reach tubes of a vehicle."""
    return f"reach/{check_id(vehicle)}/tube"


def event(vehicle: str) -> str:
    """Key of the events about a vehicle."""
    return f"reach/{check_id(vehicle)}/event"


def service(kind: str, instance: str) -> str:
    """Key of the liveliness token of a service instance."""
    return f"svc/{check_id(kind, 'service kind')}/{check_id(instance, 'service')}"


def service_status(kind: str, instance: str) -> str:
    """Key of the status of a service instance."""
    return f"{service(kind, instance)}/status"


def service_event(kind: str, instance: str) -> str:
    """Key of the events about a service instance itself."""
    return f"{service(kind, instance)}/event"


def journal(instance: str) -> str:
    """Key of the journal of a reach server: what it took in, in which order."""
    return f"{service('reach', instance)}/journal"


def checkpoint(instance: str) -> str:
    """Key of the checkpoints of a reach server."""
    return f"{service('reach', instance)}/checkpoint"


def vehicle_of(key: str) -> str:
    """Vehicle id of a key below ``fleet/``, ``reach/`` or of an assignment; raise ``KeyIdError`` if there is none."""
    chunks = key.split("/")
    if len(chunks) >= 3 and chunks[0] in ("fleet", "reach"):
        return check_id(chunks[1])
    if len(chunks) == 4 and chunks[0] == "spec" and chunks[2] == "assignment":
        return check_id(chunks[3])
    raise KeyIdError(f"key {key!r:.120} names no vehicle: expected fleet/<vehicle>/… or reach/<vehicle>/…")
