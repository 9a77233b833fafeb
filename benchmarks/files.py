"""Files of a report: whole or not at all, whatever interrupts."""

from pathlib import Path

from fleet_bus.errors import UsageError


def write(path: Path, text: str) -> None:
    """Write a file in one step; raise ``UsageError`` if it or its folder cannot be made."""
    draft = path.with_name(f".{path.name}.new")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        draft.write_text(text, encoding="utf-8")
        draft.replace(path)
    except OSError as error:
        raise UsageError(f"{path}: cannot be written: {error}") from None
