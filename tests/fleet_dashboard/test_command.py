"""The command that serves the page, as far as it needs no bus; and the demo without a page."""

import sys
import threading
from pathlib import Path

import pytest
from typer.testing import CliRunner

from fleet_bus.errors import FleetError, UsageError
from fleet_cli import demo_page
from fleet_cli.commands import dashboard
from fleet_cli.main import app
from fleet_cli.processes import Children

RUN = CliRunner()


@pytest.fixture(autouse=True)
def _signals_stay(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dashboard, "stop_on_signals", threading.Event)


def test_without_its_extra_the_command_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [name for name in sys.modules if name.startswith("fleet_dashboard")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "nicegui", None)
    found = RUN.invoke(app, ["dashboard"])
    assert isinstance(found.exception, UsageError)
    assert "pip install 'fleet-reach[dashboard]'" in str(found.exception)


def test_without_its_extra_a_recording_says_what_to_install(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(sys.modules, "fleet_recorder.reader", None)
    found = RUN.invoke(app, ["dashboard", "--port", "0", "--open", str(tmp_path / "none")])
    assert isinstance(found.exception, UsageError)
    assert "--open needs fleet_recorder" in str(found.exception)


def test_a_token_that_cannot_be_one_is_refused_before_anything_starts() -> None:
    found = RUN.invoke(app, ["dashboard", "--token", "short"])
    assert isinstance(found.exception, UsageError)
    assert "--token" in str(found.exception)


def test_the_demo_goes_on_without_a_page(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(demo_page, "find_spec", lambda name: None)
    with Children() as children:
        line = demo_page.start_page(children, "tcp/127.0.0.1:1", 0, threading.Event())
    assert line == "no page: pip install 'fleet-reach[dashboard]'"


def test_a_page_that_does_not_start_is_said_in_the_demo(monkeypatch: pytest.MonkeyPatch) -> None:
    class Broken:
        def wait_for(self, *_: object) -> str:
            raise FleetError("page ended with exit code 1")

    children = Children()
    monkeypatch.setattr(children, "start", lambda *_: Broken())
    line = demo_page.start_page(children, "tcp/127.0.0.1:1", 0, threading.Event())
    assert line == "no page: page ended with exit code 1"
