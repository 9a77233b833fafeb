"""Everything that the page shows of the vehicles at one instant, as arrays that nobody changes any more."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from enum import IntFlag
from typing import Final

import numpy as np
from numpy.typing import NDArray

from fleet_bus.messages import Label

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Ints = NDArray[np.int64]

#: What the number of a label stands for; the last one is a vehicle without a tube.
LABELS: Final = (*map(str, Label), "no tube")
NO_TUBE: Final = len(LABELS) - 1

#: Seconds of silence after which a vehicle, its tube or a server is shown as stale. A server speaks once a second, so
#: that with the page's own delay a dead one shows within 3 s.
SILENT_SECONDS: Final = 2.5

#: Metres from a vehicle beyond which its sets are not drawn: single precision and the eye end there.
MOST_EXTENT: Final = 1e6


class Mark(IntFlag):
    """What else is to be said of a vehicle."""

    SILENT = 1
    TUBE_OLD = 2
    SERVER_SILENT = 4
    NO_PROFILE = 8
    TOO_LARGE = 16
    NO_POSE = 32
    LEFT = 64
    VIOLATES = 128

    @property
    def words(self) -> str:
        """For a person; empty if nothing is to be said."""
        return "; ".join(_WORDS[mark] for mark in Mark if mark in self)


_WORDS: Final = {
    Mark.SILENT: "no samples come",
    Mark.TUBE_OLD: "no tubes come",
    Mark.SERVER_SILENT: "its server is silent",
    Mark.NO_PROFILE: "no profile has come",
    Mark.TOO_LARGE: "its sets are too large to draw",
    Mark.NO_POSE: "its place is not known",
    Mark.LEFT: "left its scenario",
    Mark.VIOLATES: "violates a requirement",
}
#: Marks that make what is shown stale, and those that say that a vehicle does what it should not.
STALE: Final = Mark.SILENT | Mark.TUBE_OLD | Mark.SERVER_SILENT
ASTRAY: Final = Mark.LEFT | Mark.VIOLATES


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """N vehicles at ``t`` (ns): a row of each array belongs to the vehicle of the same place in ``ids``.

    ``position`` (N, 2) and ``heading`` (N,) come from the newest sample, or where no profile says which states these
    are from the nearest set; NaN if not known. ``sampled`` and ``tubed`` (N,) are when the newest sample and tube
    arrived (ns, 0: never). ``label`` (N,) are places in ``LABELS``, ``marks`` (N,) sums of ``Mark``. ``area`` and
    ``area_free`` (N,) are those of the last step; ``coverage`` of the newest checks and the ``nominal`` one,
    ``latency`` and ``compute`` (N,) in s; NaN where not known. ``steps`` (N,) sets of each are drawn: ``center`` (N, H,
    2), ``outline`` (N, H, K, 2) relative to it, and ``low`` and ``high`` (N, 2) around all of them and the vehicle;
    empty (low above high) where nothing is to be drawn.
    """

    number: int
    t: int
    ids: Sequence[str]
    position: Floats
    heading: Singles
    sampled: Ints
    tubed: Ints
    label: NDArray[np.uint8]
    marks: NDArray[np.uint8]
    area: Floats
    area_free: Floats
    coverage: Singles
    nominal: Singles
    latency: Singles
    compute: Singles
    server: NDArray[np.uint16]
    steps: NDArray[np.uint16]
    center: Floats
    outline: Singles
    low: Floats
    high: Floats
    #: Scenario and predicate that cut the newest tube of some vehicle which is not stale, looked at once a second.
    acting: frozenset[tuple[str, str]] = frozenset()

    def __len__(self) -> int:
        return len(self.label)

    @property
    def nbytes(self) -> int:
        """Bytes of the arrays."""
        return sum(value.nbytes for value in self._values() if isinstance(value, np.ndarray))

    def _values(self) -> list[object]:
        return [getattr(self, field.name) for field in fields(self)]

    def age(self) -> Floats:
        """Seconds since the newest sample of each vehicle, since its tube if no sample has come; NaN for neither
        (N,)."""
        newest = np.where(self.sampled > 0, self.sampled, self.tubed)
        return np.where(newest > 0, (self.t - newest) / 1e9, np.nan)

    def stale(self) -> NDArray[np.bool_]:
        """Whether what is shown of each vehicle is stale (N,)."""
        return np.asarray((self.marks & int(STALE)) != 0)


def nothing(t: int = 0) -> Picture:
    """The picture of no vehicle."""
    none, single = np.zeros(0), np.zeros(0, dtype=np.float32)
    return Picture(
        0, t, (), np.zeros((0, 2)), single, np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64),
        np.zeros(0, dtype=np.uint8), np.zeros(0, dtype=np.uint8), none, none, single, single, single, single,
        np.zeros(0, dtype=np.uint16), np.zeros(0, dtype=np.uint16), np.zeros((0, 1, 2)),
        np.zeros((0, 1, 4, 2), dtype=np.float32), np.zeros((0, 2)), np.zeros((0, 2)),
    )  # fmt: skip
