"""What the machine code of a kernel depends on, as one hash."""

import ast
import hashlib
from functools import cache
from pathlib import Path
from typing import Final

import numba
import numpy as np

_PACKAGE: Final = __name__.partition(".")[0]
_PACKAGES_FOLDER: Final = Path(__file__).resolve().parents[__name__.count(".")]


@cache
def source_key(path: Path) -> str:
    """Hash of a file, of all files of this package that it imports, and of the versions of Numba and NumPy."""
    digest = hashlib.sha256(f"{numba.__version__} {np.__version__}".encode())
    for source in sorted({path, *_imported(path)}):
        digest.update(b"\0" + source.name.encode() + b"\0" + source.read_bytes())
    return digest.hexdigest()[:20]


def _imported(path: Path) -> set[Path]:
    """Files of this package that a file imports, directly or not."""
    found: set[Path] = set()
    waiting = [path]
    while waiting:
        new = set(_imports(waiting.pop())) - found
        found |= new
        waiting += new
    return found


@cache
def _imports(path: Path) -> tuple[Path, ...]:
    """Files of this package that the import statements of a file name, wherever they stand in it."""
    found: list[Path | None] = []
    for node in ast.walk(ast.parse(path.read_bytes())):
        if isinstance(node, ast.Import):
            found += [_file(alias.name) for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            # What is no module of a package is a name in its __init__.
            found += [_file(f"{node.module}.{alias.name}") or _file(node.module) for alias in node.names]
    return tuple(file for file in found if file is not None)


def _file(module: str) -> Path | None:
    if module.partition(".")[0] != _PACKAGE:
        return None
    base = _PACKAGES_FOLDER.joinpath(*module.split("."))
    return next((file for file in (base.with_suffix(".py"), base / "__init__.py") if file.is_file()), None)
