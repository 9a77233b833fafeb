"""Whether a server keeps up: how long samples waited until their tubes were published."""

from dataclasses import dataclass
from typing import Final

#: Seconds between the arrival of a sample and its tube beyond which the server is behind, and rounds in a row that
#: make it news.
LATE: Final = 0.5
ROUNDS: Final = 3


@dataclass(slots=True)
class Load:
    """``behind`` (s): how old the oldest sample of the last round was, from its arrival, when its tubes were out."""

    behind: float = 0.0
    late: bool = False
    _rounds: int = 0

    def see(self, behind: float) -> bool:
        """Take in a round; whether it is news that the server is behind, or that it keeps up again."""
        self.behind = behind
        other = behind <= LATE / 2 if self.late else behind > LATE
        self._rounds = self._rounds + 1 if other else 0
        if self._rounds < ROUNDS:
            return False
        self._rounds, self.late = 0, not self.late
        return True

    @property
    def note(self) -> str | None:
        """What tubes of the last round have to say, if they are late."""
        return f"published {self.behind:.1f} s late" if self.behind > LATE else None

    @property
    def message(self) -> str:
        """What is to be told of the server."""
        if self.late:
            return (
                f"the server is behind: tubes are published {self.behind:.1f} s after their samples came "
                f"(bound {LATE:g} s); give it fewer vehicles, or a shorter horizon"
            )
        return "the server keeps up again"
