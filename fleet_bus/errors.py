"""The errors of the project: one small hierarchy, each message names the value, the expected and what to do."""


class FleetError(Exception):
    """Base of every error that the project raises on purpose (exit code 1 of the command)."""


class UsageError(FleetError):
    """The caller asked for something that cannot be meant (exit code 2 of the command)."""


class SessionError(FleetError):
    """No connection to the bus: no router, a port in use, a closed session."""


class Stopped(SessionError):  # noqa: N818 - asked for, no fault
    """No connection, since its caller was told to end while it waited for one."""


class KeyIdError(UsageError, ValueError):
    """An id that cannot be one chunk of a key expression."""


class ProfileError(UsageError, ValueError):
    """A vehicle profile that is unreadable, incomplete or contradicts itself."""


class ScenarioError(UsageError, ValueError):
    """A scenario document that is unreadable, incomplete or contradicts itself."""


class RecordingError(UsageError, ValueError):
    """A recording that cannot be read or does not fit its profile."""


def in_words(error: Exception) -> str:
    """Why a file cannot be read or written, without the numbers that Python puts before it."""
    if isinstance(error, UnicodeDecodeError):
        return "it is not UTF-8 text"
    if isinstance(error, OSError) and error.strerror:
        return error.strerror[0].lower() + error.strerror[1:]
    return str(error)


class MessageError(FleetError, ValueError):
    """A message that cannot be accepted; ``reason`` is the name under which it is counted."""

    def __init__(self, reason: str, detail: str) -> None:
        super().__init__(f"{reason}: {detail}")
        self.reason = reason
        self.detail = detail
