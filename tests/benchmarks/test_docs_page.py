"""The page of measured figures is what its figures give, and no other page states any."""

import json
import os
import re
import subprocess
from pathlib import Path

import pytest

from benchmarks import conditions, docs_page, suite
from benchmarks.report import Outcome, Report, read
from fleet_bus.errors import UsageError
from tests.benchmarks import made

DOCS = docs_page.DOCS
#: Speed, as somebody would state it who has measured it.
SPEED = re.compile(r"\d\s?µs\b|\bµs (?:a|per) \w+|[\d.]+ ?(?:times|×|x) (?:faster|slower|as fast|tighter|smaller than)")
#: What other pages say in words, and the figure that it is about: page, words, benchmark, row, column, from, to.
STATED = (
    ("mathematics.md", "of which the area is 1.3 % more than that of the disc",
     "disc", "16 tangents, without a set: over the disc", "over the exact one", 1.0125, 1.0135),
    ("mathematics.md", "leaves its band about once in 30 000 checks",
     "audit", "honest: 1 %, independent", "checks between", 25_000.0, 37_000.0),
    ("mathematics.md", "outside 3 % of the time", "audit", "honest: 1 %, independent", "outside %", 2.5, 3.5),
    ("concepts/guarantees.md", "leaves its band about once in 30 000 checks and spends 3 % of the time outside",
     "audit", "honest: 1 %, independent", "outside %", 2.5, 3.5),
    ("concepts/guarantees.md", "at least 98.9 % lie inside at every step",
     "recordings", "DART, calibrated", "inside, least %", 98.85, 98.95),
    ("concepts/guarantees.md", "a quarter of the tubes is labelled `contradicted`",
     "recordings", "DART, calibrated", "contradicted %", 22.0, 28.0),
    ("concepts/guarantees.md", "One in eight of its states lies outside at step 10",
     "recordings", "F1TENTH, Koopman, calibrated", "worst run %", 86.0, 89.0),
    ("concepts/guarantees.md", "All runs together are above 99 % at every step",
     "recordings", "F1TENTH, Koopman, calibrated", "inside, least %", 99.0, 100.0),
    ("concepts/methods.md", "about 2.2 times as wide after ten steps",
     "containment", "linear, set_membership", "width, 10", 2.1, 2.3),
    ("concepts/methods.md", "those of `lti` about 3.5 times", "containment", "linear, lti", "width, 10", 3.4, 3.6),
    ("concepts/methods.md", "it is about 20 times", "containment", "bicycle, body frame, set_membership", "width, 10",
     18.0, 22.0),
    ("concepts/methods.md", "with the hull of the residuals about 58 times",
     "containment", "bicycle, body frame, residual_hull", "width, 10", 55.0, 61.0),
    ("concepts/methods.md", "After one step it is about 2.8 times",
     "containment", "bicycle, body frame, set_membership", "width, 1", 2.7, 2.9),
    ("concepts/methods.md", "about 0.0002 m² instead",
     "recordings", "DART, calibrated", "published, last", 1.5e-4, 2.5e-4),
    ("concepts/methods.md", "instead of about 0.9 m²", "recordings", "DART, paper", "published, last", 0.85, 0.95),
)  # fmt: skip


@pytest.fixture(scope="module")
def report() -> Report:
    return read(DOCS / docs_page.FIGURES, "docs")


def test_the_page_is_what_its_figures_give(report: Report) -> None:
    assert (DOCS / docs_page.PAGE).read_text(encoding="utf-8") == docs_page.page(report)


def test_the_page_is_of_a_full_run_of_all_benchmarks(report: Report) -> None:
    assert report.complete
    assert not report.quick
    assert list(report.benchmarks) == list(suite.BENCHMARKS)


def test_every_benchmark_has_one_place_and_its_plot(report: Report) -> None:
    placed = [name for section in docs_page.SECTIONS for name in section.names]
    assert sorted(placed) == sorted(suite.BENCHMARKS)
    shown = set(re.findall(r"\]\((pictures/[^)]+)\)", docs_page.page(report)))
    assert shown == {f"pictures/bench-{name}.png" for name, one in report.benchmarks.items() if one.plot is not None}
    assert shown
    assert all((DOCS / path).is_file() for path in shown)


def test_a_claim_that_is_missed_is_shown_at_the_top() -> None:
    tables = dict.fromkeys(suite.BENCHMARKS, made.table())
    page = docs_page.page(made.report(tables))
    top = page.partition("## An update")[0]
    assert "* too much: 1.6, wanted ≤ 1.5." in top
    assert "enough" not in top
    assert page.count("| too much | 1.6 | ≤ 1.5 | **MISSED** |") == len(tables)


def test_no_page_is_made_of_a_run_that_was_not_finished(report: Report) -> None:
    last = list(suite.BENCHMARKS)[-1]
    cut = {**report.benchmarks, last: Outcome(status="not run", message="interrupted")}
    with pytest.raises(UsageError, match=f"{last} was not finished"):
        docs_page.page(report.model_copy(update={"benchmarks": cut}))


def test_a_report_becomes_page_figures_and_pictures(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "plots").mkdir()
    (tmp_path / "plots" / "wire.png").write_bytes(b"picture")
    (tmp_path / "docs" / "pictures").mkdir(parents=True)
    monkeypatch.setattr(docs_page, "DOCS", tmp_path / "docs")
    with pytest.raises(UsageError, match="not the documentation of a checkout"):
        docs_page.check(whole=True)
    done = made.report(dict.fromkeys(suite.BENCHMARKS, made.table()))
    drawn = {**done.benchmarks, "wire": done.benchmarks["wire"].model_copy(update={"plot": "plots/wire.png"})}
    done = done.model_copy(update={"benchmarks": drawn})
    docs_page.write(done, tmp_path)
    assert (tmp_path / "docs" / "benchmarks.md").read_text(encoding="utf-8") == docs_page.page(done)
    assert json.loads((tmp_path / "docs" / "benchmarks.json").read_text(encoding="utf-8"))["complete"]
    assert (tmp_path / "docs" / "pictures" / "bench-wire.png").read_bytes() == b"picture"


def test_only_committed_code_on_a_machine_at_rest_is_published(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def git(*words: str) -> None:
        called = ["git", "-c", "user.name=n", "-c", "user.email=e@x", "-C", str(tmp_path), *words]
        subprocess.run(called, check=True, capture_output=True)

    monkeypatch.setattr(conditions, "ROOT", tmp_path)
    monkeypatch.setattr(docs_page, "DOCS", tmp_path / "docs")
    monkeypatch.setattr(os, "cpu_count", lambda: 4)
    loads = [0.0]
    monkeypatch.setattr(os, "getloadavg", lambda: loads)
    (tmp_path / "docs").mkdir()
    for name in ("code.py", "docs/index.md"):
        (tmp_path / name).write_text("one\n", encoding="utf-8")
    git("init")
    git("add", ".")
    git("commit", "-m", "all")
    (tmp_path / "docs" / "index.md").write_text("two\n", encoding="utf-8")
    docs_page.check(whole=True)
    (tmp_path / "code.py").write_text("two\n", encoding="utf-8")
    with pytest.raises(UsageError, match=r"--docs: the figures would be of no commit: commit code\.py first, or add"):
        docs_page.check(whole=True)
    docs_page.check(whole=True, even_so=True)
    git("commit", "-am", "more")
    docs_page.check(whole=True)
    loads[0] = 2.9
    with pytest.raises(UsageError, match=r"--docs: 2\.9 of 4 cores were busy .* less than 2\.8 are, or add --even-so"):
        docs_page.check(whole=True)
    docs_page.check(whole=True, even_so=True)
    with pytest.raises(UsageError, match="only a full run"):
        docs_page.check(whole=False, even_so=True)


@pytest.mark.parametrize("stated", STATED, ids=[one[1] for one in STATED])
def test_what_other_pages_state_was_measured(
    report: Report, stated: tuple[str, str, str, str, str, float, float]
) -> None:
    page, words, benchmark, row, column, low, high = stated
    assert words in " ".join((DOCS / page).read_text(encoding="utf-8").split())
    (figure,) = [value for name, of, value in report.tables[benchmark].figures() if (name, of) == (row, column)]
    assert low <= figure <= high


def test_speed_is_stated_on_that_page_only() -> None:
    assert SPEED.search("one set takes 16 µs")
    assert SPEED.search("it is 3.5 times faster")
    stated = {}
    for path in (DOCS.parent / "README.md", *DOCS.rglob("*.md")):
        if path.name not in (docs_page.PAGE, "paper.md"):
            text = re.sub(r"^```.*?^```$|`[^`\n]*`", "", path.read_text(encoding="utf-8"), flags=re.M | re.S)
            if found := SPEED.findall(text):
                stated[path.name] = found
    assert not stated, "measure it in benchmarks, and link to the page"
