"""Files are written whole or not at all, and where they were."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from fleet_bus.errors import UsageError
from fleet_lab import files as outputs
from fleet_lab.files import write_json, write_text


def test_a_file_is_new_or_keeps_its_mode(tmp_path: Path) -> None:
    path = tmp_path / "out.txt"
    write_text("-o", path, "first\n")
    plain = tmp_path / "plain"
    plain.touch()
    assert path.stat().st_mode == plain.stat().st_mode
    plain.unlink()
    path.chmod(0o640)
    write_text("-o", path, "second\n")
    assert (path.read_text(encoding="utf-8"), path.stat().st_mode & 0o777) == ("second\n", 0o640)
    assert list(tmp_path.iterdir()) == [path]


def test_a_write_that_fails_leaves_what_was_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "out.json"
    write_json({"a": 1}, path)
    for error, raised in (
        (OSError(28, "No space left on device"), UsageError),
        (KeyboardInterrupt(), KeyboardInterrupt),
    ):

        def full(self: Path, target: Path, error: BaseException = error) -> None:
            raise error

        with monkeypatch.context() as patch:
            patch.setattr(Path, "replace", full)
            with pytest.raises(raised) as caught:
                write_json({"a": 2}, path, "--report")
        if raised is UsageError:
            assert str(caught.value) == f"--report {path}: cannot be written: No space left on device"
        assert json.loads(path.read_text(encoding="utf-8")) == {"a": 1}
        assert list(tmp_path.iterdir()) == [path]


def test_a_full_disk_leaves_nothing() -> None:
    if not Path("/dev/full").exists():
        pytest.skip("there is no /dev/full")
    with pytest.raises(UsageError, match="No space left"):
        write_text("-o", Path("/dev/full"), "text")


def test_links_and_devices_stay_what_they_are(tmp_path: Path) -> None:
    target, link, twin = tmp_path / "target", tmp_path / "link", tmp_path / "twin"
    link.symlink_to(target)
    write_text("-o", link, "through a link")
    assert link.is_symlink()
    assert target.read_text(encoding="utf-8") == "through a link"
    os.link(target, twin)
    write_text("-o", twin, "both")
    assert target.read_text(encoding="utf-8") == "both"
    write_text("-o", Path(os.devnull), "nothing")
    assert Path(os.devnull).is_char_device()


def test_standard_output_is_written_where_it_goes(tmp_path: Path) -> None:
    code = (
        "from pathlib import Path; from fleet_lab.files import write_text; write_text('-o', Path('/dev/stdout'), 'x')"
    )
    where = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    with (tmp_path / "out").open("w", encoding="utf-8") as file:
        subprocess.run([sys.executable, "-c", code], stdout=file, env=where, check=True, timeout=60)
    assert (tmp_path / "out").read_text(encoding="utf-8") == "x"
    piped = subprocess.run([sys.executable, "-c", code], stdout=subprocess.PIPE, env=where, check=True, timeout=60)
    assert piped.stdout == b"x"


def test_a_place_that_takes_no_file_is_told(tmp_path: Path) -> None:
    for path in (tmp_path, tmp_path / "none" / "out.txt"):
        with pytest.raises(UsageError, match=f"-o {path}: cannot be written"):
            outputs.write_text("-o", path, "text")
    assert list(tmp_path.iterdir()) == []
