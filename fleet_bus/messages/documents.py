"""Messages that are documents: rare, readable, validated by pydantic; their JSON Schemas are generated from here."""

from enum import StrEnum
from typing import Annotated, Any, ClassVar, Final, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from fleet_bus import codec, keys
from fleet_bus.errors import MessageError
from fleet_bus.messages import ranges

Id = Annotated[str, Field(pattern=f"^{keys.ID_PATTERN.pattern}$")]
Nanoseconds = Annotated[int, ranges.TIME]
Counter = Annotated[int, ranges.COUNTER]

#: Problems of a field that are counted under a reason of their own, where there are several the first.
_REASONS: Final = {"finite_number": "not_finite", ranges.OUTSIDE: "range"}


def explain(error: ValidationError) -> str:
    """The first problems of a validation error in one line: where, what, and what came."""
    parts = []
    for problem in error.errors()[:4]:
        place = ".".join(f"{part!s:.40}" for part in problem["loc"]) or "document"
        # A problem of the document as a whole says itself which values it is about.
        named = problem["type"] == "missing" or not problem["loc"]
        came = "" if named else f" (came: {problem['input']!r:.60})"
        parts.append(f"{place}: {problem['msg'].removeprefix('Value error, ')}{came}")
    more = len(error.errors()) - len(parts)
    return "; ".join(parts) + (f"; and {more} more" if more > 0 else "")


class Document(BaseModel):
    """Base of the messages that are documents: strict fields, no extra ones, bounded size."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False, populate_by_name=True)

    SCHEMA: ClassVar[str]
    VERSION: ClassVar[int] = 1
    MAX_BYTES: ClassVar[int] = 65536

    @classmethod
    def encoding(cls) -> str:
        """Zenoh encoding of this message."""
        return codec.encoding(cls.SCHEMA, cls.VERSION)

    def encode(self) -> bytes:
        """Payload of this message; raise ``MessageError`` where ``decode`` would refuse it."""
        payload = self._packed()
        # A copy with changes is not checked when it is made, and what is sound may be too long to be sent.
        self.decode(payload)
        return payload

    def _packed(self) -> bytes:
        return codec.pack(self.model_dump(mode="json", by_alias=True, exclude_none=True))

    @classmethod
    def decode(cls, payload: bytes, encoding: str | None = None) -> Self:
        """Read one payload; raise ``MessageError`` with the reason if it does not fit the schema."""
        codec.check_encoding(cls.encoding() if encoding is None else encoding, cls.SCHEMA, cls.VERSION)
        fields = codec.unpack(payload, limit=cls.MAX_BYTES)
        try:
            return cls.model_validate(fields)
        except ValidationError as error:
            found = {problem["type"] for problem in error.errors()}
            reason = next((reason for kind, reason in _REASONS.items() if kind in found), "fields")
            raise MessageError(reason, explain(error)) from None

    @classmethod
    def json_schema(cls) -> dict[str, Any]:
        """JSON Schema of the map that the payload holds."""
        return cls.model_json_schema(by_alias=True)


class ScenarioDocument(Document):
    """A scenario as published: the text of its YAML document, already checked by the side-info service."""

    SCHEMA: ClassVar[str] = "fleet.scenario"
    MAX_BYTES: ClassVar[int] = 262144

    scenario: Id
    version: Annotated[int, ranges.VERSION]
    text: Annotated[str, Field(max_length=200_000)]


class Assignment(Document):
    """A vehicle takes part in a scenario whose time zero is ``time_zero`` (ns since the Unix epoch)."""

    SCHEMA: ClassVar[str] = "fleet.assignment"
    MAX_BYTES: ClassVar[int] = 4096

    scenario: Id
    vehicle: Id
    time_zero: Nanoseconds
    active: bool = True
    clock_offset: Annotated[float, ranges.CLOCK_OFFSET, Field(description="bound on the clocks' difference, s")] = 0.0


class EventKind(StrEnum):
    """What can happen to a vehicle or a service."""

    UNKNOWN_VEHICLE = "unknown_vehicle"
    PROFILE_REFUSED = "profile_refused"
    PROFILE_CONTRADICTED = "profile_contradicted"
    PROFILE_CHANGED = "profile_changed"
    SCENARIO_REFUSED = "scenario_refused"
    CONTRADICTION = "contradiction"
    MISS = "miss"
    DATA_CONTRADICTED = "data_contradicted"
    COVERAGE = "coverage"
    JUMP = "jump"
    LEAP = "leap"
    GLITCH = "glitch"
    VEHICLE_GONE = "vehicle_gone"
    TWO_SOURCES = "two_sources"
    ONE_SOURCE = "one_source"
    CLOCK = "clock"
    SECOND_SERVER = "second_server"
    BEHIND = "behind"


class Event(Document):
    """Something that an operator should know about one vehicle, or about the service that tells it."""

    SCHEMA: ClassVar[str] = "fleet.event"
    MAX_BYTES: ClassVar[int] = 16384

    # What is on the wire is the text of the kind.
    kind: Annotated[EventKind, Field(strict=False)]
    vehicle: Annotated[Id | None, Field(description="none for what concerns the service as a whole")] = None
    t: Nanoseconds
    source: Id
    message: Annotated[str, Field(max_length=2000)]
    details: dict[str, str | Annotated[int, ranges.DETAIL] | Annotated[float, ranges.DETAIL] | bool] = Field(
        default_factory=dict, max_length=64
    )


class ServiceStatus(Document):
    """Health of one service instance: counters only grow within one ``started``."""

    SCHEMA: ClassVar[str] = "fleet.status"

    kind: Id
    instance: Id
    t: Nanoseconds
    started: Nanoseconds
    counters: dict[str, Counter] = Field(default_factory=dict, max_length=256)
    gauges: dict[str, Annotated[float, ranges.GAUGE]] = Field(default_factory=dict, max_length=256)
    refused: dict[str, Counter] = Field(default_factory=dict, max_length=256)
    waiting: dict[Id, Annotated[str, Field(max_length=200)]] = Field(
        default_factory=dict, max_length=100, description="vehicles without a tube, and why; the first 100"
    )
    clock_offsets: dict[Id, Annotated[float, ranges.GAUGE]] = Field(
        default_factory=dict,
        max_length=100,
        description="stamp minus time of arrival, s, the greatest of the last 10 to 20 s, of the 100 vehicles whose "
        "clocks are furthest off",
    )
    clock_spreads: dict[Id, Annotated[float, ranges.SIZE]] = Field(
        default_factory=dict, max_length=100, description="by how much the other differences were less, s"
    )
    problems: list[Annotated[str, Field(max_length=300)]] = Field(
        default_factory=list, max_length=32, description="what is wrong with the service as a whole, now"
    )
    chain: dict[str, Annotated[str, Field(max_length=200)]] = Field(
        default_factory=dict,
        max_length=16,
        description="of a reach server: its journal's chain, round, samples, tubes and events so far, and its build",
    )
