"""The suite and its command: failures, interruptions, folders, earlier runs. Benchmarks are made up here."""

import json
import signal
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from benchmarks import suite
from benchmarks.conditions import THREADS
from benchmarks.report import Report, Table
from fleet_bus.errors import UsageError
from fleet_cli.main import app
from tests.benchmarks import made


@pytest.fixture(autouse=True)
def _in_this_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """The command begins anew where a library might take several threads."""
    for name, number in THREADS.items():
        monkeypatch.setenv(name, number)


def bench(folder: Path, *words: str) -> Result:
    return CliRunner().invoke(app, ["bench", "-o", str(folder), *words])


def document(folder: Path) -> dict[str, object]:
    found = json.loads((folder / "report.json").read_text(encoding="utf-8"))
    return {"complete": found["complete"], **{n: (o["status"], o["message"]) for n, o in found["benchmarks"].items()}}


def test_a_run_leaves_one_report(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made.install(monkeypatch, first=made.works, second=made.works)
    result = bench(tmp_path / "new" / "folder")
    assert result.exit_code == 0, result.output
    folder = tmp_path / "new" / "folder"
    assert document(folder) == {"complete": True, "first": ("done", ""), "second": ("done", "")}
    page = (folder / "report.md").read_text(encoding="utf-8")
    for name in ("first", "second"):
        assert f"](plots/{name}.png)" in page
        assert (folder / "plots" / f"{name}.png").stat().st_size > 1000
    assert "[1/2] first …" in result.stderr
    assert "[2/2] second done" in result.stderr
    assert "2 of 6 claims are met" in result.stdout
    assert len(list((folder / "history").glob("*.json"))) == 1


def test_one_that_fails_does_not_stop_the_others(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made.install(monkeypatch, bad=made.raises, peerless=made.lacks, good=made.works)
    result = bench(tmp_path)
    assert result.exit_code == 1
    assert document(tmp_path) == {
        "complete": False,
        "bad": ("failed", "ArithmeticError: no way"),
        "peerless": ("not run", "zonoopt is not installed: install fleet-reach[bench]"),
        "good": ("done", ""),
    }
    assert "failed: bad: ArithmeticError: no way" in result.stdout
    assert "**failed: ArithmeticError: no way**" in (tmp_path / "report.md").read_text(encoding="utf-8")


def test_a_module_of_our_own_that_is_missing_is_a_failure(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made.install(monkeypatch, good=made.works)
    monkeypatch.setattr(suite, "BENCHMARKS", {"good": "", "nowhere": ""})
    assert bench(tmp_path).exit_code == 1
    assert document(tmp_path)["nowhere"] == ("failed", "ModuleNotFoundError: No module named 'benchmarks.nowhere'")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_run_keeps_what_was_finished(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: signal.Signals
) -> None:
    before = signal.getsignal(number)
    made.install(monkeypatch, first=made.works, second=made.ended_by(number), third=made.raises)
    result = bench(tmp_path)
    assert result.exit_code == 130
    assert document(tmp_path) == {
        "complete": False, "first": ("done", ""), "second": ("not run", "interrupted"),
        "third": ("not run", "interrupted"),
    }  # fmt: skip
    page = (tmp_path / "report.md").read_text(encoding="utf-8")
    assert "| ours | 1.25 |" in page
    assert "## third\n\n**not run: interrupted**" in page
    assert len(list((tmp_path / "history").glob("*.json"))) == 1
    assert signal.getsignal(number) is before


@pytest.mark.parametrize("lost", [False, True], ids=["another exception", "none"])
def test_a_signal_that_a_benchmark_makes_something_else_of(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, lost: bool
) -> None:
    def second(quick: bool) -> Table:
        try:
            signal.raise_signal(signal.SIGINT)
        except KeyboardInterrupt:
            signal.raise_signal(signal.SIGINT)
            if not lost:
                raise SystemError("a result with an exception set") from None
        return made.table()

    made.install(monkeypatch, first=made.works, second=second, third=made.raises)
    assert bench(tmp_path).exit_code == 130
    assert document(tmp_path) == {
        "complete": False, "first": ("done", ""), "second": ("not run", "interrupted"),
        "third": ("not run", "interrupted"),
    }  # fmt: skip


def test_a_signal_while_the_report_is_written_waits_until_it_is(tmp_path: Path) -> None:
    written: list[str] = []

    def keep(report: Report) -> None:
        signal.raise_signal(signal.SIGTERM)
        written.append(report.benchmarks["wire"].message)

    report = suite.run(["wire"], keep, tmp_path, lambda number, name, outcome: None, quick=True)
    assert written == [suite.NOT_YET, suite.INTERRUPTED]
    assert suite.interrupted(report)


def test_a_folder_that_cannot_be_made_is_told_before_the_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made.install(monkeypatch, bad=made.raises)
    taken = tmp_path / "taken"
    taken.write_text("a file", encoding="utf-8")
    for folder in (taken, taken / "below"):
        result = bench(folder)
        assert isinstance(result.exception, UsageError)
        assert str(folder) in str(result.exception)
        assert "[1/1]" not in result.stderr
    (tmp_path / "full" / "report.json").mkdir(parents=True)
    result = bench(tmp_path / "full")
    assert isinstance(result.exception, UsageError)
    assert "report.json: cannot be written" in str(result.exception)
    assert "[1/1]" not in result.stderr


@pytest.mark.slow
def test_a_later_run_is_compared_with_the_one_before(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made.install(monkeypatch, first=made.works, second=made.works)
    assert "since" not in bench(tmp_path).stdout
    made.install(monkeypatch, first=lambda quick: made.table([("ours", 2.5), ("theirs", 12345.6)]))
    result = bench(tmp_path, "first")
    assert "1 of 2 figures changed by more than 10 %" in result.stdout
    assert "1 of 2 figures changed by more than 10 %" in (tmp_path / "report.md").read_text(encoding="utf-8")
    first = str(min((tmp_path / "history").iterdir()))
    assert (
        "0 of 2 figures changed by more than 150 %" in bench(tmp_path, "--threshold", "150", "--compare", first).stdout
    )
    foreign = tmp_path / "foreign.json"
    foreign.write_text('{"benchmarks": []}', encoding="utf-8")
    result = bench(tmp_path, "--compare", str(foreign))
    assert isinstance(result.exception, UsageError)
    assert "foreign.json: not a report of this suite" in str(result.exception)


def test_json_on_stdout_is_all_there_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made.install(monkeypatch, first=made.works)
    result = bench(tmp_path, "--json", "-")
    assert json.loads(result.stdout) == json.loads((tmp_path / "report.json").read_text(encoding="utf-8"))


def test_wrong_use_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    result = bench(tmp_path, "strips", "nonsense")
    assert isinstance(result.exception, UsageError)
    assert f"no benchmark nonsense: there are {', '.join(suite.BENCHMARKS)}" in str(result.exception)
    for words in (("strips", "--docs"), ("--quick", "--docs")):
        result = bench(tmp_path, *words)
        assert isinstance(result.exception, UsageError)
        assert "only a full run" in str(result.exception)
    listed = bench(tmp_path, "--list").stdout
    assert [line.split()[0] for line in listed.splitlines()] == list(suite.BENCHMARKS)


@pytest.mark.parametrize("name", list(suite.BENCHMARKS))
@pytest.mark.slow
def test_each_benchmark_runs(name: str, tmp_path: Path) -> None:
    """Quickly; its rows have names of their own, and all of it can be written down."""
    report = suite.run([name], lambda report: None, tmp_path, lambda number, name, outcome: None, quick=True)
    assert report.benchmarks[name].message == ""
    table = report.tables[name]
    assert table.rows
    names = [row[: table.keys] for row in table.rows]
    assert len(set(names)) == len(names)
    assert list(table.figures())
    assert Report.model_validate_json(report.as_text()) == report
