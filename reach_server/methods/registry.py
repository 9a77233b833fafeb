"""The methods by name, each with the claim of its sets; the sets of a method that claims nothing are uncovered."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

from fleet_bus.errors import UsageError
from fleet_bus.messages import VehicleProfile
from reach_server.audit.labels import NOTHING, Claim
from reach_server.data.window import Window
from reach_server.methods.base import Method


@dataclass(frozen=True, slots=True)
class Setup:
    """The arguments of a method: the class, its window, steps to predict, whether later inputs will be given."""

    profile: VehicleProfile
    window: Window
    horizon: int
    planned: bool


Build = Callable[[Setup], Method]
_B = TypeVar("_B", bound=Build)


@dataclass(frozen=True, slots=True)
class Registered:
    """The function that makes a method, and the claim of its sets."""

    build: Build
    claim: Claim


_METHODS: dict[str, Registered] = {}


def register(name: str, claim: Claim = NOTHING) -> Callable[[_B], _B]:
    """Decorator of a function that makes the method ``name``; raises ``ValueError`` for a name that is taken."""

    def note(build: _B) -> _B:
        if name in _METHODS:
            raise ValueError(f"method {name!r} is registered already")
        _METHODS[name] = Registered(build, claim)
        return build

    return note


def forget(name: str) -> None:
    """Remove a method; raises ``KeyError`` for one that is not there."""
    del _METHODS[name]


def registered() -> tuple[str, ...]:
    """Names of all methods."""
    return tuple(_METHODS)


def find(name: str) -> Registered:
    """The method of a name; raises ``UsageError`` where there is none."""
    if name not in _METHODS:
        raise UsageError(f"method {name!r} is unknown: choose one of default, {', '.join(_METHODS)}")
    return _METHODS[name]
