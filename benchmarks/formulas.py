"""Random formulas as trees, their text, and their meaning on sampled trajectories by brute force."""

import random
from collections.abc import Callable
from typing import Any

import numpy as np

from reach_server.numeric.types import BoolArray, FloatArray

#: ("atom", number) | ("not" | "and" | "or", …) | ("always" | "eventually", a, b, φ) | ("until", a, b, φ, ψ), in steps
Tree = tuple[Any, ...]


class Atoms:
    """Predicates over x1, x2 as text and as a function of states (..., 2); thresholds spread over ``points`` (K, 2)."""

    def __init__(self, rng: random.Random, points: FloatArray) -> None:
        def at(axis: int, low: float, high: float) -> float:
            return round(float(np.quantile(points[:, axis], rng.uniform(low, high))), 3)

        middle = np.median(points, axis=0).round(3)
        distance = np.linalg.norm(points - middle, axis=1)
        a, b, c, d = at(0, 0.1, 0.6), at(1, 0.4, 0.9), at(0, 0.05, 0.3), at(0, 0.6, 0.95)
        r = round(float(np.quantile(distance, rng.uniform(0.5, 0.9))), 3)
        p, q = middle.tolist()
        self._made: list[tuple[str, Callable[[FloatArray], BoolArray]]] = [
            (f"x1 >= {a}", lambda x: x[..., 0] >= a),
            (f"x2 <= {b}", lambda x: x[..., 1] <= b),
            (f"{c} <= x1 <= {d}", lambda x: (c <= x[..., 0]) & (x[..., 0] <= d)),
            (f"norm(x1 - {p}, x2 - {q}) <= {r}", lambda x: np.hypot(x[..., 0] - p, x[..., 1] - q) <= r),
            (f"x1 + x2 >= {a}", lambda x: x[..., 0] + x[..., 1] >= a),
            (f"sin(2*x1) + x2^2 <= {r}", lambda x: np.sin(2 * x[..., 0]) + x[..., 1] ** 2 <= r),
            (f"max(x1, x2) >= {a}", lambda x: np.maximum(x[..., 0], x[..., 1]) >= a),
        ]

    def text(self, number: int) -> str:
        """The predicate as a formula."""
        return self._made[number][0]

    def hold(self, number: int, x: FloatArray) -> BoolArray:
        """Whether it holds of states (..., 2)."""
        return self._made[number][1](x)

    def __len__(self) -> int:
        return len(self._made)


def random_tree(rng: random.Random, depth: int, atoms: Atoms) -> Tree:
    """A formula nested up to ``depth``."""
    if depth == 0 or rng.random() < 0.15:
        atom: Tree = ("atom", rng.randrange(len(atoms)))
        return atom if rng.random() < 0.8 else ("not", atom)
    kind = rng.choice(["and", "or", "always", "eventually", "until", "until"])
    if kind in ("and", "or"):
        return (kind, random_tree(rng, depth - 1, atoms), random_tree(rng, depth - 1, atoms))
    a = rng.randint(0, 4)
    b = a + rng.randint(0, 8)
    parts = [random_tree(rng, depth - 1, atoms) for _ in range(2 if kind == "until" else 1)]
    return (kind, a, b, *parts)


def text_of(tree: Tree, atoms: Atoms, step_ms: int) -> str:
    """The formula in the language of scenarios, with steps of so many milliseconds."""
    match tree:
        case ("atom", number):
            return f"({atoms.text(number)})"
        case ("not", operand):
            return f"not {text_of(operand, atoms, step_ms)}"
        case ("and" | "or" as word, left, right):
            return f"({text_of(left, atoms, step_ms)} {word} {text_of(right, atoms, step_ms)})"
        case ("until", a, b, left, right):
            before, after = (text_of(operand, atoms, step_ms) for operand in (left, right))
            return f"({before} until{_window(a, b, step_ms)} {after})"
    word, a, b, operand = tree
    return f"{word}{_window(a, b, step_ms)}({text_of(operand, atoms, step_ms)})"


def _window(a: int, b: int, step_ms: int) -> str:
    return f"[{a * step_ms} ms:{b * step_ms} ms]"


def satisfied(tree: Tree, x: FloatArray, k: int, atoms: Atoms) -> BoolArray:
    """Which trajectories (D, S, 2) satisfy the formula from sample ``k`` on."""
    match tree:
        case ("atom", number):
            return atoms.hold(number, x[:, k])
        case ("not", operand):
            return ~satisfied(operand, x, k, atoms)
        case ("and", left, right):
            return satisfied(left, x, k, atoms) & satisfied(right, x, k, atoms)
        case ("or", left, right):
            return satisfied(left, x, k, atoms) | satisfied(right, x, k, atoms)
        case ("always", a, b, operand):
            return np.asarray(np.all([satisfied(operand, x, j, atoms) for j in range(k + a, k + b + 1)], axis=0))
        case ("eventually", a, b, operand):
            return np.asarray(np.any([satisfied(operand, x, j, atoms) for j in range(k + a, k + b + 1)], axis=0))
    _, a, b, left, right = tree
    until = np.zeros(len(x), dtype=bool)
    held = np.ones(len(x), dtype=bool)
    for j in range(k, k + b + 1):
        held &= satisfied(left, x, j, atoms)
        if j >= k + a:
            until |= held & satisfied(right, x, j, atoms)
    return until
