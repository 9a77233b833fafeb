"""The page of surprises names scripts, files and versions that are there."""

import re
from pathlib import Path

import pytest

from tests.docs.test_docs import ROOT, page

TEXT = page("reference/surprises.md")
FINDINGS = {path.name for path in (ROOT / "findings").glob("*.sh")}
#: Of libraries that this project does not use.
ELSEWHERE = re.compile(r"(?:commonroad|polytope|rosbags)_")
VERSION = re.compile(r"\b([a-z][a-z-]+) (\d+(?:\.\d+)+)")
PINNED = dict(
    re.findall(r"^([a-z0-9-]+)==(\S+)", (ROOT / "requirements" / "dev.txt").read_text(encoding="utf-8"), re.M)
)


def test_every_file_that_is_named_exists() -> None:
    named = set(re.findall(r"`((?:\w+/)+\w+\.(?:py|sh))`", TEXT))
    assert len(named) > 20
    assert {name for name in named if not (ROOT / name).is_file()} == set()


def test_every_finding_about_what_is_used_here_is_on_the_page() -> None:
    named = set(re.findall(r"`findings/(\w+\.sh)`", TEXT))
    assert named == {name for name in FINDINGS if not ELSEWHERE.match(name)}


def test_every_row_says_what_where_and_what_is_done() -> None:
    rows = [line for line in TEXT.splitlines() if line.startswith("| ") and "---" not in line]
    assert len(rows) > 20
    for row in rows:
        cells = [cell.strip() for cell in row.strip("|").split(" | ")]
        assert len(cells) in (3, 4)
        assert all(cells), row


@pytest.mark.parametrize(("library", "version"), sorted(set(VERSION.findall(TEXT))))
def test_versions_are_those_that_are_installed_or_that_the_script_pins(library: str, version: str) -> None:
    if library in PINNED:
        assert PINNED[library] == version
        return
    scripts = [path.read_text(encoding="utf-8") for path in Path(ROOT / "findings").glob("*.sh")]
    assert any(f"{library}=={version}" in text for text in scripts)
