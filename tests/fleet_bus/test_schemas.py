"""The JSON Schemas that ship, and the messages that they describe."""

import base64
import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import jsonschema
import msgpack
import numpy as np
import pytest

from fleet_bus.errors import MessageError
from fleet_bus.messages import ReachTube, StateSample
from fleet_bus.messages import state as state_message
from fleet_bus.messages import tube as tube_message
from fleet_bus.messages.kinds import Array
from fleet_bus.messages.methods import METHODS
from fleet_bus.schemas import DIALECT, generate, shipped
from tests.fleet_bus.messages.examples import a_sample, a_tube, messages

MESSAGES = messages()
SCHEMAS = {name: json.loads(text) for name, text in shipped().items()}


def schema_of(name: str) -> dict[str, Any]:
    _, _, encoding, _ = MESSAGES[name]
    found: dict[str, Any] = SCHEMAS[f"{encoding.removeprefix('application/msgpack;')}.json"]
    return found


def as_json(data: object) -> object:
    """Data of msgpack as JSON has it: a bin as base64."""
    if isinstance(data, bytes):
        return base64.b64encode(data).decode()
    if isinstance(data, dict):
        return {key: as_json(value) for key, value in data.items()}
    return [as_json(value) for value in data] if isinstance(data, list) else data


def test_what_ships_is_what_the_messages_generate() -> None:
    assert shipped() == generate(), "run python -m fleet_bus.schemas"


def test_the_module_writes_them_where_it_lies() -> None:
    before = shipped()
    done = subprocess.run([sys.executable, "-m", "fleet_bus.schemas"], capture_output=True, text=True, check=True)
    assert "9 schemas" in done.stdout
    assert shipped() == before


@pytest.mark.parametrize("name", MESSAGES)
def test_an_encoded_example_validates(name: str) -> None:
    payload, _, encoding, limit = MESSAGES[name]
    schema = schema_of(name)
    assert (schema["$schema"], schema["x-encoding"], schema["x-max-bytes"]) == (DIALECT, encoding, limit)
    assert schema["title"] == name
    jsonschema.Draft202012Validator.check_schema(schema)
    validator = jsonschema.Draft202012Validator(schema)
    validator.validate(as_json(msgpack.unpackb(payload)))


@pytest.mark.parametrize("name", MESSAGES)
def test_a_schema_refuses_missing_and_unknown_fields(name: str) -> None:
    payload, _, _, _ = MESSAGES[name]
    validator = jsonschema.Draft202012Validator(schema_of(name))
    example = as_json(msgpack.unpackb(payload))
    assert isinstance(example, dict)
    assert not validator.is_valid({**example, "unknown": 1})
    for key in schema_of(name)["required"]:
        assert not validator.is_valid({k: v for k, v in example.items() if k != key})


def test_the_state_is_laid_out_as_its_schema_says() -> None:
    layout = schema_of("StateSample")["properties"]["d"]["x-layout"]
    offset = 0
    sample = a_sample(bound=np.full(4, 0.1), plan=np.arange(6.0).reshape(3, 2), plan_tolerance=np.array([0.5, 0.6]))
    raw = msgpack.unpackb(sample.encode())["d"]
    sizes: dict[str, int] = {}
    for entry in layout["header"]:
        assert entry["offset"] == offset, entry
        if entry["name"] == "padding":
            assert not any(raw[offset : offset + 4])
            offset += int(entry["type"].removesuffix(" bytes"))
        else:
            kind = np.dtype(f"<{entry['type']}")
            sizes[entry["name"]] = int(np.frombuffer(raw, kind, 1, offset)[0])
            offset += kind.itemsize
    assert offset == layout["body-offset"] == 40
    assert (sizes["epoch"], sizes["seq"], sizes["t"], sizes["flags"]) == (sample.epoch, sample.seq, sample.t, 4)
    for entry in layout["body"]:
        dimensions = [sizes[s] for s in entry["shape"]]
        count = int(np.prod(dimensions))
        found = np.frombuffer(raw, "<f8", count, offset).reshape(dimensions)
        assert np.array_equal(found, getattr(sample, entry["name"])), entry
        offset += 8 * count
    assert offset == len(raw)


def test_the_bins_of_a_tube_are_what_its_fields_say() -> None:
    tube = a_tube()
    fields = msgpack.unpackb(tube.encode())
    assert [field.key for field in tube_message.FIELDS.fields] == list(fields)
    assert {field.name for field in tube_message.FIELDS.fields} == set(ReachTube.__dataclass_fields__)
    sizes = {"h": 3, "n": 4, "g": 4, "K": 4, "2": 2}
    arrays = [field for field in tube_message.FIELDS.fields if isinstance(field.kind, Array)]
    assert len(arrays) == 7
    for field in arrays:
        assert isinstance(field.kind, Array)
        found = np.frombuffer(fields[field.key], field.kind.dtype).reshape([sizes[s] for s in field.kind.shape])
        assert np.array_equal(found, getattr(tube, field.name)), field.name


@pytest.mark.parametrize("method", [*METHODS, "limits"])
def test_schema_and_decoder_of_a_tube_take_every_method_there_is(method: str) -> None:
    payload = replace(a_tube(), method=method).encode()
    jsonschema.Draft202012Validator(schema_of("ReachTube")).validate(as_json(msgpack.unpackb(payload)))
    assert ReachTube.decode(payload).method == method


def test_schema_and_decoder_of_a_tube_refuse_another_method() -> None:
    payload = replace(a_tube(), method="magic").encode()
    assert not jsonschema.Draft202012Validator(schema_of("ReachTube")).is_valid(as_json(msgpack.unpackb(payload)))
    with pytest.raises(MessageError, match="m is 'magic', none of") as refused:
        ReachTube.decode(payload)
    assert refused.value.reason == "range"


def test_the_binary_messages_have_one_schema_each() -> None:
    assert f"{state_message.ENCODING.partition(';')[2]}.json" in SCHEMAS
    assert f"{tube_message.ENCODING.partition(';')[2]}.json" in SCHEMAS
    assert {SCHEMAS[name]["title"] for name in SCHEMAS} == set(MESSAGES)
    assert StateSample.__doc__ is not None
    assert ReachTube.__doc__ is not None


def test_schemas_are_package_data() -> None:
    folder = Path(__file__).parents[2] / "fleet_bus" / "schemas"
    assert {path.name for path in folder.glob("*.json")} == set(shipped())
