"""Runs held against earlier ones."""

from pathlib import Path

import pytest

from benchmarks import history
from benchmarks.page import as_markdown
from benchmarks.report import Claim, Report, Table, read
from fleet_bus.errors import UsageError
from tests.benchmarks import made


def at(hour: int, *, quick: bool = False) -> Report:
    conditions = made.CONDITIONS.model_copy(update={"date": f"2026-11-22T{hour:02}:00:00+00:00"})
    return made.report(conditions=conditions, quick=quick)


def test_changes_beyond_the_threshold_are_found_by_row() -> None:
    then = made.report({"a": made.table([("x", 10.0), ("y", 10.0), ("z", 10.0), ("gone", 1.0)]), "b": made.table()})
    now = made.report({"a": made.table([("new", 1.0), ("z", 9.0), ("y", 11.5), ("x", 10.9)])})
    found = history.compare("then.json", then, now, 10.0)
    assert found.compared == 3
    assert [(c.benchmark, c.row, c.figure, c.then, c.now) for c in found.changes] == [
        ("a", "z", "µs", 10.0, 9.0), ("a", "y", "µs", 10.0, 11.5),
    ]  # fmt: skip
    assert found.changes[1].ratio == pytest.approx(1.15)
    assert [c.row for c in history.compare("then.json", then, now, 12.0).changes] == ["y"]
    page = as_markdown(now, found)
    assert "2 of 3 figures changed by more than 10 %:" in page
    assert "| a | y | µs | 10 | 11.5 | 1.15 |" in page


def test_what_was_nothing_has_no_ratio() -> None:
    then, now = (made.report({"a": made.table([("lost", n), ("kept", 0.0)])}) for n in (0.0, 3.0))
    (change,) = history.compare("then.json", then, now, 10.0).changes
    assert (change.row, change.ratio) == ("lost", None)


def test_numbers_that_name_a_row_are_no_figures() -> None:
    rows = [("V", 1, 5.0), ("V", 10, 2.0)]
    one = Table("A", "Note.", ("varied", "to", "µs"), list(rows), keys=2)
    assert list(one.figures()) == [("V, 1", "µs", 5.0), ("V, 10", "µs", 2.0)]


def test_a_claim_that_turns_and_another_machine_are_told() -> None:
    then = made.report({"a": made.table(claims=[Claim("fast", 1.0, "≤", 2.0), Claim("small", 9.0, "≤", 2.0)])})
    conditions = made.CONDITIONS.model_copy(update={"machine": "n", "versions": {"numpy": "2.5", "rtamt": "0.4"}})
    now = made.report(
        {"a": made.table(claims=[Claim("fast", 3.0, "≤", 2.0), Claim("small", 9.0, "≤", 2.0)])},
        conditions=conditions, quick=True,
    )  # fmt: skip
    found = history.compare("then.json", then, now, 10.0)
    assert [claim.text for claim in found.turned] == ["fast"]
    assert found.differences == [
        "then a full run, now a quick one", "machine: then m, now n", "numpy: then 2.4, now 2.5",
        "rtamt: then –, now 0.4",
    ]  # fmt: skip
    page = as_markdown(now, found)
    assert "* machine: then m, now n" in page
    assert "Claim *fast*: MISSED now, met then." in page


def test_the_newest_run_of_the_same_kind_is_taken(tmp_path: Path) -> None:
    assert history.earlier(None, tmp_path, pytest.fail, quick=False) is None
    with pytest.raises(UsageError, match="--compare latest: there is no earlier run"):
        history.earlier("latest", tmp_path, pytest.fail, quick=False)
    names = [history.keep(one, tmp_path).name for one in (at(9), at(10), at(11, quick=True))]
    assert names == [f"2026-11-22T{hour}-00-00Z.json" for hour in ("09", "10", "11")]

    def found(which: str | None, *, quick: bool) -> str:
        earlier = history.earlier(which, tmp_path, pytest.fail, quick=quick)
        assert earlier is not None
        return earlier[0]

    assert found(None, quick=False) == names[1]
    assert found(None, quick=True) == names[2]
    assert found("latest", quick=False) == names[2]
    assert found(str(tmp_path / names[0]), quick=True) == names[0]


def test_a_foreign_file_in_the_history_is_left_out_and_named(tmp_path: Path) -> None:
    (tmp_path / "zzz.json").write_text("{}", encoding="utf-8")
    (tmp_path / "yyy.json").mkdir()
    for which in (None, "latest"):
        kept = history.keep(at(9), tmp_path)
        told: list[str] = []
        found = history.earlier(which, tmp_path, told.append, quick=False)
        assert found is not None
        assert found[0] == kept.name
        assert [f"{name}.json: " in line for name, line in zip(("zzz", "yyy"), told, strict=True)] == [True, True]
        assert "zzz.json: not a report of this suite" in told[0]
    with pytest.raises(UsageError, match=r"zzz\.json: not a report of this suite"):
        history.earlier(str(tmp_path / "zzz.json"), tmp_path, told.append, quick=False)


def test_runs_of_the_same_second_are_all_kept(tmp_path: Path) -> None:
    runs = [made.report({"a": made.table([("x", float(number))])}) for number in range(11)]
    kept = [history.keep(run, tmp_path) for run in runs]
    assert sorted(kept) == kept
    assert [read(path, "") for path in kept] == runs
    found = history.earlier(None, tmp_path, pytest.fail, quick=False)
    assert found == (kept[-1].name, runs[-1])


def test_a_run_that_cannot_be_kept_leaves_no_empty_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(option: str, path: Path, text: str) -> None:
        raise UsageError("full")

    monkeypatch.setattr(history, "write_text", full)
    with pytest.raises(UsageError, match="full"):
        history.keep(at(9), tmp_path)
    assert list(tmp_path.iterdir()) == []
