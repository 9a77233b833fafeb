"""What a report says, as Markdown and as JSON."""

import json
from pathlib import Path

import pytest

from benchmarks.page import as_markdown
from benchmarks.report import Report, Table, read
from fleet_bus.errors import UsageError
from tests.benchmarks import made


def test_a_report_says_what_was_missed() -> None:
    page = as_markdown(made.report())
    assert "1 of 3 claims are met." in page
    assert "| enough | 21 | ≥ 20 | met |" in page
    assert "| too much | 1.6 | ≤ 1.5 | **MISSED** |" in page
    assert "| unknown | – | ≤ 1 | **MISSED** |" in page
    assert "| way | µs |\n| --- | ---: |\n| ours | 1.25 |\n| theirs | 12346 |" in page
    assert page.index("too much") < page.index("12346")


def test_the_document_has_rows_by_column_and_no_nan() -> None:
    document = json.loads(made.report().as_text(), parse_constant=pytest.fail)
    found = document["benchmarks"]["a"]["table"]
    assert found["rows"] == [{"way": "ours", "µs": 1.25}, {"way": "theirs", "µs": 12345.6}]
    assert [claim["met"] for claim in found["claims"]] == [True, False, False]
    assert found["claims"][2]["value"] is None


def test_a_document_is_read_as_it_was_written(tmp_path: Path) -> None:
    path = tmp_path / "report.json"
    path.write_text(made.report().as_text(), encoding="utf-8")
    assert read(path, "--compare") == made.report()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "Invalid JSON"),
        ("[1, 2]", "not a report of this suite: the document"),
        ('{"version": "0.0.1", "benchmarks": []}', "not a report of this suite"),
        (made.report().as_text().replace('"way": "ours",', ""), "one cell for each of 2 columns"),
        (made.report().as_text().replace('"format": 1', '"format": 2'), "format"),
        (made.report().as_text().replace("fleet-reach benchmarks", "pytest-benchmark"), "suite"),
    ],
)
def test_a_foreign_file_is_refused_by_name(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "other.json"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(UsageError, match=r"--compare .*other\.json: not a report of this suite") as caught:
        read(path, "--compare")
    assert said in str(caught.value)
    with pytest.raises(UsageError, match=r"absent\.json: cannot be read"):
        read(tmp_path / "absent.json", "--compare")
    (tmp_path / "binary.json").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(UsageError, match="cannot be read"):
        read(tmp_path / "binary.json", "--compare")


def test_a_row_has_a_cell_for_each_column() -> None:
    with pytest.raises(ValueError, match="one cell for each of 2 columns"):
        Table("A", "Note.", ("way", "µs"), [("ours",)])


def test_a_busy_machine_is_told_of() -> None:
    busy = made.CONDITIONS.model_copy(update={"load": 1.7})
    assert "**Warning:** 1.7 of 2 cores were busy" in as_markdown(made.report(conditions=busy))
    assert "Warning" not in as_markdown(made.report())


def test_what_was_not_run_says_why() -> None:
    fields = {"status": "not run", "message": "interrupted"}
    page = as_markdown(Report.model_validate({**made.report().model_dump(), "benchmarks": {"b": fields}}))
    assert "## b\n\n**not run: interrupted**" in page
