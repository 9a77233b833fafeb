"""Where machine code of kernels is kept between runs: keyed by every source that went into it.

Numba's own cache looks at the file of the kernel alone. A kernel takes in the code of those that it calls and the
constants that it reads, so here an entry's folder is named by a hash of the kernel's file and of all files of this
package that it imports, directly or not. An edit is seen wherever it was made; taken back, the old code is found again.

The first of these folders that can be written is used: ``FLEET_KERNEL_CACHE``; ``CACHE_DIRECTORY``, which systemd sets
for a unit with ``CacheDirectory=``; ``XDG_CACHE_HOME``; ``~/.cache``. Checkouts share it, since entries hold no path.
Where none can be written, each process compiles its kernels anew, and a warning says so.
"""

import os
import shutil
import tempfile
import warnings
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any, Final

from numba.core.caching import CompileResultCacheImpl, FunctionCache, NullCache, _CacheLocator
from numba.core.registry import cpu_target

from reach_server.numeric.shipped_code import ShippedCode, usable
from reach_server.numeric.source_key import source_key

#: Versions of one file's kernels that are kept; the least recently used go first.
KEPT_VERSIONS: Final = 8


class KernelCacheWarning(UserWarning):
    """Compiled kernels cannot be kept: each process compiles them anew."""


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

    def save_overload(self, sig: Any, data: Any) -> None:
        # A full disk costs a compilation in the next process; it is no reason to fail.
        with suppress(OSError):
            super().save_overload(sig, data)  # type: ignore[no-untyped-call]


class _Caches(NullCache):
    """Shipped code first, then what was compiled on this machine; both may be missing."""

    def __init__(self, py_func: Any) -> None:
        path = Path(py_func.__code__.co_filename).resolve()
        self._shipped: FunctionCache | None = None
        self._own: FunctionCache | None = None
        if path.is_file():
            self._shipped = ShippedCode(py_func) if usable() else None
            self._own = _SourceKeyedCache(py_func) if _version_folder(path) is not None else None

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        for one in (self._shipped, self._own):
            if one is not None:
                found = one.load_overload(sig, target_context)  # type: ignore[no-untyped-call]
                if found is not None:
                    return found
        return None

    def save_overload(self, sig: Any, data: Any) -> None:
        if self._own is not None:
            self._own.save_overload(sig, data)  # type: ignore[no-untyped-call]

    def holds(self, argument_types: tuple[Any, ...]) -> bool:
        """Whether machine code for these types of arguments is there."""
        codegen = cpu_target.target_context.codegen()
        caches: list[Any] = [one for one in (self._shipped, self._own) if one is not None]
        return any(one._index_key(argument_types, codegen) in one._cache_file._load_index() for one in caches)


def keep(dispatcher: Any) -> Any:
    """A kernel that Numba has not compiled yet, made to keep its machine code here. Returns it."""
    # Numba offers its own cache by a flag only; this is the attribute which that flag sets.
    dispatcher._cache = _Caches(dispatcher.py_func)
    return dispatcher


def is_kept(dispatcher: Any, argument_types: tuple[Any, ...]) -> bool:
    """Whether a kernel's machine code for some types of arguments is there, as its sources are now."""
    return bool(dispatcher._cache.holds(argument_types))
