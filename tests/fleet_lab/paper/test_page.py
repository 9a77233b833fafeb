"""The page about the paper states what the study computes."""

from pathlib import Path

import pytest

from fleet_lab.paper import report
from fleet_lab.paper.cells import Block

PAGE = (Path(__file__).parents[3] / "docs" / "paper.md").read_text(encoding="utf-8")


@pytest.mark.slow
def test_the_tables_of_the_page_are_those_of_the_study(blocks: dict[str, Block]) -> None:
    kept = ("printed", "published_code", "printed_text", "ours", "ours_with_noise")
    document = report.as_document(0, [blocks[key] for key in kept], [], [], None)
    for _, rows in report.summary_rows(document):
        for row in rows:
            assert f"| {' | '.join(row)} |" in PAGE, row


def test_the_demonstrations_of_the_page_are_those_of_the_study(blocks: dict[str, Block]) -> None:
    for cell in blocks["demonstrations"].cells:
        assert f"| {cell.note.removeprefix('UNSOUND: ')} | {cell.outside} / {cell.steps} |" in PAGE


@pytest.mark.slow
def test_the_other_drives_of_the_page_are_those_of_the_study(blocks: dict[str, Block]) -> None:
    found = {c.formula: c.area for c in blocks["routes"].cells if c.kind == "constrained"}
    assert f"{found['phi_p']:.2f} (φ_p) and {found['phi_r']:.2f} (φ_r)" in PAGE
