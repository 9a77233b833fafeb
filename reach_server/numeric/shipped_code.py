"""Machine code of kernels that a wheel brings along, so that nothing is compiled on the first run.

It is made for a stated baseline of processors, not for the one at hand, and lies in folders named by ``source_key``:
what was edited, or belongs to other versions of Numba and NumPy, is not found there, and is compiled as ever.
"""

import os
import platform
from functools import cache
from pathlib import Path
from typing import Any, Final

import llvmlite.binding as llvm
from numba.core.caching import CompileResultCacheImpl, FunctionCache, _CacheLocator

from reach_server.numeric.source_key import source_key

FOLDER: Final = Path(__file__).resolve().parent / "machine_code"
#: Every server processor since 2015.
BASELINE: Final = "x86-64-v3"
FEATURES: Final = frozenset(
    ("avx", "avx2", "bmi", "bmi2", "cx16", "f16c", "fma", "lzcnt", "movbe", "popcnt", "sahf", "sse4.2", "xsave")
)


@cache
def usable() -> bool:
    """Whether there is such code and this processor runs it; ``FLEET_SHIPPED_CODE=0`` leaves it alone."""
    if os.environ.get("FLEET_SHIPPED_CODE") == "0" or platform.machine() != "x86_64" or not FOLDER.is_dir():
        return False
    found = llvm.get_host_cpu_features()
    return all(found.get(feature, False) for feature in FEATURES)


def folder_of(path: Path, root: Path = FOLDER) -> Path:
    """Folder of the code of a file's kernels as they are now."""
    return root / f"{path.parent.name}.{path.stem}" / source_key(path)


class _Locator(_CacheLocator):
    def __init__(self, py_func: Any, py_file: str) -> None:
        self._lineno = py_func.__code__.co_firstlineno
        self._path = Path(py_file).resolve()

    def get_cache_path(self) -> str:
        return str(folder_of(self._path))

    def get_source_stamp(self) -> str:
        return source_key(self._path)

    def get_disambiguator(self) -> str:
        return str(self._lineno)

    @classmethod
    def from_function(cls, py_func: Any, py_file: str) -> "_Locator":
        return cls(py_func, py_file)


class _Impl(CompileResultCacheImpl):
    _locator_classes = (_Locator,)  # type: ignore[assignment]


class ShippedCode(FunctionCache):
    """The shipped code of one function, to be read only."""

    _impl_class = _Impl

    def __init__(self, py_func: Any) -> None:
        super().__init__(py_func)  # type: ignore[no-untyped-call]

    def _index_key(self, sig: Any, codegen: Any) -> Any:
        types, _, hashes = super()._index_key(sig, codegen)  # type: ignore[no-untyped-call]
        return types, BASELINE, hashes

    def save_overload(self, sig: Any, data: Any) -> None:
        """Nothing: what is compiled here is kept elsewhere."""
