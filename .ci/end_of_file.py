"""``end_of_file.py FILE…``: let each file end with one newline, unless it is empty; 1 where one did not."""

import sys
from pathlib import Path


def main(names: list[str]) -> int:
    """How many files there are to be looked at again: 0 or 1."""
    changed = False
    for name in names:
        before = Path(name).read_bytes()
        after = before.rstrip(b"\r\n") + b"\n" if before.strip(b"\r\n") else b""
        if after != before:
            Path(name).write_bytes(after)
            print(f"{name}: mended")
            changed = True
    return int(changed)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
