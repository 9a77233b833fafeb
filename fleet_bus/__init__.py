"""The contract on the bus: key expressions, messages, sessions, publishing and the embedded router.

Names come when they are asked for: keys and errors load neither Zenoh nor pydantic.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from fleet_bus.errors import FleetError, MessageError, SessionError, UsageError

if TYPE_CHECKING:
    from fleet_bus import keys, messages
    from fleet_bus.sessions import Role, open_session

__all__ = [
    "FleetError",
    "MessageError",
    "Role",
    "SessionError",
    "UsageError",
    "keys",
    "messages",
    "open_session",
]


def __getattr__(name: str) -> Any:
    if name in ("keys", "messages"):
        return import_module(f"{__name__}.{name}")
    if name in ("Role", "open_session"):
        return getattr(import_module("fleet_bus.sessions"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
