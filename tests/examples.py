"""How many random examples the tests draw, and from which seed: a few and always the same, unless a campaign asks.

``FLEET_TEST_EXAMPLES`` says how many for each property, ``FLEET_TEST_SEED`` from which seed: a number, or ``fresh`` for
one that is drawn now. Nothing else reads these variables. ``make campaign`` sets both.
"""

import os
import secrets
from typing import Final

import numpy as np

_EXAMPLES: Final = "FLEET_TEST_EXAMPLES"
_SEED: Final = "FLEET_TEST_SEED"


def _number(variable: str) -> int | None:
    text = os.environ.get(variable, "").strip()
    if not text:
        return None
    if variable == _SEED and text == "fresh":
        return secrets.randbits(32)
    if not text.isascii() or not text.isdigit() or (variable == _EXAMPLES and not int(text)):
        wanted = "a number, or fresh" if variable == _SEED else "a positive number"
        raise ValueError(f"{variable} is {text!r}, expected {wanted}")
    return int(text)


_examples: Final = _number(_EXAMPLES)
_seed: Final = _number(_SEED)


def examples(default: int) -> int:
    """How many random examples a property is tried on: ``default``, or what a campaign asks for."""
    return default if _examples is None else _examples


def seed(default: int = 0) -> int:
    """Seed of all that is random: ``default``, or that of the campaign."""
    return default if _seed is None else _seed


def generator(*key: int | str) -> np.random.Generator:
    """Random numbers of one test: the same in every run for equal keys, others for each seed of a campaign."""
    words = [one if isinstance(one, int) else int.from_bytes(one.encode()) for one in key]
    return np.random.default_rng([seed(), *words])


def seeded() -> bool:
    """Whether a seed was asked for; without one Hypothesis draws the same examples in every run."""
    return _seed is not None


def campaign() -> bool:
    """Whether more or other examples than usual were asked for."""
    return _examples is not None or _seed is not None


def asked() -> str:
    """The variables that repeat this run, as they are written before a command."""
    pairs = ((_SEED, _seed), (_EXAMPLES, _examples))
    return " ".join(f"{name}={value}" for name, value in pairs if value is not None)
