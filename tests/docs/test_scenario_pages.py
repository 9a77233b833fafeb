"""The pages about scenarios keep step with the language and with what the commands print."""

import contextlib
import io
import re
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from fleet_bus.messages import Event, EventKind
from fleet_cli.main import app
from reach_server.side_information.scenarios import MOST_BRANCHES
from reach_server.side_information.verdict import verdict
from side_info import Scenario, ScenarioError
from side_info.documents.document import RegionFields, ScenarioFields, TimeFields
from side_info.documents.lint import MANY_PREDICATES, lint
from side_info.documents.yaml_text import MAX_BYTES
from side_info.progression import Table
from side_info.stl.declarations import RESERVED
from side_info.stl.functions import FUNCTIONS
from side_info.stl.inequality import MAX_KINKS, MAX_WORK
from side_info.stl.normal_form import MAX_PREDICATES, MAX_SIZE
from side_info.stl.parser import MAX_DEPTH, MAX_LENGTH
from side_info.stl.windows import MAX_SECONDS
from tests.docs.test_docs import DOCS, blocks, page, section
from tests.fleet_bus.messages.examples import a_tube

LANGUAGE = DOCS / "reference" / "scenario-language.md"
CONCEPT = DOCS / "concepts" / "side-information.md"
GUIDE = DOCS / "how-to" / "write-a-scenario.md"
EXAMPLE = DOCS / "examples" / "read_verdicts.py"

#: A document with a warning of each kind, at samples of 0.05 s.
WARNED = """\
scenario: warned
version: 1
state: {x: m, y: m}
time: {zero: on_start, semantics: sampled}
parameters: {T: 10 s, R: 3 s}
regions:
  A: "0 <= x <= 2"
  B: "x >= 3"
  C: "y >= 0"
assume: >-
  always[0:T](A) and always[T:20 s](y <= 1)
  and eventually[0.51:0.54](y <= 0) and always[0.51:0.54](y <= 0)
  and eventually[0.98:1.02](y <= 0)
monitor:
  now: "A"
  never: "eventually[0:T](A and B)"
  trivial: "always[0:T](A -> x >= -1)"
"""


def first_column(text: str) -> list[str]:
    """Code spans in the first cells of the tables of a text."""
    return [span for row in re.findall(r"^\| (`[^|]*) \|", text, re.M) for span in re.findall(r"`([^`]+)`", row)]


def spaced(number: int) -> str:
    return f"{number:,}".replace(",", " ")


def test_the_fields_of_a_document_are_on_the_page() -> None:
    names = first_column(section(LANGUAGE.read_text(encoding="utf-8"), "The document"))
    assert names == [*ScenarioFields.model_fields, *TimeFields.model_fields]
    forms = re.findall(r"^\| (\w+) \| `", section(page("reference/scenario-language.md"), "The document"), re.M)
    assert forms == list(RegionFields.model_fields)


def test_the_words_and_functions_of_the_language_are_on_the_page() -> None:
    text = LANGUAGE.read_text(encoding="utf-8")
    assert set(re.findall(r"`(\w+)`", section(text, "Words"))) == RESERVED
    functions = section(text, "Formulas").partition("| function |")[2].partition("\n\n")[0]
    assert sorted(first_column(functions)) == sorted(FUNCTIONS)


def test_the_limits_are_on_the_pages() -> None:
    listed = section(LANGUAGE.read_text(encoding="utf-8"), "Limits")
    for number in (MAX_BYTES, MAX_LENGTH, MAX_DEPTH, MAX_PREDICATES, MAX_KINKS, MAX_WORK):
        assert re.search(rf"\b{spaced(number)}\b", listed), number
    assert str(MAX_SIZE) in listed
    assert MAX_SECONDS == 1e9
    caps = section(CONCEPT.read_text(encoding="utf-8"), "Limits")
    for number in (MAX_PREDICATES, MAX_SIZE, Table().max_alternatives, MOST_BRANCHES):
        assert re.search(rf"\| {number} \|", caps), number


def test_each_warning_is_on_the_page() -> None:
    many = " and ".join(f"x + {k}*y >= 0" for k in range(MANY_PREDICATES))
    documents = (WARNED, WARNED.replace("(y <= 1)", f"(y <= 1 and {many})"))
    messages = [finding.message for text in documents for finding in lint(Scenario.parse(text), 0.05)]
    listed = first_column(section(LANGUAGE.read_text(encoding="utf-8"), "Warnings"))

    def shown(pattern: str, message: str) -> bool:
        # An ellipsis stands for anything.
        return re.search(".*".join(map(re.escape, pattern.split("…"))), message) is not None

    for pattern in listed:
        assert any(shown(pattern, message) for message in messages), pattern
    for message in messages:
        assert any(shown(pattern, message) for pattern in listed), message


def test_each_verdict_is_on_the_pages() -> None:
    settled, dead, other = 1, 0, 2
    found = {
        verdict([other], [dead], settled, dead),
        verdict([dead], [other], settled, dead),
        verdict([settled], [other], settled, dead),
        verdict([other], [settled], settled, dead),
        verdict([other, settled], [other, settled], settled, dead),
    }
    for text in found:
        kind, _, step = text.partition(", ")
        assert f"| `{kind}` |" in page("concepts/side-information.md"), text
        assert f"`{kind}`" in page("reference/wire.md"), text
        assert not step or step == "may be violated at step 1"
    for path in ("concepts/side-information.md", "reference/wire.md"):
        assert ", may be violated at step " in page(path)


@pytest.mark.parametrize("path", [LANGUAGE, CONCEPT], ids=["language", "concept"])
def test_what_a_page_says_is_printed_is_printed(path: Path) -> None:
    (block,) = blocks(path, "python")
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        exec(compile(block, path.name, "exec"), {"__name__": "docs"})
    assert any(text.split() == printed.getvalue().split() for text in blocks(path, "text"))


def fleet(*arguments: str) -> tuple[int, str, str]:
    """Exit code, output and error text of the command."""
    result = CliRunner().invoke(app, list(arguments), env={"COLUMNS": "120"})
    error = result.exception if isinstance(result.exception, ScenarioError) else ""
    return result.exit_code, result.stdout, str(error)


def test_the_scenario_of_the_guide_checks_and_shows_as_the_guide_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (document,) = blocks(GUIDE, "yaml")
    monkeypatch.chdir(tmp_path)
    Path("lot.yaml").write_text(document, encoding="utf-8")
    texts = blocks(GUIDE, "text")
    checks = [block.splitlines() for block in blocks(GUIDE, "console") if "scenario check" in block]
    assert checks
    for line, *expected in checks:
        code, out, _ = fleet(*line.removeprefix("$ fleet ").split())
        assert (code, out.splitlines()) == (0, expected)
    code, out, _ = fleet("scenario", "show", "lot.yaml", "--sample-time", "0.05", "-o", "lot.png")
    assert code == 0
    lines = [row.rstrip() for row in out.splitlines() if not row.startswith("picture:")]
    assert any(text.splitlines() == lines for text in texts)
    Path("lot.yaml").write_text(document.replace("and north)", "and nort)"), encoding="utf-8")
    _, _, error = fleet("scenario", "check", "lot.yaml")
    assert f"error: {error}\n" in texts


def test_the_errors_on_the_page_of_the_language_are_those_of_the_parser() -> None:
    shown = blocks(LANGUAGE, "text")[:2]
    document = """\
# A yard: in the lane for 10 s, through the gate within that time, then on the turning circle.
scenario: yard
version: 1
state: {px: m, py: m, v: m/s}
time: {zero: on_start, semantics: sampled}
parameters: {T: 10 s}
regions:
  lane: "abs(py) <= 1.5"
  gate: {box: {px: [14, 16], py: [-1, 1]}}
  turn: {disc: {center: {px: 20, py: 0}, radius: 4}}
assume: >-
  always[0:T](lane and v <= 2) and eventually[0:T](gate)
  and always[T:15 s](turn)
"""
    for text, (old, new) in zip(shown, (("(gate)", "(gat)"), ("sampled", "continuous")), strict=True):
        with pytest.raises(ScenarioError) as caught:
            Scenario.parse(document.replace(old, new), "yard.yaml")
        assert text == f"error: {caught.value}\n"


def test_the_guide_shows_the_whole_example() -> None:
    assert EXAMPLE.read_text(encoding="utf-8") in blocks(GUIDE, "python")


def test_the_example_tells_of_each_verdict_once_and_of_events() -> None:
    names: dict[str, Any] = {"__name__": "example"}
    exec(EXAMPLE.read_text(encoding="utf-8"), names)
    describe = names["describe"]
    known: dict[tuple[str, str], str] = {}
    tube = a_tube(vehicle="svea1", verdicts={"lot.slow": "undecided (time)"})
    assert describe(names["TUBE"], tube.encode(), known) == ["svea1 lot.slow: undecided (time)"]
    assert describe(names["TUBE"], tube.encode(), known) == []
    later = a_tube(vehicle="svea1", verdicts={"lot.slow": "violated"})
    assert describe(names["TUBE"], later.encode(), known) == ["svea1 lot.slow: violated"]
    event = Event(
        kind=EventKind.CONTRADICTION, vehicle="svea1", t=1, source="reach-1", message="lot is false",
        details={"scenario": "lot", "predicate": "P.x1", "elapsed": 2.5},
    )  # fmt: skip
    line = "svea1 event contradiction: lot is false (scenario lot, predicate P.x1, elapsed 2.5)"
    assert describe(names["EVENT"], event.encode(), known) == [line]
    assert describe("application/json", b"\x80", known) == []
