"""The units say what the command understands, and what systemd understands."""

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from tests.deploy.units import COMMAND, CONFIGURATION, Unit, units
from tests.docs.test_blocks import REFUSED, check_fleet

UNITS = units()
each = pytest.mark.parametrize("unit", UNITS, ids=[unit.path.stem for unit in UNITS])
#: Zenoh closes a session whose router is frozen within this many seconds.
CLOSING = 15
SPANS = {"": 1, "s": 1, "sec": 1, "min": 60}


def seconds(span: str) -> int:
    found = re.fullmatch(r"(\d+)(s|sec|min|)", span)
    assert found is not None, span
    return int(found[1]) * SPANS[found[2]]


def test_there_is_a_unit_for_each_service() -> None:
    assert [unit.path.stem for unit in UNITS] == ["fleet-agent@", "fleet-reach", "fleet-router", "fleet-side-info"]


@each
def test_its_command_line_is_understood(unit: Unit) -> None:
    words = unit.command()
    assert words[0] == COMMAND
    check_fleet(words[1:])


@each
def test_the_arguments_that_it_shows_are_understood(unit: Unit) -> None:
    variable = unit.arguments_variable
    for shown in re.findall(rf"^#\s+{variable}=(.*)$", unit.text, re.M):
        check_fleet(unit.command(shown)[1:])
    # No variable of another unit, and no other way to hand arguments over.
    assert set(re.findall(r"FLEET_\w+_ARGS", unit.text)) == {variable}


def test_sources_that_the_agent_unit_shows_exist() -> None:
    (agent,) = (unit for unit in UNITS if "agent" in unit.path.stem)
    shown = re.findall(r"--source (\S+)", agent.text)
    assert shown
    assert set(shown) <= {"sim", "recording"}


def test_the_checks_can_fail() -> None:
    for words in (["agent", "--vehicle"], ["reach", "--cluster", "ray"], ["router", "config"]):
        with pytest.raises((AssertionError, REFUSED)):
            check_fleet(words)


@each
def test_its_optional_file_is_optional(unit: Unit) -> None:
    file = unit.service["EnvironmentFile"]
    assert file.startswith(f"-{CONFIGURATION}/")
    assert file.endswith(".env")


@each
def test_wrong_use_is_not_started_again_and_stopping_has_its_time(unit: Unit) -> None:
    assert unit.service["Restart"] == "always"
    assert unit.service["RestartPreventExitStatus"].split() == ["2"]
    assert seconds(unit.service["TimeoutStopSec"]) > CLOSING


@each
def test_nothing_but_its_own_folders_can_be_written(unit: Unit) -> None:
    assert unit.service["ProtectSystem"] == "strict"
    assert unit.service["DynamicUser"] == "yes"
    kept = {name for name in unit.service if name.endswith("Directory")}
    assert kept == ({"CacheDirectory"} if unit.path.stem == "fleet-reach" else set())


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd-analyze is not installed")
@each
def test_systemd_understands_it(unit: Unit, tmp_path: Path) -> None:
    program = tmp_path / "fleet"
    program.write_text("#!/bin/sh\n", encoding="utf-8")
    program.chmod(0o755)
    copy = tmp_path / unit.path.name.replace("@", "@svea1")
    copy.write_text(unit.text.replace(COMMAND, str(program)), encoding="utf-8")
    done = subprocess.run(
        ["systemd-analyze", "verify", str(copy)], capture_output=True, text=True, timeout=60, check=False
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
