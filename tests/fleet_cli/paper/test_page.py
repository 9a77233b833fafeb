"""The page about the paper states what the study computes."""

from pathlib import Path

from fleet_cli.paper import report
from fleet_cli.paper.cells import Block
from fleet_cli.paper.study import Study

PAGE = (Path(__file__).parents[3] / "docs" / "paper.md").read_text(encoding="utf-8")


def no_telling(part: float) -> None:
    pass


def test_the_tables_of_the_page_are_those_of_the_study() -> None:
    study = Study(0)
    blocks: list[Block] = [
        part(no_telling)
        for part in (study.printed, study.published_code, study.printed_text, study.ours, study.ours_with_noise)
    ]
    document = report.as_document(0, blocks, [], [], None)
    for _, rows in report.summary_rows(document):
        for row in rows:
            assert f"| {' | '.join(row)} |" in PAGE, row


def test_the_demonstrations_of_the_page_are_those_of_the_study() -> None:
    block = Study(0).demonstrations(no_telling)
    for cell in block.cells:
        assert f"| {cell.note.removeprefix('UNSOUND: ')} | {cell.outside} / {cell.steps} |" in PAGE


def test_the_other_drives_of_the_page_are_those_of_the_study() -> None:
    found = {c.formula: c.area for c in Study(0).routes(no_telling).cells if c.kind == "constrained"}
    assert f"{found['phi_p']:.2f} (φ_p) and {found['phi_r']:.2f} (φ_r)" in PAGE
