"""``ReachTube``: where one vehicle can be at each step of the horizon, with its label and its record."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, Final, Self

import numpy as np
from numpy.typing import NDArray

from fleet_bus import codec, keys
from fleet_bus.errors import MessageError
from fleet_bus.messages import ranges
from fleet_bus.messages.methods import TUBE_METHODS

SCHEMA: Final = "fleet.tube"
VERSION: Final = 1
ENCODING: Final = codec.encoding(SCHEMA, VERSION)
MAX_BYTES: Final = int(ranges.TUBE_BYTES.high)
MAX_HORIZON: Final = int(ranges.STEP.high)


class Label(StrEnum):
    """What a tube claims (docs: concepts/guarantees)."""

    GUARANTEED = "guaranteed"
    CALIBRATED = "calibrated"
    UNCOVERED = "uncovered"
    CONTRADICTED = "contradicted"


@dataclass(frozen=True, slots=True)
class Cut:
    """A predicate of a scenario that made the sets of steps ``first`` to ``last`` (inclusive) smaller."""

    scenario: str
    predicate: str
    first: int
    last: int


@dataclass(frozen=True, slots=True)
class Audit:
    """One-step predictions checked against what was measured, since the vehicle or its profile came.

    ``last_miss`` is by how much the last miss lay outside: its greatest excess of a component over the set's interval
    hull, in the unit of that component. ``recent`` (at most 1000) are the newest checks, of which ``recent_inside``
    held and at most ``band`` may miss before the record is called outside of its band.
    """

    checked: int = 0
    inside: int = 0
    last_miss: float = 0.0
    recent: int = 0
    recent_inside: int = 0
    band: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class ReachTube:
    """Sets of one vehicle at ``times`` (h,) in ns, computed from the sample ``(epoch, seq)`` taken at ``t`` (ns).

    What is claimed is what ``label`` says. Three forms hold all states that it speaks about, in the units of the
    profile: ``center`` (h, n) and ``generators`` (h, n, g) a zonotope, ``hull`` (h, 2, n) a box relative to the center,
    ``outline`` (h, K, 2) a convex polygon of the two position states relative to the center. Each is an outer bound of
    the set that was computed. ``area`` (h,) is that of the position set, in squared position units, ``area_free`` (h,)
    the one without side information.
    """

    vehicle: str
    epoch: int
    seq: int
    t: int
    times: NDArray[np.int64]
    state_names: tuple[str, ...]
    position: tuple[int, int]
    method: str
    label: Label
    center: NDArray[np.float64]
    generators: NDArray[np.float64]
    hull: NDArray[np.float64]
    outline: NDArray[np.float64]
    area: NDArray[np.float64]
    area_free: NDArray[np.float64]
    cuts: tuple[Cut, ...] = ()
    notes: tuple[str, ...] = ()
    verdicts: Mapping[str, str] = field(default_factory=dict)
    audit: Audit = Audit()
    server: str = ""
    server_epoch: int = 0
    compute_seconds: float = 0.0

    def encode(self) -> bytes:
        """Payload of this tube (encoding ``fleet.tube.v1``); raise ``MessageError`` for a number outside of its range
        and for too many bytes."""
        self._check()
        return codec.pack(
            {
                "v": self.vehicle,
                "e": self.epoch,
                "s": self.seq,
                "t": self.t,
                "T": codec.to_bin(self.times, "<i8"),
                "x": list(self.state_names),
                "p": list(self.position),
                "m": self.method,
                "l": str(self.label),
                "c": codec.to_bin(self.center),
                "g": codec.to_bin(self.generators, "<f4"),
                "h": codec.to_bin(self.hull, "<f4"),
                "o": codec.to_bin(self.outline, "<f4"),
                "a": codec.to_bin(self.area),
                "af": codec.to_bin(self.area_free),
                "k": [[cut.scenario, cut.predicate, cut.first, cut.last] for cut in self.cuts],
                "n": list(self.notes),
                "vd": dict(self.verdicts),
                "au": [
                    self.audit.checked,
                    self.audit.inside,
                    float(self.audit.last_miss),
                    self.audit.recent,
                    self.audit.recent_inside,
                    self.audit.band,
                ],
                "sv": self.server,
                "se": self.server_epoch,
                "ct": float(self.compute_seconds),
            },
            limit=MAX_BYTES,
        )

    @classmethod
    def decode(cls, payload: bytes, encoding: str = ENCODING) -> Self:
        """Read one payload; raise ``MessageError`` with the reason if it is not a sound tube."""
        codec.check_encoding(encoding, SCHEMA, VERSION)
        fields = codec.unpack(payload, limit=MAX_BYTES)
        codec.check_fields(fields, _FIELDS)
        times, names, position = fields["T"], fields["x"], fields["p"]
        steps, n = len(times) // 8, len(names)
        if not 1 <= steps <= MAX_HORIZON or len(times) % 8:
            raise MessageError("shape", f"{len(times)} bytes of times")
        if not 1 <= n <= 32 or not all(isinstance(name, str) for name in names):
            raise MessageError("fields", "state names 'x' must be 1 to 32 texts")
        if len(position) != 2 or not all(type(i) is int and 0 <= i < n for i in position):
            raise MessageError("range", f"position {position!r:.40} must be two indices below {n}")
        if fields["l"] not in set(Label):
            raise MessageError("range", f"label {fields['l']!r:.40} is none of {[str(label) for label in Label]}")
        if fields["m"] not in TUBE_METHODS:
            raise MessageError("range", f"method {fields['m']!r:.40} is none of {list(TUBE_METHODS)}")
        generators = len(fields["g"]) // (4 * steps * n)
        vertices = len(fields["o"]) // (4 * steps * 2)
        cuts = tuple(Cut(*_row(cut, "k", (str, str, int, int))) for cut in fields["k"])
        checked, inside, miss, *rolling = _row(fields["au"], "au", (int, int, float, int, int, int))
        audit = Audit(checked, inside, float(miss), *rolling)
        if not all(isinstance(text, str) for text in (*fields["n"], *fields["vd"], *fields["vd"].values())):
            raise MessageError("fields", "notes 'n' and verdicts 'vd' must be texts")
        if keys.ID_PATTERN.fullmatch(fields["v"]) is None:
            raise MessageError("fields", f"vehicle {fields['v']!r:.80} cannot be an id")
        found = cls(
            fields["v"], fields["e"], fields["s"], fields["t"],
            codec.from_bin(fields, "T", (steps,), "<i8"),
            tuple(names), (position[0], position[1]), fields["m"], Label(fields["l"]),
            codec.from_bin(fields, "c", (steps, n)),
            codec.from_bin(fields, "g", (steps, n, generators), "<f4").astype(np.float64),
            codec.from_bin(fields, "h", (steps, 2, n), "<f4").astype(np.float64),
            codec.from_bin(fields, "o", (steps, vertices, 2), "<f4").astype(np.float64),
            codec.from_bin(fields, "a", (steps,)),
            codec.from_bin(fields, "af", (steps,)),
            cuts, tuple(fields["n"]), fields["vd"], audit,
            fields["sv"], fields["se"], float(fields["ct"]),
        )  # fmt: skip
        found._check()
        return found

    def _check(self) -> None:
        """Raise ``MessageError`` unless every number lies in its range."""
        audit = self.audit
        ranges.EPOCH.check("e", self.epoch)
        ranges.SEQ.check("s", self.seq)
        ranges.TIME.check("t", self.t)
        ranges.EPOCH.check("se", self.server_epoch)
        for name, number, span in (
            ("ct", self.compute_seconds, ranges.DURATION), ("au[2]", audit.last_miss, ranges.MISS),
        ):  # fmt: skip
            if not math.isfinite(number):
                raise MessageError("not_finite", f"{name} is {number}")
            span.check(name, number)
        ranges.AHEAD.check_array("T", self.times)
        ranges.SET_VALUE.check_arrays({"c": self.center, "g": self.generators, "h": self.hull, "o": self.outline})
        ranges.AREA.check_arrays({"a": self.area, "af": self.area_free})
        for cut in self.cuts:
            ranges.STEP.check("k", cut.first)
            ranges.STEP.check("k", cut.last)
        for count in (audit.checked, audit.inside, audit.recent, audit.recent_inside, audit.band):
            ranges.COUNTER.check("au", count)
        if not (audit.inside <= audit.checked and audit.recent_inside <= audit.recent <= audit.checked):
            raise MessageError("range", "more of the audit were inside than checked, or recent than all")


def _row(row: Any, key: str, kinds: tuple[type, ...]) -> list[Any]:
    """A list of values of the given types (an integer may stand for a float); raise ``MessageError`` otherwise."""
    if not isinstance(row, list) or len(row) != len(kinds):
        raise MessageError("fields", f"{key!r} must hold lists of {[kind.__name__ for kind in kinds]}")
    for value, kind in zip(row, kinds, strict=True):
        if type(value) is not kind and not (kind is float and type(value) is int):
            raise MessageError("fields", f"{key!r} holds {type(value).__name__} where {kind.__name__} is expected")
    return row


_FIELDS: Final[Mapping[str, type | tuple[type, ...]]] = {
    "v": str, "e": int, "s": int, "t": int, "T": bytes, "x": list, "p": list, "m": str, "l": str,
    "c": bytes, "g": bytes, "h": bytes, "o": bytes, "a": bytes, "af": bytes, "k": list, "n": list,
    "vd": dict, "au": list, "sv": str, "se": int, "ct": (float, int),
}  # fmt: skip
