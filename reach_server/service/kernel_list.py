"""Which kernels a server calls, with the types of their arguments: what can be compiled ahead, several at a time.

``kernels.json`` beside this module holds them by method, those that take longest first; ``python .ci/kernel_list.py``
writes it anew.
"""

import json
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from importlib import resources
from multiprocessing import get_context
from typing import Any, Final, NamedTuple

from numba.core.registry import CPUDispatcher

from reach_server.numeric.kernel_cache import is_kept
from reach_server.numeric.signatures import decoded, encoded, named

FILE: Final = "kernels.json"
_PACKAGE: Final = __name__.partition(".")[0]


class Kernel(NamedTuple):
    """A kernel as ``module:name``, and the types of its arguments as JSON."""

    name: str
    types: str

    def dispatcher(self) -> Any:
        """What Numba calls it by."""
        return named(self.name)

    def argument_types(self) -> tuple[Any, ...]:
        """The types as Numba has them."""
        return tuple(decoded(one) for one in json.loads(self.types))


def listed(methods: Sequence[str]) -> list[Kernel]:
    """Kernels that servers with these methods call, those that take longest to compile first."""
    found = json.loads(resources.files(_PACKAGE).joinpath("service", FILE).read_text(encoding="utf-8"))
    return [Kernel(row["kernel"], json.dumps(row["types"])) for row in found if set(row["methods"]) & set(methods)]


def missing(methods: Sequence[str]) -> list[Kernel]:
    """Those of them whose machine code is not in the cache."""
    return [kernel for kernel in listed(methods) if not is_kept(kernel.dispatcher(), kernel.argument_types())]


def compile_ahead(kernels: Sequence[Kernel], processes: int) -> Iterator[tuple[int, str]]:
    """Compile kernels in several processes, into the cache; after each, how many are done and its name.

    What cannot be compiled so is compiled by whoever calls it, who also hears why.
    """
    with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as pool:
        waiting = {pool.submit(_compile, kernel): kernel for kernel in kernels}
        for done, future in enumerate(as_completed(waiting), 1):
            yield done, waiting[future].name


def _compile(kernel: Kernel) -> None:
    kernel.dispatcher().compile(kernel.argument_types())


def called() -> set[Kernel]:
    """Kernels that this process has machine code of; where nothing had to be compiled, those that it has called."""
    found = set()
    for module_name, module in list(sys.modules.items()):
        if module_name.partition(".")[0] == _PACKAGE:
            for value in list(vars(module).values()):
                if isinstance(value, CPUDispatcher):
                    name = f"{value.py_func.__module__}:{value.py_func.__name__}"
                    found |= {Kernel(name, json.dumps([encoded(one) for one in sig])) for sig in value.overloads}
    return found
