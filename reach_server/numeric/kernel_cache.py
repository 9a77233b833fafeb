"""Where machine code of kernels is kept between runs: keyed by every source that went into it.

Numba's own cache looks at the file of the kernel alone. A kernel takes in the code of those that it calls and the
constants that it reads, so here an entry's folder is named by a hash of the kernel's file and of all files of this
package that it imports, directly or not. An edit is seen wherever it was made; taken back, the old code is found again.

The first of these folders that can be written is used: ``FLEET_KERNEL_CACHE``; ``CACHE_DIRECTORY``, which systemd sets
for a unit with ``CacheDirectory=``; ``XDG_CACHE_HOME``; ``~/.cache``. Checkouts share it, since entries hold no path.
Where none can be written, each process compiles its kernels anew, and a warning says so.
"""

import ast
import hashlib
import os
import shutil
import tempfile
import warnings
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any, Final

import numba
import numpy as np
from numba.core.caching import CompileResultCacheImpl, FunctionCache, NullCache, _CacheLocator
from numba.core.registry import cpu_target

#: Versions of one file's kernels that are kept; the least recently used go first.
KEPT_VERSIONS: Final = 8
_PACKAGE: Final = __name__.partition(".")[0]
_PACKAGES_FOLDER: Final = Path(__file__).resolve().parents[__name__.count(".")]


class KernelCacheWarning(UserWarning):
    """Compiled kernels cannot be kept: each process compiles them anew."""


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


@cache
def cache_folder() -> Path | None:
    """Folder of all kernels' machine code, made if it is not there; None where nothing can be written."""
    home = os.environ.get("XDG_CACHE_HOME") or "~/.cache"
    for stated in (os.environ.get("FLEET_KERNEL_CACHE"), os.environ.get("CACHE_DIRECTORY", "").partition(":")[0], home):
        if stated:
            folder = Path(stated).expanduser() / "fleet-reach" / "kernels"
            if _writable(folder):
                return folder
    warnings.warn(
        "no folder can be written for compiled kernels: this process compiles them anew, which takes minutes; "
        "name one by FLEET_KERNEL_CACHE",
        KernelCacheWarning,
        stacklevel=2,
    )
    return None


def _writable(folder: Path) -> bool:
    try:
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        # Machine code out of a folder that others can write to would run as whoever loads it.
        if folder.stat().st_mode & 0o022 or folder.stat().st_uid != os.getuid():
            return False
        tempfile.TemporaryFile(dir=folder).close()
    except (OSError, RuntimeError):
        return False
    return True


@cache
def _version_folder(path: Path) -> Path | None:
    """Folder of the kernels of a file as it is now; older versions of it beyond ``KEPT_VERSIONS`` are removed."""
    root = cache_folder()
    if root is None:
        return None
    own = root / f"{path.parent.name}.{path.stem}"
    folder = own / source_key(path)
    with suppress(OSError):
        folder.mkdir(parents=True, exist_ok=True)
        os.utime(folder)
        versions = sorted(own.iterdir(), key=lambda version: version.stat().st_mtime, reverse=True)
        for old in versions[KEPT_VERSIONS:]:
            shutil.rmtree(old, ignore_errors=True)
    return folder


class _Locator(_CacheLocator):
    def __init__(self, py_func: Any, py_file: str) -> None:
        self._py_file = py_file
        self._lineno = py_func.__code__.co_firstlineno
        self._path = Path(py_file).resolve()

    def get_cache_path(self) -> str:
        return str(_version_folder(self._path))

    def get_source_stamp(self) -> str:
        return source_key(self._path)

    def get_disambiguator(self) -> str:
        return str(self._lineno)

    @classmethod
    def from_function(cls, py_func: Any, py_file: str) -> "_Locator":
        return cls(py_func, py_file)


class _Impl(CompileResultCacheImpl):
    _locator_classes = (_Locator,)  # type: ignore[assignment]


class _SourceKeyedCache(FunctionCache):
    _impl_class = _Impl

    def __init__(self, py_func: Any) -> None:
        super().__init__(py_func)  # type: ignore[no-untyped-call]

    def holds(self, argument_types: tuple[Any, ...]) -> bool:
        """Whether machine code for these types of arguments is there."""
        key = self._index_key(argument_types, cpu_target.target_context.codegen())  # type: ignore[no-untyped-call]
        return key in self._cache_file._load_index()  # type: ignore[no-untyped-call]

    def save_overload(self, sig: Any, data: Any) -> None:
        # A full disk costs a compilation in the next process; it is no reason to fail.
        with suppress(OSError):
            super().save_overload(sig, data)  # type: ignore[no-untyped-call]


def keep(dispatcher: Any) -> Any:
    """A kernel that Numba has not compiled yet, made to keep its machine code here. Returns it."""
    path = Path(dispatcher.py_func.__code__.co_filename).resolve()
    known = path.is_file() and _version_folder(path) is not None
    # Numba offers its own cache by a flag only; this is the attribute which that flag sets.
    dispatcher._cache = _SourceKeyedCache(dispatcher.py_func) if known else NullCache()
    return dispatcher


def is_kept(dispatcher: Any, argument_types: tuple[Any, ...]) -> bool:
    """Whether a kernel's machine code for some types of arguments is in the cache; it may be out of date no more than
    its sources are."""
    cache = dispatcher._cache
    return isinstance(cache, _SourceKeyedCache) and cache.holds(argument_types)
