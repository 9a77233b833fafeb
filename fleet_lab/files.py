"""Files that commands write: whole or not at all, with errors that name the option."""

import json
import os
import secrets
import stat
from pathlib import Path
from typing import Final

from fleet_bus.errors import UsageError

#: How pictures may be written.
PICTURES: Final = (".png", ".svg", ".pdf")


def check_writable(option: str, path: Path | None) -> None:
    """Raise ``UsageError`` now, rather than after minutes of work, where a file cannot be written."""
    if path is None or str(path) == "-":
        return
    if not path.parent.is_dir():
        raise UsageError(f"{option} {path}: there is no folder {path.parent}")
    if path.is_dir() or not os.access(path if path.exists() else path.parent, os.W_OK):
        raise UsageError(f"{option} {path}: cannot be written")


def check_picture(option: str, path: Path | None) -> None:
    """Raise ``UsageError`` now, rather than after minutes of work, where a picture cannot be written or drawn."""
    if path is None:
        return
    if path.suffix.lower() not in PICTURES:
        raise UsageError(
            f"{option} {path}: cannot be drawn; choose a {', '.join(PICTURES[:-1])} or {PICTURES[-1]} file"
        )
    check_writable(option, path)


def make_folder(option: str, path: Path) -> None:
    """Make a folder to write into; raise ``UsageError`` where that cannot be."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"{option} {path}: cannot be made: {error.strerror or error}; name another folder") from None
    if not os.access(path, os.W_OK):
        raise UsageError(f"{option} {path}: cannot be written into")


def write_json(document: object, path: Path | None, option: str = "--json") -> None:
    """Write a document as JSON to a file, or to stdout for '-'; raise ``UsageError`` if that fails."""
    if path is None:
        return
    text = json.dumps(document, indent=2)
    if str(path) == "-":
        print(text)
    else:
        write_text(option, path, text + "\n")


def write_text(option: str, path: Path, text: str) -> None:
    """Write a file in one step, whatever interrupts; raise ``UsageError`` naming ``option`` if that fails.

    A file that is there keeps its mode. Devices, pipes, links and files in a folder that takes no others are written in
    place.
    """
    try:
        if _is_replaced(path):
            _replace(path, text)
        else:
            path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise UsageError(f"{option} {path}: cannot be written: {error.strerror or error}") from None


def _is_replaced(path: Path) -> bool:
    """Whether another file may take the place of this one without anybody noticing."""
    try:
        found = path.lstat()
    except FileNotFoundError:
        return True
    regular = stat.S_ISREG(found.st_mode) and found.st_nlink == 1
    return regular and os.access(path, os.W_OK) and os.access(path.parent, os.W_OK)


def _replace(path: Path, text: str) -> None:
    draft = path.with_name(f".{secrets.token_hex(8)}.new")
    try:
        with draft.open("x", encoding="utf-8") as file:
            file.write(text)
        if path.exists():
            draft.chmod(stat.S_IMODE(path.stat().st_mode))
        draft.replace(path)
    finally:
        draft.unlink(missing_ok=True)
