"""Argument types of kernels as JSON, so that they can be compiled without being called."""

import importlib
from typing import Any, Final

from numba.core import types as _numba_types

#: Numba's stubs know little of its types.
types: Any = _numba_types
#: Everything that such a type may be made of comes from here.
_PACKAGE: Final = __name__.partition(".")[0]


def encoded(kind: Any) -> Any:
    """A type of Numba of numbers, arrays and tuples of them in terms of JSON; raise ``TypeError`` for another one."""
    if isinstance(kind, types.Array) and kind.aligned:
        return {"array": [encoded(kind.dtype), kind.ndim, kind.layout, kind.mutable]}
    if isinstance(kind, types.BaseNamedTuple):
        made = kind.instance_class
        return {"named": [f"{made.__module__}:{made.__qualname__}", [encoded(one) for one in kind]]}
    if isinstance(kind, types.BaseTuple):
        return {"tuple": [encoded(one) for one in kind]}
    if isinstance(kind, types.Number | types.Boolean) and not isinstance(kind, types.Literal):
        return kind.name
    raise TypeError(f"a kernel with an argument of type {kind} cannot be compiled ahead")


def decoded(text: Any) -> Any:
    """The type that ``encoded`` gave; raise ``ValueError`` for anything else."""
    if isinstance(text, str) and isinstance(found := getattr(types, text, None), types.Type):
        return found
    if isinstance(text, dict) and len(text) == 1:
        ((word, of),) = text.items()
        if word == "array":
            dtype, ndim, layout, mutable = of
            return types.Array(decoded(dtype), ndim, layout, readonly=not mutable)
        if word == "tuple":
            return _tuple(of)
        if word == "named":
            return _tuple(of[1], named(of[0]))
    raise ValueError(f"no type of a kernel's argument: {text!r:.80}")


def _tuple(of: list[Any], *named: Any) -> Any:
    make: Any = types.BaseTuple.from_types
    return make(tuple(decoded(one) for one in of), *named)


def named(name: str) -> Any:
    """What ``module:name`` of this package names; raise ``ValueError`` for another package's."""
    module, _, own = name.partition(":")
    if module.partition(".")[0] != _PACKAGE:
        raise ValueError(f"{name!r:.80} is not of {_PACKAGE}")
    return getattr(importlib.import_module(module), own)
