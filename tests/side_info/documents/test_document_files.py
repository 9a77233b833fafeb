"""What a path may lead to, and that no more than a document is read."""

import os
from pathlib import Path

import pytest

from side_info import Scenario, ScenarioError
from side_info.documents.document_files import read_document
from side_info.documents.yaml_text import MAX_BYTES
from tests.side_info.corpus import DOCUMENT


def refused(path: str | Path) -> str:
    with pytest.raises(ScenarioError) as found:
        Scenario.load(path)
    return str(found.value)


def test_of_a_huge_file_little_is_read(tmp_path: Path) -> None:
    path = tmp_path / "huge.yaml"
    with path.open("wb") as file:
        file.truncate(2**40)
    assert refused(path) == f"{path}: has more than {MAX_BYTES} bytes: expected at most {MAX_BYTES}"


def test_devices_directories_and_named_pipes_are_refused(tmp_path: Path) -> None:
    assert refused("/dev/zero") == "/dev/zero: is a device or a named pipe: expected a file"
    assert refused(tmp_path) == f"{tmp_path}: is a directory: expected a file"
    os.mkfifo(tmp_path / "pipe")
    assert "pipe: is a device or a named pipe" in refused(tmp_path / "pipe")


def test_a_pipe_that_the_caller_holds_open_is_read() -> None:
    reading, writing = os.pipe()
    # A document of this size fits into the pipe.
    with os.fdopen(writing, "w", encoding="utf-8") as file:
        file.write(DOCUMENT)
    with os.fdopen(reading):
        assert Scenario.load(f"/dev/fd/{reading}").text == DOCUMENT


def test_text_of_another_encoding_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "lot.yaml"
    path.write_bytes(b"\xff\xfe\x00")
    assert refused(path) == f"{path}: is not UTF-8 text"


def test_lines_may_end_in_any_way(tmp_path: Path) -> None:
    path = tmp_path / "lot.yaml"
    path.write_bytes(b"a\r\nb\rc\n")
    assert read_document(path) == "a\nb\nc\n"


def test_a_name_that_is_nearly_one_that_ships() -> None:
    found = refused("parking-lott")
    assert found == "no file and no shipped scenario 'parking-lott': did you mean parking-lot?"


@pytest.mark.slow
def test_too_many_boxes_are_refused_where_they_stand() -> None:
    boxes = "".join(f"  R{k}: {{box: {{x1: [{k}, {k + 1}]}}}}\n" for k in range(3000))
    text = DOCUMENT.replace("regions:\n", f"regions:\n{boxes}")
    with pytest.raises(ScenarioError, match=r"^many\.yaml:263:3: more than 256 predicates: .* unused regions") as found:
        Scenario.parse(text, "many.yaml")
    assert "R256: {box" in str(found.value)
