"""The contract on the bus: key expressions, messages, sessions, publishing and the embedded router."""

from fleet_bus import keys, messages
from fleet_bus.errors import FleetError, MessageError, SessionError, UsageError
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
