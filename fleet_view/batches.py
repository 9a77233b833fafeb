"""How long a server computes: tubes of one batch carry one time, by which they are told apart from the next."""

from collections import deque
from dataclasses import dataclass
from typing import Final

#: Batches that are kept of one server, whatever their number in the window.
MOST: Final = 1000


@dataclass(frozen=True, slots=True)
class Compute:
    """Means over the window: seconds a batch, tubes a batch, seconds a tube; NaN where no batch was complete."""

    batch: float
    tubes: float
    tube: float


class Batches:
    """Batches of one server over the last ``window`` seconds, at most ``MOST``.

    Tubes of a batch come one after the other. The newest batch counts once the next one has begun: before that, nobody
    knows how many tubes it has.
    """

    def __init__(self, window: float) -> None:
        self._window = window
        self._whole: deque[tuple[float, float, int]] = deque(maxlen=MOST)
        self._seconds = float("nan")
        self._tubes = 0
        self._whole_from_here = False

    def tube(self, seconds: float, now: float) -> None:
        """A tube came whose batch took ``seconds``."""
        if seconds == self._seconds:
            self._tubes += 1
            return
        # Of the first batch that is heard, part may have come before.
        if self._whole_from_here and self._tubes:
            self._whole.append((now, self._seconds, self._tubes))
        self._whole_from_here = self._tubes > 0
        self._seconds, self._tubes = seconds, 1

    def gap(self) -> None:
        """Tubes were passed over: what is known of the batch under way is not all of it."""
        self._seconds, self._tubes, self._whole_from_here = float("nan"), 0, False

    def compute(self, now: float) -> Compute:
        """What the batches of the window took."""
        while self._whole and self._whole[0][0] < now - self._window:
            self._whole.popleft()
        count = len(self._whole)
        if not count:
            return Compute(float("nan"), float("nan"), float("nan"))
        seconds = sum(taken for _, taken, _ in self._whole)
        tubes = sum(size for _, _, size in self._whole)
        return Compute(seconds / count, tubes / count, seconds / tubes)
