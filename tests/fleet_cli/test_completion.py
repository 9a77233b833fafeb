"""The shell completes what can be one of some names."""

from typing import Any

import pytest
import typer

from fleet_bus.messages import EventKind
from fleet_cli.demo import ROUTES
from fleet_cli.main import app
from tests.docs.test_docs import commands


def completed(command: str, parameter: str, incomplete: str) -> list[str]:
    found = commands()[command]
    (param,) = (p for p in found.params if parameter in (*p.opts, p.name))
    return [item.value for item in param.shell_complete(_context(found), incomplete)]


def _context(command: Any) -> Any:
    return typer.Context(command)


@pytest.mark.parametrize(
    ("command", "parameter", "incomplete", "expected"),
    [
        ("fleet agent", "--profile", "", ["svea", "dart", "f1tenth", "upenn"]),
        ("fleet agent", "--route", "park", ["parking-lot"]),
        ("fleet replay", "--profile", "d", ["dart"]),
        ("fleet evaluate", "--profile", "u", ["upenn"]),
        ("fleet evaluate", "--method", "pa", ["paper"]),
        ("fleet calibrate", "--method", "c", ["calibrated"]),
        ("fleet calibrate", "--profile", "f", ["f1tenth"]),
        ("fleet demo", "--scenario", "", list(ROUTES)),
        ("fleet side-info", "scenarios", "conv", ["convoy"]),
        ("fleet scenario check", "scenarios", "inter", ["intersection"]),
        ("fleet scenario check", "--profile", "sv", ["svea"]),
        ("fleet scenario show", "scenario", "inter", ["intersection"]),
        ("fleet events", "--kind", "", [str(kind) for kind in EventKind]),
        ("fleet watch", "--sort", "a", ["age", "area"]),
        ("fleet top", "--sort", "n", ["name"]),
    ],
)
def test_names_are_completed(command: str, parameter: str, incomplete: str, expected: list[str]) -> None:
    assert completed(command, parameter, incomplete) == expected


def test_every_option_that_names_one_of_some_is_completed() -> None:
    for name, command in commands().items():
        for param in command.params:
            if {"--method", "--profile", "--scenario", "--route"} & set(param.opts) and name != "fleet paper":
                assert param.shell_complete(_context(command), ""), f"{name} {param.opts}"
    assert app.info.name == "fleet"
