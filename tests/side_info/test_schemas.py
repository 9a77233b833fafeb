"""The JSON Schema of scenario documents."""

import json
import subprocess
import sys
from pathlib import Path

import jsonschema
import pytest

from fleet_bus.schemas import DIALECT
from side_info import Scenario
from side_info import shipped as scenarios
from side_info.documents.yaml_text import read_yaml
from side_info.schemas import generate, shipped
from tests.side_info.corpus import DOCUMENT

SCHEMA = json.loads(shipped())
VALIDATOR = jsonschema.Draft202012Validator(SCHEMA)


def test_what_ships_is_what_the_fields_generate() -> None:
    assert shipped() == generate(), "run python -m side_info.schemas"
    jsonschema.Draft202012Validator.check_schema(SCHEMA)
    assert SCHEMA["$schema"] == DIALECT


def test_the_module_writes_it_where_it_lies() -> None:
    before = shipped()
    done = subprocess.run([sys.executable, "-m", "side_info.schemas"], capture_output=True, text=True, check=True)
    assert "scenario.schema.json" in done.stdout
    assert shipped() == before


@pytest.mark.parametrize("name", scenarios())
def test_what_ships_validates(name: str) -> None:
    VALIDATOR.validate(read_yaml(Scenario.load(name).text, name).fields)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("version: 1\n", ""),
        ("monitor", "monitors"),
        ("version: 1", "version: 1.5"),
        ("{x1: m, x2: m}", "{}"),
        ("x1: m,", "1x: m,"),
        ("sampled", "dense"),
        ("sampled", "continuous, speed: {x1: -1}"),
        ("T: 25 s", "T: [25]"),
        ("x1: [-1.5, 2], x2", "x1: [-1.5], x2"),
        ("radius: 2", "radius: 0"),
        ('"r - abs(x2 + 1.5) >= 0"', "3"),
    ],
)
def test_what_it_refuses(old: str, new: str) -> None:
    assert VALIDATOR.is_valid(read_yaml(DOCUMENT, "lot").fields)
    assert not VALIDATOR.is_valid(read_yaml(DOCUMENT.replace(old, new, 1), "lot").fields)


def test_it_is_package_data() -> None:
    folder = Path(__file__).parents[2] / "side_info" / "schemas"
    assert [path.name for path in folder.glob("*.json")] == ["scenario.schema.json"]
