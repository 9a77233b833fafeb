"""Recordings published again: the same bytes, in the same order, as fast as is asked for."""

import math
import re
import threading
from collections import Counter
from collections.abc import Iterable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from typing import Final, Self

from fleet_bus import codec, keys
from fleet_bus.bus import Bus, Handle, Publisher
from fleet_bus.clock import SYSTEM, Clock
from fleet_bus.errors import MessageError, UsageError
from fleet_bus.rejections import Rejections
from fleet_recorder import layout
from fleet_recorder.layout import Recorded
from fleet_recorder.shift import shifted

#: Messages that are kept for latecomers, by the last part of the key: a window of states, events, else the newest.
CACHES: Final[Mapping[str, int]] = {"state": 1200, "event": 32}

#: The library was seen to fail over encodings that nobody of the fleet uses.
_ENCODING: Final = re.compile(rf"{re.escape(codec.MEDIA_TYPE)};[a-z_]+(\.[a-z_]+)*\.v[0-9]{{1,4}}")


@dataclass(frozen=True, slots=True)
class Report:
    """What was played: messages published, and those left out by why; ``late`` is how far (s) publishing was behind."""

    published: Mapping[str, int] = field(default_factory=dict)
    left_out: Mapping[str, int] = field(default_factory=dict)
    late: float = 0.0
    ended: bool = True


class Player:
    """Publishes recorded messages on ``bus``; a context manager, at whose end what it published is gone from the bus.

    ``speed`` is how many times faster than recorded, infinity as fast as the bus takes them. Only inputs of a reach
    server are published (states, profiles, documents, assignments, and that vehicles are alive), or ``everything``.
    With ``shift`` the recording begins now: see ``shifted``. All come from one session, whoever put them.

    Raises ``UsageError`` for a speed that is not positive.
    """

    def __init__(
        self,
        bus: Bus,
        *,
        clock: Clock = SYSTEM,
        speed: float = 1.0,
        everything: bool = False,
        shift: bool = False,
    ) -> None:
        if not speed > 0:
            raise UsageError(f"speed {speed} must be positive: 1 plays a recording as it was, max as fast as it goes")
        self._bus = bus
        self._clock = clock
        self._speed = speed
        self._everything = everything
        self._shift = shift
        self._rejections = Rejections(clock.monotonic)
        self._publishers: dict[tuple[str, str], Publisher] = {}
        self._tokens: dict[str, Handle] = {}
        self._declared = ExitStack()

    def play(self, messages: Iterable[Recorded], stop: threading.Event) -> Report:
        """Publish messages as they fall due until they end, or ``stop`` is set; raises what reading them raises.

        What was carried over from before the recording goes out at once. Where the recorder's clock was set back, or
        messages lie out of order, nothing waits. Stamps keep their intervals whatever the speed.
        """
        published: Counter[str] = Counter()
        left_out: Counter[str] = Counter()
        began, late, first_ns, by_ns = self._clock.monotonic(), 0.0, None, 0
        for recorded in messages:
            if first_ns is None:
                first_ns = recorded.logged_ns
                by_ns = self._clock.time_ns() - first_ns if self._shift else 0
            if stop.is_set():
                return Report(published, left_out, late, ended=False)
            why = self._why_not(recorded)
            if why is not None:
                left_out[why] += 1
                continue
            if math.isfinite(self._speed):
                due = began + (recorded.logged_ns - first_ns) / 1e9 / self._speed
                ahead = due - self._clock.monotonic()
                late = max(late, -ahead)
                if ahead > 0 and self._clock.wait(stop, ahead):
                    return Report(published, left_out, late, ended=False)
            self._publish(recorded, by_ns)
            published[family(recorded)] += 1
        return Report(published, left_out, late)

    def _why_not(self, recorded: Recorded) -> str | None:
        """Why a message is not published; None if it is."""
        received = recorded.received
        if not (self._everything or is_input(recorded)):
            return "no input of a server"
        if any(keys.ID_PATTERN.fullmatch(chunk) is None for chunk in received.key.split("/")):
            return "its key is none of the fleet's"
        if received.encoding != layout.TOKEN and _ENCODING.fullmatch(received.encoding) is None:
            return "its encoding is none of the fleet's"
        return None

    def _publish(self, recorded: Recorded, by_ns: int) -> None:
        received = recorded.received
        if received.encoding == layout.TOKEN:
            self._set_token(recorded)
            return
        payload = received.payload
        if by_ns:
            try:
                payload = shifted(received, by_ns)
            except MessageError as error:
                # A server refuses it, as it did when it was recorded.
                self._rejections.count(error, received.key)
        publisher = self._publishers.get((received.key, received.encoding))
        if publisher is None:
            cache = CACHES.get(received.key.rpartition("/")[2], 1)
            # Where one waits for the bus, nothing is lost at any speed.
            publisher = self._bus.publisher(received.key, received.encoding, cache=cache, patient=True)
            self._publishers[received.key, received.encoding] = self._declared.enter_context(publisher)
        publisher.put(payload)

    def _set_token(self, recorded: Recorded) -> None:
        key = recorded.received.key
        try:
            alive = layout.is_alive(recorded.received)
        except MessageError as error:
            self._rejections.count(error, key)
            return
        if alive and key not in self._tokens:
            self._tokens[key] = self._declared.enter_context(self._bus.alive(key))
        elif not alive and key in self._tokens:
            self._tokens.pop(key).close()

    def close(self) -> None:
        """Take everything back from the bus; closing again does nothing."""
        self._declared.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.close()


def is_input(recorded: Recorded) -> bool:
    """Whether a message is what a reach server computes from."""
    return family(recorded) in ("state", "profile", "document", "assignment", "alive")


def family(recorded: Recorded) -> str:
    """What kind of message it is: the part of its key that says so."""
    role, *rest = recorded.received.key.split("/")
    if role == "spec" and len(rest) == 3:
        return rest[1]
    if role == "svc" and len(rest) == 2:
        return "service"
    return rest[-1] if rest else role
