"""How many messages and bytes came on each key, over a sliding window. No clock: times are handed in."""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from fleet_view.rows import Rows

#: Seconds of one bucket: the window slides by as much at a time.
BUCKET: Final = 1.0


@dataclass(frozen=True, slots=True)
class Flow:
    """Messages and bytes on some keys: a second, over the window, and in all."""

    messages_per_second: float
    bytes_per_second: float
    messages: int
    bytes: int


class Traffic:
    """Messages and bytes by key over the last ``window`` seconds, at most ``most`` keys.

    Keys beyond that are counted together, under the empty key.
    """

    def __init__(self, window: float = 10.0, most: int = 100_000) -> None:
        self._buckets = max(1, math.ceil(window / BUCKET))
        # One bucket more than the window has: the one that is being filled.
        ring = np.zeros((self._buckets + 1, 2), dtype=np.int64)
        self._rows = Rows({"ring": ring, "total": np.zeros(2, dtype=np.int64)}, most)
        self._rest = np.zeros_like(ring)
        self._rest_total = np.zeros(2, dtype=np.int64)
        self._gone = np.zeros(2, dtype=np.int64)
        self._began: float | None = None
        self._now = 0

    def count(self, key: str, size: int, now: float) -> None:
        """A message of ``size`` bytes came on a key at ``now`` (s)."""
        self._move(now)
        index = self._rows.row(key)
        ring, total = (
            (self._rest, self._rest_total) if index is None else (self._rows["ring"][index], self._rows["total"][index])
        )
        ring[self._now % len(ring)] += 1, size
        total += 1, size

    def flows(self, keys: Iterable[str], now: float) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Messages and bytes a second (K, 2), and in all (K, 2), of each key; zero for keys on which nothing came."""
        self._move(now)
        found = [self._rows.find(key) for key in keys]
        index = np.array([-1 if row is None else row for row in found], dtype=np.intp)
        known = (index >= 0)[:, None]
        rates = self._rate(self._rows["ring"][index], now)
        return np.where(known, rates, 0.0), np.where(known, self._rows["total"][index], 0)

    def total(self, now: float) -> Flow:
        """All keys together."""
        self._move(now)
        rate = self._rate(self._rows["ring"].sum(axis=0) + self._rest, now)
        total = self._rows["total"].sum(axis=0) + self._rest_total + self._gone
        return Flow(float(rate[0]), float(rate[1]), int(total[0]), int(total[1]))

    def by_kind(self, now: float) -> dict[str, Flow]:
        """Keys of each kind together: by ``kind_of`` the key."""
        self._move(now)
        used = self._rows.used()
        kinds: dict[str, list[int]] = {}
        for index in used.tolist():
            kinds.setdefault(kind_of(self._rows.names[index] or ""), []).append(index)
        flows = {}
        for kind, rows in sorted(kinds.items()):
            rate = self._rate(self._rows["ring"][rows].sum(axis=0), now)
            total = self._rows["total"][rows].sum(axis=0)
            flows[kind] = Flow(float(rate[0]), float(rate[1]), int(total[0]), int(total[1]))
        return flows

    def forget(self, keys: Iterable[str]) -> None:
        """Keys that are gone; what came on them stays in the total."""
        gone = [key for key in keys if key in self._rows]
        rows = [index for key in gone if (index := self._rows.find(key)) is not None]
        self._gone = self._gone + self._rows["total"][rows].sum(axis=0)
        self._rows.forget(gone)

    def _rate(self, rings: NDArray[np.int64], now: float) -> NDArray[np.float64]:
        """Per second, of rings (..., buckets, 2): over the window, or over what has passed of it."""
        assert self._began is not None
        # The bucket being filled counts for the part of it that has passed; the oldest one is then still whole.
        seconds = min(now - self._began, self._buckets * BUCKET + now - self._now * BUCKET)
        # Below one bucket a single message would look like a rate.
        return np.asarray(rings.sum(axis=-2) / max(seconds, BUCKET))

    def _move(self, now: float) -> None:
        """Empty the buckets that the window has left behind."""
        bucket = math.floor(now / BUCKET)
        if self._began is None:
            self._began, self._now = now, bucket
        passed = min(bucket - self._now, self._buckets + 1)
        if passed <= 0:
            return
        stale = np.arange(bucket - passed + 1, bucket + 1) % (self._buckets + 1)
        self._rows["ring"][:, stale] = 0
        self._rest[stale] = 0
        self._now = bucket


def kind_of(key: str) -> str:
    """What kind of message a key has: ``state``, ``truth``, ``profile``, ``document``, ``assignment``, ``tube``,
    ``event`` or ``status``; ``other`` for keys that are none of the contract."""
    chunks = key.split("/")
    if len(chunks) == 3 and chunks[0] in ("fleet", "reach", "spec"):
        kind = chunks[2]
    elif len(chunks) == 4 and chunks[0] in ("svc", "spec"):
        kind = chunks[3] if chunks[0] == "svc" else chunks[2]
    else:
        return "other"
    return kind if kind in _KINDS else "other"


_KINDS: Final = frozenset({"state", "truth", "profile", "document", "assignment", "tube", "event", "status"})
