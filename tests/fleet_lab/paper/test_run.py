"""The command: what is kept when it is interrupted, what is refused before the work, and when it fails."""

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from fleet_bus.errors import RecordingError, UsageError
from fleet_cli.main import app
from fleet_lab.paper import figures, report, run
from fleet_lab.paper.cells import NONE, NONE_RING, Block, Cell
from tests.waiting import DEADLINE, wait_until

RECORDINGS = Path(__file__).parents[2] / "data" / "recordings"
DART, F1TENTH = (str(RECORDINGS / f"fix_{name}.npz") for name in ("dart_free", "f1tenth_koopman"))


def cell(**changes: Any) -> Cell:
    usual = Cell("phi_p", "zonotope", 2.0, uncut=4.0, outside=0, steps=9)
    return replace(usual, **changes)


def block(*cells: Cell, unsound: bool = False) -> Block:
    return Block("ours", "Ours", "A note.", (cell(formula=NONE), *cells), unsound=unsound)


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Puts other parts in the place of the study's, and leaves the figures out."""

    def put(*parts: tuple[str, Callable[[Any], Block]]) -> None:
        monkeypatch.setattr(run, "parts", lambda study: parts)
        for name in ("draw_lot", "draw_ring", "draw_demonstrations"):
            monkeypatch.setattr(figures, name, lambda study, folder: [])

    return put


def fleet(*words: str) -> Any:
    return CliRunner().invoke(app, ["paper", *words])


def interrupt(tell: Any) -> Block:
    raise KeyboardInterrupt


def whole(*extra: Cell) -> Block:
    others = [cell(formula=f, kind=k) for f in ("phi_p", "phi_theta", "phi_r") for k in ("zonotope", "constrained")]
    return block(cell(formula=NONE_RING), *others[:-1], *(extra or others[-1:]))


def test_what_was_finished_is_kept_and_the_rest_is_named(small: Callable[..., None], tmp_path: Path) -> None:
    small(("first", lambda tell: whole()), ("second", interrupt), ("third", lambda tell: whole()))
    result = fleet("-o", str(tmp_path), "--simulated-only")
    assert result.exit_code == 130
    document = json.loads((tmp_path / "report.json").read_text())
    assert document["complete"] is False
    assert document["pending"][:2] == ["second", "third"]
    assert [found["title"] for found in document["blocks"]] == ["Ours"]
    text = (tmp_path / "report.md").read_text()
    assert "**INCOMPLETE**: not done: second, third" in text
    assert "| Ours | 2.000 |" in text


def test_a_part_that_raises_leaves_what_was_finished(small: Callable[..., None], tmp_path: Path) -> None:
    def broken(tell: Any) -> Block:
        raise UsageError("-o: the disk is full")

    small(("first", lambda tell: whole()), ("second", broken))
    result = fleet("-o", str(tmp_path), "--simulated-only")
    assert isinstance(result.exception, UsageError)
    assert json.loads((tmp_path / "report.json").read_text())["pending"][0] == "second"


@pytest.mark.integration
def test_a_signal_ends_it_in_order(tmp_path: Path) -> None:
    words = [sys.executable, "-m", "fleet_cli", "paper", "-o", str(tmp_path), "--simulated-only"]
    process = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)

    def done() -> int:
        file = tmp_path / "report.json"
        try:
            return len(json.loads(file.read_text())["blocks"]) if file.is_file() else 0
        except json.JSONDecodeError:
            return 0

    # A part is told of after the report with it is written: with the third block there, the second has been.
    wait_until(lambda: done() >= 3 or process.poll() is not None, 5 * DEADLINE)
    process.send_signal(signal.SIGTERM)
    _, errors = process.communicate(timeout=5 * DEADLINE)
    assert process.returncode == 130, errors
    assert "interrupted: what was finished is in the report" in errors
    assert "2/11 as the published code: " in errors
    document = json.loads((tmp_path / "report.json").read_text())
    assert document["pending"]
    assert not document["complete"]
    assert len(document["blocks"]) >= 2


def test_a_folder_that_cannot_be_made_is_told_first(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    result = fleet("-o", str(tmp_path / "file" / "below"), "--simulated-only")
    assert isinstance(result.exception, UsageError)
    assert "-o" in str(result.exception)
    assert "cannot be made" in str(result.exception)


@pytest.mark.skipif(os.geteuid() == 0, reason="root writes anywhere")
def test_a_folder_that_cannot_be_written_is_told_first(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    assert "cannot be written" in str(fleet("-o", str(tmp_path), "--simulated-only").exception)


@pytest.mark.parametrize(
    ("words", "error", "says"),
    [
        (["--recording", "x.npz"], UsageError, "--recording and --profile go together"),
        (["--profile", "dart"], UsageError, "--recording and --profile go together"),
        (["--simulated-only", "--recording", "x.npz", "--profile", "dart"], UsageError, "give one of them"),
        (["--recording", "x.npz", "--profile", "dart"], RecordingError, "x.npz: cannot be read"),
        (["--recording", __file__, "--profile", "dart"], RecordingError, ".py is not read"),
        (["--recording", DART, "--profile", "upenn"], RecordingError, "no state column"),
        (["--recording", F1TENTH, "--profile", "f1tenth"], RecordingError, "at least"),
    ],
)
def test_recordings_that_do_not_do_are_told_before_the_work(
    words: list[str], error: type[Exception], says: str, tmp_path: Path
) -> None:
    result = fleet("-o", str(tmp_path), *words)
    assert isinstance(result.exception, error)
    assert says in str(result.exception)
    assert not list(tmp_path.iterdir())


def test_without_the_project_the_recording_is_left_out_and_that_is_said(
    small: Callable[..., None], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from fleet_cli.commands import paper as command

    monkeypatch.setattr(command, "_RECORDING", tmp_path / "nowhere.npz")
    small(("first", lambda tell: whole()))
    assert fleet("-o", str(tmp_path)).exit_code == 0
    assert "recordings are not installed; name one with --recording" in (tmp_path / "report.md").read_text()


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        (cell(formula="phi_r", kind="constrained", outside=1), "1 of 9 states outside"),
        (
            cell(formula="phi_r", kind="constrained", algorithm_2=2.1, most_of_algorithm_2=1.25),
            "a set has 1.25 times the area of Algorithm 2's",
        ),
        (cell(formula="phi_r", kind="constrained", most_of_uncut=3.0), "a set has 3 times its area before any cut"),
    ],
)
def test_it_fails_where_a_state_is_lost_or_a_set_is_too_large(
    wrong: Cell, says: str, small: Callable[..., None], tmp_path: Path
) -> None:
    small(("first", lambda tell: whole(wrong)))
    result = fleet("-o", str(tmp_path), "--simulated-only")
    assert result.exit_code == 1
    assert says in " ".join(result.stdout.split())


def test_a_claim_that_is_missed_fails() -> None:
    found = Block("published_code", "Code", "", (cell(formula=NONE, area=9.9, uncut=9.9, printed=9.722),))
    document = report.as_document(0, [found], [], [], None)
    assert [text.partition(":")[0] for text in report.failures(document)] == ["9.722 (none, zonotope) within 1%"]


def test_states_outside_in_demonstrations_are_no_failure() -> None:
    document = report.as_document(0, [block(cell(outside=5), unsound=True)], [], [], None)
    assert report.failures(document) == []


def test_json_goes_to_stdout_alone(small: Callable[..., None], tmp_path: Path) -> None:
    small(("first", lambda tell: whole()))
    result = fleet("-o", str(tmp_path), "--simulated-only", "--json", "-")
    assert json.loads(result.stdout)["blocks"][0]["cells"][1]["ratio"] == 0.5


def test_the_figures_are_files_of_both_forms(tmp_path: Path) -> None:
    from fleet_lab.paper.study import Study

    paths = [*figures.draw_lot(Study(0), tmp_path), *figures.draw_demonstrations(Study(0), tmp_path)]
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(path.name for path in paths)
    for path in paths:
        start = path.read_bytes()[:4]
        assert start == (b"\x89PNG" if path.suffix == ".png" else b"%PDF")
    assert np.mean([path.stat().st_size for path in paths]) > 10_000
