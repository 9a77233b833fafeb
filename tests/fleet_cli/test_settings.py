"""Options from a file and from the environment: what counts first, and what is wrong with a file."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import typer

from fleet_bus.errors import UsageError
from fleet_cli import settings
from fleet_cli.main import app

GROUP: Any = typer.main.get_command(app)
FILE = """
[all]
router = ["tcp/127.0.0.1:7999", "tcp/127.0.0.1:7998"]

[reach]
id = "reach-7"

[side-info]
id = "from-file"

[scenario.show]
sample-time = 0.1
"""


@pytest.fixture
def config(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    path = tmp_path / "config.toml"
    path.write_text(FILE, encoding="utf-8")
    monkeypatch.setenv(settings.VARIABLE, str(path))
    return path


def found() -> dict[tuple[str, str], settings.Setting]:
    return {(one.command, one.option): one for one in settings.effective(GROUP)}


def test_the_environment_counts_before_the_file_and_the_file_before_the_default(
    config: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FLEET_SIDE_INFO_ID", "from-environment")
    every = found()
    assert every["fleet reach", "id"].value == "reach-7"
    assert every["fleet reach", "id"].source == str(config)
    assert every["fleet reach", "metrics"].source == "default"
    assert list(every["fleet watch", "router"].value) == ["tcp/127.0.0.1:7999", "tcp/127.0.0.1:7998"]
    assert every["fleet scenario show", "sample-time"].value == "0.1"
    side_info = every["fleet side-info", "id"]
    assert (side_info.value, side_info.source) == ("from-environment", "environment")
    assert side_info.variable == "FLEET_SIDE_INFO_ID"


def test_a_process_heeds_them_and_the_command_line_most(config: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    command = [sys.executable, "-m", "fleet_cli"]
    config.write_text('[all]\nlog-format = "yaml"\n', encoding="utf-8")
    done = subprocess.run([*command, "scenario", "list"], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "yaml" in done.stderr
    assert "--log-format" in done.stderr
    for more, code in ((["--log-format", "json"], 0), ([], 2)):
        assert (
            subprocess.run([*command, *more, "scenario", "list"], capture_output=True, check=False).returncode == code
        )
    monkeypatch.setenv("FLEET_LOG_FORMAT", "text")
    assert subprocess.run([*command, "scenario", "list"], capture_output=True, check=False).returncode == 0


def test_the_command_shows_what_is_set_and_why(config: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "fleet_cli", "config", "--json"], capture_output=True, text=True, check=True
    )
    rows = [json.loads(line) for line in done.stdout.splitlines()]
    assert {row["source"] for row in rows} == {str(config)}
    assert {(row["command"], row["option"]) for row in rows} >= {("fleet reach", "id"), ("fleet watch", "router")}
    shown = subprocess.run(
        [sys.executable, "-m", "fleet_cli", "config", "reach"], capture_output=True, text=True, check=True
    )
    assert "reach-7" in shown.stdout
    assert "FLEET_REACH_ID" in shown.stdout


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('[reach]\nidd = "x"\n', r"`fleet reach` has no option idd; it has id, metrics, router"),
        ("[all]\nfoo = 1\n", r"foo in \[all\] is an option of no command"),
        ("x = 1\n", r"x must stand in a table: \[all\], or that of a command"),
        ('[rech]\nid = "x"\n', r"there is no command rech; there are agent, "),
        ("[scenario.shw]\nx = 1\n", r"there is no command shw; there are check, list, show"),
        ("[scenario]\njson = 1\n", r"json must stand in a table"),
        ("[reach\n", r"config.toml: .*line 1"),
        ("all = 3\n", r"all must stand in a table"),
    ],
)
def test_what_is_wrong_with_a_file_is_told_by_name(config: Path, text: str, message: str) -> None:
    config.write_text(text, encoding="utf-8")
    with pytest.raises(UsageError, match=message):
        settings.read(GROUP)


def test_a_file_that_is_named_must_be_there(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv(settings.VARIABLE, str(tmp_path))
    with pytest.raises(UsageError, match="which is no file"):
        settings.file()
    monkeypatch.delenv(settings.VARIABLE)
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    assert settings.read(GROUP) == {} or settings.file() == Path("/etc/fleet-reach/config.toml")
    own = tmp_path / "fleet-reach" / "config.toml"
    own.parent.mkdir()
    own.write_text('[reach]\nid = "own"\n', encoding="utf-8")
    assert settings.file() == own
    assert found()["fleet reach", "id"].value == "own"
