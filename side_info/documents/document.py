"""The fields of a scenario document, checked one by one; what they mean together is for ``scenario``."""

import re
from datetime import UTC, datetime, timedelta
from typing import Annotated, Any, Final, Literal, Self

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, model_validator

from fleet_bus.keys import ID_PATTERN
from fleet_bus.messages import ranges
from fleet_bus.units import seconds
from side_info.documents.yaml_text import Path, YamlText

_INSTANT: Final = re.compile(r"(\d{4}-\d\d-\d\d)[Tt ](\d\d:\d\d:\d\d)(?:\.(\d{1,9}))?([Zz]|[+-]\d\d:\d\d)", re.ASCII)
_EPOCH: Final = datetime(1970, 1, 1, tzinfo=UTC)

Name = Annotated[str, Field(pattern=r"^[A-Za-z_][A-Za-z0-9_]{0,31}$")]
Bounds = Annotated[list[float], Field(min_length=2, max_length=2)]


def instant_ns(text: str) -> int:
    """Nanoseconds since the Unix epoch of an RFC 3339 instant; raise ``ValueError`` for anything else."""
    match = _INSTANT.fullmatch(text)
    if match is None:
        raise ValueError(f"{text!r:.40} is no RFC 3339 instant: write one such as 2026-05-01T12:00:00Z")
    date, time, fraction, zone = match.groups()
    moment = datetime.fromisoformat(f"{date}T{time}{'+00:00' if zone in 'Zz' else zone}")
    nanoseconds = (moment - _EPOCH) // timedelta(seconds=1) * 10**9 + int((fraction or "").ljust(9, "0"))
    if nanoseconds not in ranges.TIME:
        raise ValueError(f"{text!r:.40} lies outside of what can be told: expected 1970 to 2199")
    return nanoseconds


def _zero(value: object) -> int | None:
    if value == "on_start":
        return None
    if isinstance(value, str):
        return instant_ns(value)
    raise ValueError("expected on_start or an RFC 3339 instant such as 2026-05-01T12:00:00Z")


def _value(value: object) -> float:
    if isinstance(value, str) and not value.isascii():
        raise ValueError(f"{value!r:.40} is not a duration: expected ASCII digits, such as 25 s")
    return seconds(value)


def _as_text(value: object) -> object:
    return {"text": value} if isinstance(value, str) else value


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)


class TimeFields(_Part):
    """Time zero, what times the formulas speak about, and how fast states change in between."""

    # Read, ``zero`` is nanoseconds since the Unix epoch, or None: each vehicle's start.
    zero: Annotated[
        int | None,
        BeforeValidator(_zero, json_schema_input_type=str),
        Field(description="on_start (each vehicle's own), or an RFC 3339 instant"),
    ]
    semantics: Annotated[
        Literal["sampled", "continuous"], Field(description="whether formulas speak about samples or about real time")
    ] = "sampled"
    speed: Annotated[
        dict[Name, Annotated[float, Field(ge=0)]],
        Field(description="bounds of the rates of change, unit of the state per second; needed by continuous"),
    ] = Field(default_factory=dict)


class DiscFields(_Part):
    """Center (two states) and radius."""

    center: Annotated[dict[Name, float], Field(min_length=2, max_length=2)]
    radius: Annotated[float, Field(gt=0)]


class RegionFields(_Part):
    """A box (bounds of states), a disc, or the text of a formula."""

    box: Annotated[dict[Name, Bounds], Field(min_length=1)] | None = None
    disc: DiscFields | None = None
    text: str | None = None

    @model_validator(mode="after")
    def _one_form(self) -> Self:
        if sum(form is not None for form in (self.box, self.disc, self.text)) != 1:
            raise ValueError("expected one of box, disc and text")
        return self


class ScenarioFields(_Part):
    """A scenario document, field by field."""

    scenario: Annotated[str, Field(pattern=f"^{ID_PATTERN.pattern}$", description="id of the scenario")]
    version: Annotated[int, ranges.VERSION]
    state: Annotated[
        dict[Name, Annotated[str, Field(max_length=16)]],
        Field(min_length=1, max_length=32, description="unit of each state that formulas name"),
    ]
    time: TimeFields
    parameters: dict[Name, Annotated[float, BeforeValidator(_value, json_schema_input_type=float | str)]] = Field(
        default_factory=dict, description="numbers, and durations such as 25 s, 250 ms or 2 min"
    )
    regions: dict[
        Name, Annotated[RegionFields, BeforeValidator(_as_text, json_schema_input_type=RegionFields | str)]
    ] = Field(default_factory=dict, description="sets of states; the text of one may name those above it")
    assume: Annotated[str, Field(description="side information: a formula that is taken as true")]
    monitor: dict[Name, str] = Field(default_factory=dict, description="requirements: formulas that get a verdict")


def read_fields(document: YamlText) -> ScenarioFields:
    """Fields of a document; raise ``ScenarioError`` at the first that is missing, unknown or malformed."""
    try:
        return ScenarioFields.model_validate(document.fields)
    except ValidationError as error:
        # What is unknown is often a missing key, misspelled.
        problem = min(error.errors(), key=lambda found: found["type"] != "extra_forbidden")
        path: Path = tuple(problem["loc"])
        kind = problem["type"]
        if kind == "missing":
            raise document.error(path[:-1], f"the key {path[-1]!r} is missing") from None
        if kind == "extra_forbidden":
            raise document.error(
                path,
                f"unknown key {str(path[-1])[:40]!r}: expected one of {', '.join(_allowed(path))}",
                key=True,
            ) from None
        message = _expected(path, kind) or problem["msg"].removeprefix("Value error, ")
        name = ".".join(str(part) for part in path if part != "[key]") or "the document"
        raise document.error(path, f"{name:.80}: {message}", key=path[-1:] == ("[key]",)) from None


_MAPS: Final[dict[Path, str]] = {
    (): "expected a map that begins with scenario:",
    ("state",): "write names with units, {x1: m, x2: m}",
    ("time",): "write {zero: on_start, semantics: sampled}",
    ("time", "speed"): "write names with bounds, {x1: 2.0, x2: 2.0}",
    ("parameters",): "write names with values, {T: 25 s, r: 1.5}",
    ("regions",): "write names with boxes, discs or formulas, {P: {box: {x1: [0, 1]}}}",
    ("monitor",): 'write names with formulas, {stays: "always[0:1](P)"}',
}


def _expected(path: Path, kind: str) -> str:
    """What to write at ``path`` where something of another kind stands; empty where pydantic says it well."""
    if path == ("version",):
        return f"write a whole number from {ranges.VERSION}, without quotes"
    if kind == "string_pattern_mismatch":
        if path == ("scenario",):
            return "an id has letters, digits, _ . - and no spaces, 64 characters at most"
        name = f"{str(path[-2])[:40]!r}"
        return f"{name} is no name: letters, digits, _ and no spaces, 32 characters at most, no digit first"
    if kind in ("dict_type", "model_type", "model_attributes_type"):
        return _MAPS.get(path, "")
    if path[2:] == ("disc", "center") and kind in ("too_long", "too_short"):
        return "a disc lies in the plane of two states: write {x1: 0, x2: 0}"
    return ""


def _allowed(path: Path) -> list[str]:
    models: dict[tuple[Any, int], type[_Part]] = {("time", 2): TimeFields, ("regions", 3): RegionFields}
    model = DiscFields if len(path) == 4 else models.get((path[0], len(path)), ScenarioFields)
    return list(model.model_fields)
