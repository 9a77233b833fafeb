"""What a result depends on beside its input: the program, and what it computes with."""

import platform
from functools import cache
from hashlib import blake2b
from importlib import metadata
from pathlib import Path
from typing import Final

import numba

#: Packages whose sources count, and distributions whose versions do.
PACKAGES: Final = ("fleet_bus", "side_info", "reach_server")
DISTRIBUTIONS: Final = ("numpy", "numba", "llvmlite", "scipy", "casadi")


@cache
def build() -> str:
    """A digest (hex) of the sources, of Python and of what it computes with, and of the kind of processor.

    Where it is equal, equal input gives equal results, to the last bit; where it is not, it mostly does.
    """
    digest = blake2b(digest_size=8)
    root = Path(__file__).resolve().parents[2]
    for package in PACKAGES:
        for source in sorted((root / package).rglob("*.py")):
            digest.update(source.relative_to(root).as_posix().encode() + b"\0" + source.read_bytes() + b"\0")
    versions = [f"{name} {metadata.version(name)}" for name in DISTRIBUTIONS]
    # The features of the processor, as Numba compiles for them.
    processor = numba.core.registry.cpu_target.target_context.codegen().magic_tuple()
    digest.update("\0".join([*versions, platform.python_version(), str(processor)]).encode())
    return digest.hexdigest()
