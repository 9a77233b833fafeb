"""``ReachTube``: where one vehicle can be at each step of the horizon, with its label and its record."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from operator import attrgetter
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

from fleet_bus import codec, keys
from fleet_bus.errors import MessageError
from fleet_bus.messages import ranges
from fleet_bus.messages.fields import Field, FieldList
from fleet_bus.messages.kinds import Array, Number, Row, Rows, Text, TextMap, Texts, Whole
from fleet_bus.messages.methods import FROM_LIMITS, TUBE_METHODS

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
        self._check_audit()
        return codec.pack(FIELDS.pack(self), limit=MAX_BYTES)

    @classmethod
    def decode(cls, payload: bytes, encoding: str = ENCODING) -> Self:
        """Read one payload; raise ``MessageError`` with the reason if it is not a sound tube."""
        codec.check_encoding(encoding, SCHEMA, VERSION)
        found = cls(**FIELDS.read(codec.unpack(payload, limit=MAX_BYTES)))
        FIELDS.check(found)
        found._check_audit()
        return found

    def _check_audit(self) -> None:
        audit = self.audit
        if not (audit.inside <= audit.checked and audit.recent_inside <= audit.recent <= audit.checked):
            raise MessageError("range", "more of the audit were inside than checked, or recent than all")


_STEP: Final = Whole(ranges.STEP)
_COUNT: Final = Whole(ranges.COUNTER)
_INDEX: Final = Whole(ranges.INDEX)
_AREA: Final = Array("<f8", ("h",), ranges.AREA)


def _set(dtype: str, *shape: str) -> Array:
    return Array(dtype, shape, ranges.SET_VALUE)


#: What encoder, decoder, checks, JSON Schema and docs/reference/wire.md follow: h steps, n states, g generators, K
#: vertices.
FIELDS: Final = FieldList(
    Field("v", "vehicle", Text(pattern=keys.ID_PATTERN), "", "id of the vehicle, the same as in the key"),
    Field("e", "epoch", Whole(ranges.EPOCH), "", "epoch of the sample that the tube starts from"),
    Field("s", "seq", Whole(ranges.SEQ), "", "seq of that sample"),
    Field("t", "t", Whole(ranges.TIME), "ns", "time of that sample"),
    Field("T", "times", Array("<i8", ("h",), ranges.AHEAD, ranges.STEP), "ns", "time of each step"),
    Field("x", "state_names", Texts(ranges.STATES, size="n"), "", "names of the n states, in order"),
    Field(
        "p", "position", Row((_INDEX, _INDEX), lambda *indices: indices, tuple, below="n"),
        "", "indices (from 0) of the two position states",
    ),
    Field(
        "m", "method", Text(TUBE_METHODS), "", f"how the sets came about; `{FROM_LIMITS}`: from limits, without a model"
    ),
    Field("l", "label", Text(tuple(map(str, Label)), make=Label), "", "what the tube claims"),
    Field("c", "center", _set("<f8", "h", "n"), "of the state", "center of the set of each step"),
    Field(
        "g", "generators", _set("<f4", "h", "n", "g"),
        "of the state", "the zonotope {c + G b : every abs(b_i) ≤ 1} contains the set",
    ),
    Field(
        "h", "hull", _set("<f4", "h", "2", "n"),
        "of the state", "lower bounds, then upper bounds, relative to the center",
    ),
    Field(
        "o", "outline", _set("<f4", "h", "K", "2"),
        "of the position", "convex polygon around the positions, counter-clockwise, relative to the center",
    ),
    Field("a", "area", _AREA, "squared position", "upper bound of the area of the position set"),
    Field("af", "area_free", _AREA, "squared position", "the same without side information"),
    Field(
        "k", "cuts",
        Rows(Row((Text(), Text(), _STEP, _STEP), Cut, attrgetter("scenario", "predicate", "first", "last"))),
        "", "scenario, predicate, first step, last step (from 1, inclusive) of each predicate that made sets smaller",
    ),
    Field("n", "notes", Texts(), "", "limitations in words"),
    Field("vd", "verdicts", TextMap(), "", "`<scenario>.<requirement>` to its verdict"),
    Field(
        "au", "audit",
        Row(
            (_COUNT, _COUNT, Number(ranges.MISS), _COUNT, _COUNT, _COUNT), Audit,
            attrgetter("checked", "inside", "last_miss", "recent", "recent_inside", "band"),
        ),
        "of the state (the third)",
        "one-step predictions checked, how many held, by how much the last miss lay outside (largest component); of "
        "the newest checks, at most 1000, how many there are, how many held, and how many misses among them the "
        "confidence explains",
    ),
    Field("sv", "server", Text(), "", "id of the server"),
    Field("se", "server_epoch", Whole(ranges.EPOCH), "ns", "when that server started"),
    Field("ct", "compute_seconds", Number(ranges.DURATION), "s", "time that the batch with this tube took to compute"),
)  # fmt: skip
