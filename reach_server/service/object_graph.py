"""A graph of objects as bytes and back: what a checkpoint is made of.

No pickle: what is read makes objects of classes from an allow list, by ``object.__new__`` and attributes, and calls
nothing that it names. References are kept, so that what was shared is shared again, arrays that look at one memory
included: a kernel that writes to one changes the other. Arrays keep strides and order, on which sums depend.

The bytes are msgpack records. Some make an object, which gets the next number: first without contents, where it may
refer to what comes later; others fill one. Dictionaries and sets are filled last, when their keys can be hashed.
"""

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from fleet_bus.errors import FleetError

#: Modules of whose classes objects may be made, and all modules below them.
ALLOWED: Final = (
    "fleet_bus.messages", "fleet_bus.writers",
    "side_info.documents", "side_info.progression", "side_info.stl",
    "reach_server.numeric", "reach_server.sets", "reach_server.data", "reach_server.predicates", "reach_server.models",
    "reach_server.side_information", "reach_server.tube", "reach_server.audit", "reach_server.methods",
    "reach_server.engine",
    "reach_server.service.clock_offsets", "reach_server.service.fleet", "reach_server.service.profiles",
    "reach_server.service.registry", "reach_server.service.sample_admission", "reach_server.service.sample_rows",
    "reach_server.service.scenario_assignments", "reach_server.service.scenario_book", "reach_server.service.vehicle",
)  # fmt: skip
#: Bytes that are read at most, and elements of an array.
MOST_BYTES: Final = 2**30
MOST_ELEMENTS: Final = 2**27

# Kinds of records: those that make something, and the one that fills it.
LIST, DICT, SET, DEQUE, OBJECT, TUPLE, FROZEN, NAMED_TUPLE = range(8)
ENUM, METHOD, MEMORY, ARRAY, SCALAR, LARGE, GIVEN, OPERATION = range(8, 16)
CLASS, FILL = 16, 17

#: A slot that holds nothing: no reference is like it.
NOTHING: Final[list[int]] = []
PLAIN: Final = frozenset({type(None), bool, float, str, bytes})
SHELLS: Final[Mapping[type, int]] = {list: LIST, dict: DICT, set: SET, deque: DEQUE}


class CheckpointError(FleetError):
    """State that cannot be written, or bytes that cannot be read; says what and where."""


@dataclass(frozen=True, slots=True)
class Layout:
    """Attributes of a class that have slots, in order, and whether its objects have others."""

    slots: tuple[str, ...]
    open: bool


def layout_of(cls: type) -> Layout:
    """The attributes of a class and of those that it is made from."""
    slots: list[str] = []
    for base in reversed(cls.__mro__):
        own = base.__dict__.get("__slots__", ())
        slots += [name for name in ((own,) if isinstance(own, str) else own) if name not in ("__dict__", "__weakref__")]
    return Layout(tuple(slots), cls.__dictoffset__ != 0)


def allowed(module: str) -> bool:
    """Whether classes of a module may be made."""
    return any(module == name or module.startswith(f"{name}.") for name in ALLOWED)


def checked_dtype(dtype: np.dtype[Any]) -> str:
    """The type of an array as text; raises ``CheckpointError`` for one that is not of numbers."""
    if dtype.kind not in "biuf" or dtype.itemsize > 8:
        raise CheckpointError(f"an array of {dtype} cannot be restored")
    return dtype.str
