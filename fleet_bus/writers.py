"""One writer a key: who writes, who else tries to, and when another may take over. No clock: times are handed in.

This finds accidents and simple forgery: two agents of one id, a second service, a stray put. A sender names itself, so
it keeps nobody out; that is what the router's access control is for (docs: how-to/deploy).
"""

from dataclasses import dataclass
from enum import Enum
from typing import Final, NamedTuple

#: Messages of a second source, and of the first one after them, that make two writers out of a stray message.
EVIDENCE: Final = 2


class Source(NamedTuple):
    """Who writes: the id of a Zenoh session, and the epoch of an agent's start where there is one."""

    session: str
    epoch: int = 0

    def __str__(self) -> str:
        name = f"session {self.session[:8]}" if self.session else "an unnamed session"
        return f"{name}, epoch {self.epoch}" if self.epoch else name


class Turn(Enum):
    """What is to be done with a message."""

    ACCEPT = "accept"
    #: Its source is not the writer, but may turn out to be its successor.
    HOLD = "hold"
    #: Its source is neither the writer nor the one that may follow.
    REFUSE = "refuse"


class Change(Enum):
    """What a message, or time, has changed."""

    NONE = "none"
    #: The writer has been silent while another source wrote: that one is the writer now.
    TAKEN_OVER = "taken over"
    #: Two sources write at the same time.
    CONFLICT = "conflict"
    #: Of two sources that wrote at the same time the writer is left.
    STAYED = "stayed"
    #: Of two sources that wrote at the same time the other one is left: it is the writer now.
    LOST = "lost"
    #: A second source has been silent again before anything came of it.
    DISMISSED = "dismissed"


@dataclass(slots=True)
class Writer:
    """The one source that may write to a key, and the one beside it that may come to.

    The first source that is heard is the writer. What another one sends is held back until the writer has been silent
    for ``patience`` seconds, a start of an agent that follows another for instance; then the other takes over. If the
    writer goes on while the other is there, that is a conflict, until one of the two has been silent for ``leave``
    seconds.
    """

    evidence: int = EVIDENCE
    source: Source | None = None
    heard: float = -float("inf")
    rival: Source | None = None
    rival_heard: float = -float("inf")
    conflict: bool = False
    _rival_count: int = 0
    _count_since: int = 0

    def judge(self, source: Source, count: int, now: float, patience: float, leave: float) -> tuple[Turn, Change]:
        """What to do with ``count`` messages of a source at ``now`` (s), and what has changed by them."""
        if self.source is None:
            self.source, self.heard = source, now
            return Turn.ACCEPT, Change.NONE
        if source == self.source:
            self.heard = now
            return Turn.ACCEPT, self._go_on(count, now, leave)
        if self.rival is not None and source != self.rival:
            if now - self.rival_heard <= leave:
                return Turn.REFUSE, Change.NONE
            self._dismiss()
        if self.rival is None:
            self.rival, self._rival_count, self._count_since = source, 0, 0
        self._rival_count += count
        self.rival_heard = now
        if now - self.heard > (leave if self.conflict else patience):
            return Turn.ACCEPT, self._take_over()
        return Turn.HOLD, Change.NONE

    def elapse(self, now: float, patience: float, leave: float) -> Change:
        """What has changed because of who has been silent until ``now`` (s)."""
        if self.rival is None:
            return Change.NONE
        if self.rival_heard >= self.heard and now - self.heard > (leave if self.conflict else patience):
            return self._take_over()
        if now - self.rival_heard > leave:
            return self._dismiss()
        return Change.NONE

    def there(self, now: float, leave: float) -> bool:
        """Whether the writer was heard within ``leave`` seconds."""
        return self.source is not None and now - self.heard <= leave

    def _go_on(self, count: int, now: float, leave: float) -> Change:
        if self.rival is None:
            return Change.NONE
        if now - self.rival_heard > leave:
            return self._dismiss()
        self._count_since += count
        if not self.conflict and min(self._rival_count, self._count_since) >= self.evidence:
            self.conflict = True
            return Change.CONFLICT
        return Change.NONE

    def _take_over(self) -> Change:
        change = Change.LOST if self.conflict else Change.TAKEN_OVER
        self.source, self.heard = self.rival, self.rival_heard
        self._forget_rival()
        return change

    def _dismiss(self) -> Change:
        change = Change.STAYED if self.conflict else Change.DISMISSED
        self._forget_rival()
        return change

    def _forget_rival(self) -> None:
        self.rival, self.rival_heard, self.conflict = None, -float("inf"), False
        self._rival_count = self._count_since = 0
