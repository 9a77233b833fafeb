"""Put machine code of the listed kernels, for a baseline of processors, into a folder that a wheel takes along.

Usage: machine_code.py FOLDER [KERNEL…], a kernel as module:name; without any all that servers call.
"""

import os
import pickle
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from reach_server.numeric.shipped_code import BASELINE, folder_of
from reach_server.service import warm_up
from reach_server.service.kernel_list import Kernel, compile_ahead, listed

COMPILE = "--compile"


def chosen(names: Sequence[str]) -> list[Kernel]:
    """The kernels of some names, or all."""
    return [kernel for kernel in listed([*warm_up.METHODS, warm_up.CONSTRAINED]) if not names or kernel.name in names]


def main(folder: Path, names: Sequence[str]) -> int:
    """Compile for the baseline, then copy; what was done is printed."""
    with tempfile.TemporaryDirectory() as cache:
        baseline = {"NUMBA_CPU_NAME": BASELINE, "NUMBA_CPU_FEATURES": "", "FLEET_SHIPPED_CODE": "0"}
        environment = {**os.environ, **baseline, "FLEET_KERNEL_CACHE": cache}
        subprocess.run([sys.executable, __file__, COMPILE, *names], env=environment, check=True)
        for kernel in chosen(names):
            function = kernel.dispatcher().py_func
            path = Path(function.__code__.co_filename).resolve()
            target = folder_of(path, folder)
            made = Path(cache) / "fleet-reach" / "kernels" / f"{path.parent.name}.{path.stem}" / target.name
            (index,) = made.glob(f"{path.stem}.{function.__qualname__}-*.nbi")
            ship(index, target, kernel.argument_types())
    print(f"machine code of {len(chosen(names))} kernels for {BASELINE} in {folder}")
    return 0


def ship(index: Path, target: Path, argument_types: tuple[Any, ...]) -> None:
    """Copy the entry for some types out of a cache of Numba's, under a key that names the baseline."""
    target.mkdir(parents=True, exist_ok=True)
    with index.open("rb") as file:
        version = pickle.load(file)
        stamp, overloads = pickle.loads(file.read())
    (entry,) = (key for key in overloads if key[0] == argument_types)
    shipped = {(entry[0], BASELINE, entry[2]): overloads[entry]}
    shutil.copy(index.with_name(overloads[entry]), target)
    with (target / index.name).open("wb") as file:
        pickle.dump(version, file, protocol=-1)
        file.write(pickle.dumps((stamp, shipped), protocol=-1))


if __name__ == "__main__":
    if sys.argv[1] == COMPILE:
        every = chosen(sys.argv[2:])
        for done, _ in compile_ahead(every, len(os.sched_getaffinity(0))):
            print(f"{done} of {len(every)}", file=sys.stderr)
        sys.exit(0)
    sys.exit(main(Path(sys.argv[1]), sys.argv[2:]))
