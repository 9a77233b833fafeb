"""Files that commands write, with errors that name the option."""

import json
import os
from pathlib import Path

from fleet_bus.errors import UsageError


def check_writable(option: str, path: Path | None) -> None:
    """Raise ``UsageError`` now, rather than after minutes of work, where a file cannot be written."""
    if path is None or str(path) == "-":
        return
    if not path.parent.is_dir():
        raise UsageError(f"{option} {path}: there is no folder {path.parent}")
    if path.is_dir() or not os.access(path if path.exists() else path.parent, os.W_OK):
        raise UsageError(f"{option} {path}: cannot be written")


def make_folder(option: str, path: Path) -> None:
    """Make a folder to write into; raise ``UsageError`` where that cannot be."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"{option} {path}: cannot be made: {error}") from None
    if not os.access(path, os.W_OK):
        raise UsageError(f"{option} {path}: cannot be written into")


def write_json(document: object, path: Path | None) -> None:
    """Write a document as JSON to a file, or to stdout for '-'; raise ``UsageError`` if that fails."""
    if path is None:
        return
    text = json.dumps(document, indent=2)
    if str(path) == "-":
        print(text)
    else:
        write_text("--json", path, text + "\n")


def write_text(option: str, path: Path, text: str) -> None:
    """Write a file; raise ``UsageError`` naming ``option`` if that fails."""
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise UsageError(f"{option} {path}: cannot be written: {error}") from None
