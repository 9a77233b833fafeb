"""What becomes of a changed scenario file; no test waits for a clock."""

import os
from dataclasses import replace
from pathlib import Path

import pytest

from side_info import Scenario
from side_info.service import watching
from side_info.service.watching import Look, Refusal, Stamp, Watched, take_in
from tests.side_info.corpus import DOCUMENT

SECOND = DOCUMENT.replace("version: 1", "version: 2")
MISSING = Look(None, None, "cannot be read: No such file or directory")


def begun() -> Watched:
    return Watched.begin(Path("lot.yaml"), Scenario.parse(DOCUMENT))


def shown(text: str, modified: int = 1) -> Look:
    return Look(Stamp(modified, modified, len(text), 7), text)


def decided(watched: Watched, *looks: Look) -> tuple[Watched, list[Scenario | Refusal]]:
    decisions = []
    for look in looks:
        watched, decision = take_in(watched, look)
        if decision is not None:
            decisions.append(decision)
    return watched, decisions


def refusal(watched: Watched, text: str) -> Refusal:
    after, (decision,) = decided(watched, shown(text), shown(text), shown(text))
    assert isinstance(decision, Refusal)
    assert after.scenario is watched.scenario
    assert after.behind
    return decision


def test_an_unchanged_file_says_nothing() -> None:
    watched, decisions = decided(begun(), shown(DOCUMENT), shown(DOCUMENT, 2), shown(DOCUMENT, 2))
    assert decisions == []
    assert not watched.behind


def test_a_greater_version_is_published_once() -> None:
    watched, (scenario,) = decided(begun(), *[shown(SECOND)] * 3)
    assert isinstance(scenario, Scenario)
    assert (scenario.version, scenario.text) == (2, SECOND)
    assert watched.scenario is scenario
    assert not watched.behind


def test_a_content_counts_when_two_looks_in_a_row_show_it() -> None:
    half = shown(SECOND[: len(SECOND) // 2])
    _, decisions = decided(begun(), half, shown(SECOND, 2), shown(DOCUMENT, 3), MISSING, shown(SECOND, 4))
    assert decisions == []


@pytest.mark.parametrize("version", ["1", "2"])
def test_a_changed_text_needs_a_greater_version(version: str) -> None:
    published = Watched.begin(Path("lot.yaml"), Scenario.parse(SECOND))
    found = refusal(published, SECOND.replace("version: 2", f"version: {version}") + "# a word more\n")
    assert found.reason == "document_version"
    assert f"its version {version} did not rise above 2: raise version to 3" in found.detail


def test_a_document_that_does_not_check_is_refused_at_its_place() -> None:
    found = refusal(begun(), SECOND.replace("](P) and", "](Q) and"))
    assert found.reason == "document_invalid"
    line = SECOND[: SECOND.index("](P) and")].count("\n") + 1
    assert f"lot.yaml:{line}:21: 'Q' is not declared" in found.detail
    assert "version 1 stays published" in found.detail


def test_a_renamed_scenario_is_refused() -> None:
    found = refusal(begun(), SECOND.replace("scenario: lot", "scenario: yard"))
    assert found.reason == "document_renamed"
    assert "it now names scenario 'yard', 'lot' is published" in found.detail


def test_a_file_that_is_gone_is_told_once_and_may_come_back() -> None:
    watched, (gone,) = decided(begun(), shown(DOCUMENT), *[MISSING] * 4)
    assert isinstance(gone, Refusal)
    assert gone.reason == "document_unreadable"
    assert "lot.yaml: cannot be read: No such file" in gone.detail
    assert watched.behind
    watched, decisions = decided(watched, *[shown(DOCUMENT, 2)] * 2)
    assert decisions == []
    assert not watched.behind
    watched, again = decided(watched, *[MISSING] * 2, *[shown(SECOND, 3)] * 2)
    assert [type(decision) for decision in again] == [Refusal, Scenario]
    assert not watched.behind


def test_what_was_refused_is_published_when_it_is_mended() -> None:
    changed = DOCUMENT + "# a word more\n"
    mended = changed.replace("version: 1", "version: 5")
    watched, (refused, scenario) = decided(begun(), *[shown(changed)] * 2, *[shown(mended, 2)] * 2)
    assert isinstance(refused, Refusal)
    assert isinstance(scenario, Scenario)
    assert watched.scenario.version == 5


def test_a_file_is_read_until_two_looks_agree_and_again_when_its_stamp_changes(tmp_path: Path) -> None:
    path = tmp_path / "lot.yaml"
    path.write_text(DOCUMENT, encoding="utf-8")
    watched = Watched.begin(path, Scenario.parse(DOCUMENT))
    first = watching.look(watched)
    assert first.text == DOCUMENT
    watched, _ = take_in(watched, first)
    assert not watched.settled
    watched, _ = take_in(watched, watching.look(watched))
    assert watched.settled
    assert watching.look(watched) is watched.seen
    os.utime(path, ns=(1, 1))
    touched = watching.look(watched)
    assert touched != watched.seen
    assert touched.shows(watched.seen)
    # Two contents under one stamp: the second is found, because the first was seen only once.
    watched, _ = take_in(watched, replace(touched, text="half a document"))
    assert watching.look(watched).text == DOCUMENT


def test_what_cannot_be_read_is_a_look_too(tmp_path: Path) -> None:
    path = tmp_path / "lot.yaml"
    watched = Watched.begin(path, Scenario.parse(DOCUMENT))
    assert watching.look(watched) == Look(None, None, "cannot be read: No such file or directory")
    path.write_bytes(b"\xff")
    assert watching.look(watched).problem == "is not UTF-8 text"
    path.unlink()
    path.mkdir()
    assert watching.look(watched) == Look(None, None, "is no file any more")
    path.rmdir()
    os.mkfifo(path)
    assert watching.look(watched) == Look(None, None, "is no file any more")


def test_of_a_huge_file_no_more_is_read_than_a_document_may_have(tmp_path: Path) -> None:
    path = tmp_path / "lot.yaml"
    path.write_text("#" * 1_000_000, encoding="utf-8")
    watched = Watched.begin(path, Scenario.parse(DOCUMENT))
    look = watching.look(watched)
    assert look.text is not None
    assert len(look.text) < 250_000
    found = refusal(watched, look.text)
    assert found.reason == "document_invalid"
    assert "expected at most 200000" in found.detail
