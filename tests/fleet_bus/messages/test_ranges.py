"""The ranges of numbers: one table, which schemas and the reference page show and decoders and encoders hold."""

import json
import math
import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import msgpack
import numpy as np
import pytest

from fleet_bus.errors import MessageError, ProfileError
from fleet_bus.messages import VehicleProfile, parse_profile, ranges
from fleet_bus.messages.ranges import Range
from fleet_bus.schemas import generate
from fleet_bus.schemas.wire_page import LISTED, spans
from tests.fleet_bus.messages.examples import (
    a_part,
    a_profile,
    a_round,
    a_sample,
    a_tube,
    documents,
    messages,
    profile_fields,
)

PAGE = Path(__file__).parents[3] / "docs" / "reference" / "wire.md"
FIELDS = spans()
CASES = [(message, field) for message, fields in FIELDS.items() for field in fields]

Change = Callable[[float], bytes]


# --- what shows the table ---------------------------------------------------------------------------------------------
def limits(schema: Mapping[str, Any], prefix: str = "") -> dict[str, float]:
    words = ("minimum", "maximum", "exclusiveMinimum", "exclusiveMaximum")
    return {word: schema[prefix + word] for word in words if prefix + word in schema}


def leaves(schema: Mapping[str, Any], whole: Mapping[str, Any], place: str) -> Iterator[tuple[str, dict[str, float]]]:
    """Place and limits of everything in a JSON Schema that is a number, or an array of numbers in a bin."""
    if "$ref" in schema:
        schema = whole["$defs"][schema["$ref"].rpartition("/")[2]]
    if schema.get("type") in ("integer", "number"):
        yield place, limits(schema)
    if "x-dtype" in schema and "x-layout" not in schema:
        yield place, limits(schema, "x-")
    for option in schema.get("anyOf", ()):
        yield from leaves(option, whole, place)
    for key, part in schema.get("properties", {}).items():
        yield from leaves(part, whole, f"{place}.{key}".lstrip("."))
    for word in ("additionalProperties", "patternProperties"):
        parts = schema.get(word)
        options = parts.values() if word == "patternProperties" and parts else [parts]
        for part in options:
            if isinstance(part, dict):
                yield from leaves(part, whole, f"{place}.*")
    for part in (*schema.get("prefixItems", ()), schema.get("items")):
        if isinstance(part, dict):
            yield from leaves(part, whole, place)
    if "x-layout" in schema:
        layout = schema["x-layout"]
        for entry in (*layout["header"], *layout["body"]):
            if entry["name"] != "padding":
                yield entry["name"], limits(entry, "x-")


def shown() -> dict[str, set[tuple[str, str]]]:
    """By message: place, and limits as text, of every number of its schema."""
    found = {}
    for text in generate().values():
        schema = json.loads(text)
        found[schema["title"]] = {(place, str(span)) for place, span in leaves(schema, schema, "")}
    return found


def in_schema(message: str, field: str) -> str:
    """The place of a field of the table in its schema."""
    if message == "StateSample":
        return field.removesuffix("[]")
    if message in LISTED:
        return field.partition("[")[0]
    return field.replace("noise.*.", "noise.process.")


def test_every_number_of_every_schema_has_the_range_of_the_table() -> None:
    found = shown()
    assert found.keys() == FIELDS.keys()
    for message, fields in FIELDS.items():
        expected = {(in_schema(message, field), str(span.json())) for field, span in fields.items()}
        if message == "VehicleProfile":
            expected |= {(p.replace(".process.", ".measurement."), span) for p, span in expected}
        assert found[message] == expected, message


def test_the_reference_page_lists_the_table() -> None:
    _, _, section = PAGE.read_text(encoding="utf-8").partition("\n## Ranges\n")
    rows = re.findall(r"^\| (\w+) \| `([^`]+)` \| ([^|]+) \|$", section.partition("\n## ")[0], re.MULTILINE)
    assert rows == [(message, field, str(FIELDS[message][field])) for message, field in CASES]
    assert f"{ranges.MEMORY.high / 2**20:.0f} MiB" in section


def test_a_time_with_any_horizon_and_the_difference_of_two_fit_into_64_bits() -> None:
    longest = int(ranges.STEP.high) * math.ceil(ranges.SAMPLE_TIME.high * 1e9)
    assert int(ranges.TIME.high) + longest <= ranges.AHEAD.high < 2**63
    assert ranges.TIME.high == np.datetime64("2200-01-01", "ns").astype(np.int64)
    assert round(ranges.SAMPLE_TIME.low * 1e9) >= 1
    assert ranges.SEQ.high + 1 == int(float(2**53))
    assert 2 * ranges.SET_VALUE.high < np.finfo(np.float32).max
    for span in (span for fields in FIELDS.values() for span in fields.values()):
        assert math.isfinite(span.low)
        assert math.isfinite(span.high)


# --- what holds it ----------------------------------------------------------------------------------------------------
def states(field: str, number: float) -> bytes:
    """A sample with one number that is something else, written past the encoder."""
    header: dict[str, float] = {
        "epoch": 3, "seq": 7, "t": 10**18, "flags": 4, "n": 2, "m": 1, "plan": 1, "reserved": 0,
    }  # fmt: skip
    body = {"x": [1.0, 2.0], "u": [0.1], "bound": [0.1, 0.1], "plan[]": [0.2], "plan_tolerance": [0.0]}
    if field in body:
        body[field][-1] = number
    else:
        header[field] = number
        if field == "plan" and number > 1:
            # More steps than there is room for numbers.
            header["m"] = 0
    sizes = {"x": "n", "u": "m", "bound": "n", "plan_tolerance": "m"}
    for name, size in sizes.items():
        body[name] = (body[name] * 600)[: int(header[size])]
    if not int(header["flags"]) & 4:
        body["bound"] = []
    body["plan[]"] = (body["plan[]"] * 600)[: int(header["plan"] * header["m"])]
    if not header["plan"]:
        body["plan_tolerance"] = []
    kinds = {"epoch": "<u8", "seq": "<u8", "t": "<i8", "flags": "<u4", "n": "<u2", "m": "<u2", "plan": "<u2"}
    raw = b"".join(np.array(v, dtype=kinds.get(name, "<u2")).tobytes() for name, v in header.items()) + b"\0" * 4
    raw += np.array([number for part in body.values() for number in part], dtype="<f8").tobytes()
    packed: bytes = msgpack.packb({"d": raw})
    return packed


def tubes(field: str, number: float) -> bytes:
    fields = msgpack.unpackb(a_tube().encode())
    if field == "p":
        fields["x"], fields["p"] = ["s"] * 32, [0, number]
        fields |= {"c": b"\0" * 3 * 32 * 8, "g": b"", "h": b"\0" * 3 * 64 * 4}
    elif field in ("T", "c", "g", "h", "o", "a", "af"):
        dtype = {"T": "<i8", "g": "<f4", "h": "<f4", "o": "<f4"}.get(field, "<f8")
        array = np.frombuffer(fields[field], dtype=dtype).copy()
        array[-1] = number
        fields[field] = array.tobytes()
    elif field == "k":
        fields["k"] = [["lot", "P", 1, number]]
    elif field == "au":
        fields["au"] = [number, 0, 0.0, 0, 0, 0]
    elif field == "au[2]":
        fields["au"] = [1, 0, number, 0, 0, 0]
    else:
        fields[field] = number
    packed: bytes = msgpack.packb(fields)
    return packed


def rounds(field: str, number: float) -> bytes:
    fields = msgpack.unpackb(a_round().encode())
    many = {"v": [f"v{k}" for k in range(1000)], "s": [f"s{k}" for k in range(1000)]}
    if field in ("kv", "ks", "tv", "ka", "ep", "sq", "i"):
        dtype = {"kv": "<u2", "ks": "<u2", "tv": "<u2", "i": "<f8"}.get(field, "<i8")
        array = np.frombuffer(fields[field], dtype=dtype).copy()
        array[-1] = number
        fields |= {field: array.tobytes(), **many}
    elif field == "c":
        fields["c"] = [["elapse", number, "", "", ""]]
    elif field == "tt":
        fields["tt"] = [number, 0, 0]
    else:
        fields[field] = [1, number] if field == "p" else number
    packed: bytes = msgpack.packb(fields)
    return packed


def parts(field: str, number: float) -> bytes:
    fields = msgpack.unpackb(a_part().encode())
    fields[field] = [1, number] if field == "p" else number
    packed: bytes = msgpack.packb(fields)
    return packed


def documented(message: str, field: str, number: float) -> bytes:
    (example,) = [d for d in documents() if type(d).__name__ == message]
    fields = msgpack.unpackb(example.encode())
    if message == "VehicleProfile":
        fields = profile_with(field, number)
    elif field.endswith(".*"):
        fields[field.removesuffix(".*")] = {"a": number}
    else:
        fields[field] = number
    packed: bytes = msgpack.packb(fields)
    return packed


def profile_with(field: str, number: float) -> dict[str, Any]:
    # A class of one state and no input takes little memory, whatever one of its sizes is.
    fields: dict[str, Any] = {
        "class": "point", "state": {"x": {"unit": "m"}}, "inputs": {"u": {"unit": "m"}}, "sample_time": 1.0,
        "future_inputs": "plan", "window": 100,
    }  # fmt: skip
    group, _, last = field.rpartition(".")
    if group in ("state.*", "inputs.*"):
        entry = fields[group.partition(".")[0]]["x" if group == "state.*" else "u"]
        entry[last] = number if last == "rate" else sorted([0.0, number])
    elif group == "noise.*":
        fields["noise"] = {"process": {last: [number] if last == "box" else [[number]]}}
    elif group == "lipschitz":
        one = [[0.0, number]]
        fields["lipschitz"] = {"matrix": one} if last == "matrix" else {"lower": one, "upper": one}
    else:
        fields[field] = number
        if field in ("input_lags", "horizon"):
            fields |= {"inputs": {}}
    return fields


def just_outside(span: Range) -> list[float]:
    whole = isinstance(span.low, int)
    if span.between:
        return [span.low, span.high]
    found = (
        [span.low - 1, span.high + 1] if whole else [np.nextafter(span.low, -np.inf), np.nextafter(span.high, np.inf)]
    )
    return [number if whole else float(number) for number in found]


def just_inside(span: Range) -> list[float]:
    if span.between:
        return [float(np.nextafter(span.low, np.inf)), float(np.nextafter(span.high, -np.inf))]
    return [span.low, span.high]


def fits(message: str, field: str, number: float) -> bool:
    """Whether the layout has room for the number at all."""
    if message == "StateSample" and number < 0:
        return field in ("t", "x", "u", "bound", "plan[]", "plan_tolerance")
    if message == "JournalRound" and field in ("kv", "ks", "tv"):
        return number >= 0
    return not (message == "ReachTube" and field in ("g", "h", "o"))


def made(message: str, field: str, number: float) -> bytes:
    makers: dict[str, Callable[[str, float], bytes]] = {
        "StateSample": states, "ReachTube": tubes, "JournalRound": rounds, "CheckpointPart": parts,
    }  # fmt: skip
    maker = makers.get(message)
    return documented(message, field, number) if maker is None else maker(field, number)


@pytest.mark.parametrize(("message", "field"), CASES, ids=[f"{m}-{f}" for m, f in CASES])
def test_the_ends_of_a_range_are_read_and_what_lies_beyond_is_refused_by_name(message: str, field: str) -> None:
    span = FIELDS[message][field]
    _, decode, _, _ = messages()[message]
    for number in just_inside(span):
        if fits(message, field, number):
            decode(made(message, field, number))
    beyond = just_outside(span)
    if (message, field) in (("ReachTube", "g"), ("ReachTube", "h"), ("ReachTube", "o")):
        beyond = [2e38, -2e38]
    refused = 0
    for number in beyond:
        if not fits(message, field, number) and field not in ("g", "h", "o"):
            continue
        with pytest.raises(MessageError) as caught:
            decode(made(message, field, number))
        assert caught.value.reason == "range"
        # A whole array is named by its key, an entry of a list or map with where it stands.
        name = field.removesuffix("[]").removesuffix(".*").replace("noise.*", "noise.process")
        assert name.replace("state.*", "state.x").replace("inputs.*", "inputs.u") in caught.value.detail
        if field != "p":
            assert str(span) in caught.value.detail
        refused += 1
    assert refused


@pytest.mark.parametrize("number", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize(("message", "field"), CASES, ids=[f"{m}-{f}" for m, f in CASES])
def test_what_is_no_number_is_in_no_range(message: str, field: str, number: float) -> None:
    span = FIELDS[message][field]
    if isinstance(span.low, int):
        assert number not in span
        return
    _, decode, _, _ = messages()[message]
    with pytest.raises(MessageError) as caught:
        decode(made(message, field, number))
    assert caught.value.reason == "not_finite"


def test_a_copy_with_a_number_out_of_range_is_not_sent() -> None:
    changes: dict[str, tuple[str, float]] = {
        "VehicleProfile": ("sample_time", 1e-10), "ScenarioDocument": ("version", 0),
        "Assignment": ("clock_offset", 1e300),        "Event": ("t", 2**63 - 1), "ServiceStatus": ("started", 0),
    }  # fmt: skip
    for document in documents():
        field, number = changes[type(document).__name__]
        with pytest.raises(MessageError, match=rf"range: {field}"):
            document.model_copy(update={field: number}).encode()
    for tube, field in (
        (a_tube(area=np.full(3, -1.0)), "a is"), (a_tube(center=np.full((3, 4), 1e39)), "c is"), (a_tube(t=0), "t is"),
        (a_tube(times=np.full(3, 2**63 - 1)), "T is"), (a_tube(compute_seconds=-1.0), "ct is"),
    ):  # fmt: skip
        with pytest.raises(MessageError, match=f"range: {field}"):
            tube.encode()
    with pytest.raises(MessageError, match="not_finite: g holds"):
        a_tube(generators=np.full((3, 4, 4), np.nan)).encode()


def test_what_is_too_long_is_not_sent() -> None:
    long = {"outline": np.zeros((3, 3000, 2))}
    for encode in (
        a_tube(**long).encode,
        a_sample(plan=np.zeros((300, 2))).encode,
        a_profile().model_copy(update={"maps_to": {f"x{i}": "x" for i in range(300)}}).encode,
    ):
        with pytest.raises(MessageError) as caught:
            encode()
        assert caught.value.reason in ("too_large", "malformed")


@pytest.mark.parametrize(
    "sizes",
    [
        {"window": 100_000, "state": {f"x{i}": "m" for i in range(32)}, "input_lags": 32},
        {"reservoir": 100_000, "state": {f"x{i}": "m" for i in range(32)}, "input_lags": 0},
        {"nearest": 100_000, "input_lags": 32, "inputs": {f"u{i}": "m" for i in range(16)}, "roles": {}},
        {"horizon": 200, "input_lags": 32, "inputs": {f"u{i}": "m" for i in range(16)}, "roles": {}},
    ],
)
def test_a_class_that_takes_too_much_memory_is_refused(sizes: dict[str, Any]) -> None:
    fields = {**profile_fields(), "future_inputs": "plan", "frame": "world", **sizes}
    for part in ("lipschitz", "noise", "roles", "maps_to"):
        fields.pop(part, None)
    with pytest.raises(ProfileError, match=r"takes up to \d+ MiB of a server's memory, 128 MiB are allowed"):
        parse_profile(fields)
    with pytest.raises(MessageError, match="range"):
        VehicleProfile.decode(msgpack.packb({**fields, "sample_time": 0.05}))


def test_a_class_whose_tubes_no_message_holds_is_refused() -> None:
    for states, horizon in ((4, 200), (5, 160), (12, 50), (32, 9)):
        fields = {
            "class": "long", "state": {f"x{i}": "m" for i in range(states)}, "sample_time": 1, "horizon": horizon,
        }  # fmt: skip
        assert parse_profile(fields).tube_bytes <= ranges.TUBE_BYTES.high
        with pytest.raises(ProfileError, match="lower the horizon"):
            parse_profile(
                {**fields, "horizon": min(horizon + 40, 200), "state": {f"x{i}": "m" for i in range(max(states, 5))}}
            )
