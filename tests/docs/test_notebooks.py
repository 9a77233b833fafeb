"""The notebooks run from their first cell to the last, and are kept without what they once printed."""

import json
from pathlib import Path
from typing import Any

import pytest

from tests.docs.test_docs import DOCS, page

NOTEBOOKS = sorted((DOCS / "examples" / "notebooks").glob("*.ipynb"))


def cells(path: Path) -> list[dict[str, Any]]:
    document = json.loads(path.read_text(encoding="utf-8"))
    assert (document["nbformat"], document["metadata"]["language_info"]["name"]) == (4, "python")
    found: list[dict[str, Any]] = document["cells"]
    return found


def test_there_are_some_and_a_page_names_each() -> None:
    assert len(NOTEBOOKS) >= 2
    text = page("how-to/short-examples.md")
    assert all(f"`docs/examples/notebooks/{path.name}`" in text for path in NOTEBOOKS)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_nothing_that_was_printed_is_kept(path: Path) -> None:
    for cell in cells(path):
        assert cell["cell_type"] in ("markdown", "code")
        if cell["cell_type"] == "code":
            assert (cell["outputs"], cell["execution_count"]) == ([], None)


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_it_runs(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {"__name__": "notebook"}
    for number, cell in enumerate(cells(path)):
        if cell["cell_type"] == "code":
            exec(compile("".join(cell["source"]), f"{path.name}, cell {number}", "exec"), names)
