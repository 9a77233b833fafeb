"""Where and when a run is made: machine, versions, and how busy the machine is."""

import os
import platform
import subprocess
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Final

from benchmarks.report import Conditions

#: Packages whose versions say what was measured.
PACKAGES: Final = (
    "fleet-reach", "numpy", "scipy", "numba", "casadi", "eclipse-zenoh", "highspy", "zonoopt", "rtamt", "shapely",
)  # fmt: skip
#: What the libraries of every side read when they are loaded: one thread each.
THREADS: Final = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
#: Busy cores before the start from which on times are not to be relied on.
BUSY: Final = 0.5
ROOT: Final = Path(__file__).parents[1]


def conditions() -> Conditions:
    """Those of a run that starts now."""
    cores = str(os.cpu_count() or 1)
    return Conditions(
        date=datetime.now(UTC).isoformat(timespec="seconds"),
        machine=f"{_processor()}, {platform.system()}",
        cores=int(cores),
        threads=max(int(os.environ.get(name, cores)) for name in THREADS),
        load=load(),
        python=platform.python_version(),
        commit=_commit(),
        versions={name: _version(name) for name in PACKAGES},
    )


def busy(where: Conditions) -> str | None:
    """A warning if the machine had other work to do; None otherwise."""
    if where.load is None or where.load <= BUSY:
        return None
    return f"{where.load:.1f} of {where.cores} cores were busy in the minute before the start: do not rely on the times"


def load() -> float:
    """Mean number of busy cores in the last minute."""
    return os.getloadavg()[0]


def changed(outside: str) -> list[str]:
    """Tracked files of the checkout that differ from its commit, but for a folder; none where there is no checkout."""
    found = _git("diff", "--name-only", "-z", "HEAD", "--", ".", f":(exclude){outside}")
    return [name for name in (found or "").split("\0") if name]


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "not installed"


def _commit() -> str | None:
    """Commit of the checkout, with a + if files differ from it; None where there is none."""
    found, different = _git("rev-parse", "--short", "HEAD"), _git("status", "--porcelain", "--untracked-files=no")
    if found is None or different is None:
        return None
    return found.strip() + ("+" if different.strip() else "")


def _git(*words: str) -> str | None:
    """What git says of the checkout; None where there is none."""
    if not (ROOT / ".git").exists():
        return None
    try:
        called = ["git", "-C", str(ROOT), *words]
        return subprocess.run(called, capture_output=True, text=True, check=True, timeout=10).stdout
    except (OSError, subprocess.SubprocessError):
        return None


def _processor() -> str:
    models = Path("/proc/cpuinfo")
    if models.is_file():
        for line in models.read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return f"{line.partition(':')[2].strip()} ({platform.machine()})"
    return platform.machine()
