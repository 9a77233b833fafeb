"""The file of a scenario document, whatever a path leads to: no more is read than a document may have."""

import stat
from pathlib import Path
from typing import Final

from side_info.documents.yaml_text import MAX_BYTES

#: A pipe there is one that the caller's shell holds open; to open any other one could wait for ever.
_OPEN_PIPES: Final = ("/dev/stdin", "/dev/fd/", "/proc/self/fd/")


def read_document(path: Path) -> str:
    """Text of a file; raise ``OSError`` if it cannot be read, ``ValueError`` if it cannot be a document."""
    mode = path.stat().st_mode
    if stat.S_ISDIR(mode):
        raise ValueError("is a directory: expected a file")
    if not stat.S_ISREG(mode) and not (stat.S_ISFIFO(mode) and str(path).startswith(_OPEN_PIPES)):
        raise ValueError("is a device or a named pipe: expected a file")
    with path.open("rb") as file:
        data = file.read(MAX_BYTES + 1)
    if len(data) > MAX_BYTES:
        raise ValueError(f"has more than {MAX_BYTES} bytes: expected at most {MAX_BYTES}")
    try:
        text = data.decode()
    except UnicodeDecodeError:
        raise ValueError("is not UTF-8 text") from None
    return text.replace("\r\n", "\n").replace("\r", "\n")
