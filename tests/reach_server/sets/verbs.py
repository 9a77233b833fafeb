"""The verbs that both classes of sets offer, each with arguments for a batch; who adds one lists it here."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from reach_server.numeric.types import FloatArray
from reach_server.sets import ConstrainedZonotope, Direction, Zonotope

AnySet = Zonotope | ConstrainedZonotope
EXACT, OUTER, INNER = Direction.EXACT, Direction.OUTER, Direction.INNER
KINDS: tuple[type[AnySet], ...] = (Zonotope, ConstrainedZonotope)
BATCH = (2, 3)
N, G, ROWS = 2, 6, 2


@dataclass(frozen=True, eq=False)
class Each:
    """An argument with one entry per set: the batch axes come first."""

    array: FloatArray


def draw(seed: int, *tail: int) -> Each:
    return Each(np.random.default_rng(seed).normal(size=(*BATCH, *tail)))


def sets(kind: type[AnySet], seed: int = 0, n: int = N) -> AnySet:
    """A batch of inhabited sets; those of odd seeds overlap those of even ones."""
    rng = np.random.default_rng([seed, n])
    center, generators = rng.normal(size=(*BATCH, n)) / 4, rng.normal(size=(*BATCH, n, G))
    if kind is Zonotope:
        return Zonotope(center, generators)
    matrix = rng.normal(size=(*BATCH, ROWS, G))
    offset = (matrix @ rng.uniform(-0.5, 0.5, (*BATCH, G, 1)))[..., 0]
    return ConstrainedZonotope(center, generators, matrix, offset)


@dataclass(frozen=True, eq=False)
class Verb:
    """``name(**arguments)``, what it returns, and how that relates to the truth for either class.

    Arguments named by ``infinite`` may be infinite.
    """

    name: str
    arguments: Callable[[type[AnySet]], dict[str, Any]] = lambda kind: {}
    zonotope: Direction | None = None
    constrained: Direction | None = None
    infinite: tuple[str, ...] = ()
    constructor: bool = False

    def __str__(self) -> str:
        return f"{self.name}({', '.join(self.arguments(Zonotope))})"

    def step(self, kind: type[AnySet]) -> Direction | None:
        return self.zonotope if kind is Zonotope else self.constrained

    def call(self, subject: AnySet | type[AnySet], arguments: dict[str, Any]) -> Any:
        return getattr(subject, self.name)(**arguments)


def _linearised(kind: type[AnySet]) -> dict[str, Any]:
    low = Each(-np.abs(draw(15).array) / 10)
    return {"J": draw(13, N), "h0": draw(14), "remainder": (low, Each(low.array + 0.3)), "r": Each(np.full(BATCH, 0.7))}


MAKING = (
    Verb("linear_map", lambda kind: {"matrix": draw(1, 3, N)}, EXACT, EXACT),
    Verb("affine_map", lambda kind: {"matrix": draw(1, 3, N), "offset": draw(2, 3)}, EXACT, EXACT),
    Verb("scale", lambda kind: {"factor": draw(3)}, EXACT, EXACT),
    Verb("translate", lambda kind: {"offset": draw(4, N)}, EXACT, EXACT),
    Verb("project", lambda kind: {"axes": (1,)}, EXACT, EXACT),
    Verb("minkowski_sum", lambda kind: {"other": sets(kind, 1)}, EXACT, EXACT),
    Verb("cartesian_product", lambda kind: {"other": sets(kind, 1, 3)}, EXACT, EXACT),
    Verb("convex_hull", lambda kind: {"other": sets(kind, 1)}, OUTER, EXACT),
    Verb(
        "intersect_strip",
        lambda kind: {"H": draw(5, N), "q": Each(draw(6).array / 4), "r": Each(np.abs(draw(7).array) / 2)},
        OUTER, EXACT, ("r",),
    ),
    Verb("intersect_halfspace", lambda kind: {"H": draw(8, N), "q": Each(draw(9).array / 4)}, OUTER, EXACT, ("q",)),
    Verb(
        "intersect_tangents",
        lambda kind: {"H": draw(10, 4, N), "q": Each(np.abs(draw(11, 4).array) / 2)}, OUTER, EXACT, ("q",),
    ),
    Verb("intersect_linearised", _linearised, OUTER, OUTER, ("r", "remainder")),
    Verb("intersection", lambda kind: {"other": sets(kind, 1)}, OUTER, EXACT),
    Verb("intersection", lambda kind: {"other": sets(kind, 1, 3), "matrix": draw(16, 3, N)}, OUTER, EXACT),
    Verb("reduce_order", lambda kind: {"order": 2}, OUTER, OUTER),
    Verb("simplify", lambda kind: {}, EXACT, EXACT),
    Verb("enclosing_zonotope", lambda kind: {}, EXACT, OUTER),
)  # fmt: skip


def _ends(kind: type[AnySet]) -> dict[str, Any]:
    return {"lower": Each(draw(20, N).array - 5), "upper": Each(draw(21, N).array + 5)}


CONSTRUCTION = (
    Verb("box", _ends, EXACT, EXACT, constructor=True),
    Verb("point", lambda kind: {"x": draw(22, N)}, EXACT, EXACT, constructor=True),
    Verb("from_interval", lambda kind: {"interval": tuple(_ends(kind).values())}, EXACT, EXACT, constructor=True),
)
ASKING = (
    Verb("support", lambda kind: {"d": draw(30, 5, N)}),
    Verb("interval_hull"),
    Verb("is_empty"),
    Verb("contains_point", lambda kind: {"x": Each(draw(31, N).array / 2)}),
    Verb("factors_of", lambda kind: {"x": Each(draw(31, N).array / 2)}),
    Verb("contains_set", lambda kind: {"other": sets(kind, 1)}),
    Verb("intersects", lambda kind: {"other": sets(kind, 1)}),
    Verb("volume"),
    Verb("area"),
    Verb("volume_bracket"),
    Verb("area_bracket"),
    Verb("polygon"),
)
SAMPLING = (Verb("sample", lambda kind: {"rng": np.random.default_rng(3), "count": 5}),)
VERBS = (*CONSTRUCTION, *MAKING, *ASKING, *SAMPLING)
both = pytest.mark.parametrize("kind", KINDS, ids=["zonotope", "constrained"])


def at(value: Any, place: Any) -> Any:
    """What belongs to some places of the batch."""
    if isinstance(value, Each):
        return value.array[place]
    if isinstance(value, Zonotope | ConstrainedZonotope):
        arrays = {name: getattr(value, name)[place] for name in ("center", "generators")}
        if isinstance(value, ConstrainedZonotope):
            arrays |= {name: getattr(value, name)[place] for name in ("constraint_matrix", "constraint_offset")}
        return replace(value, **arrays)
    if isinstance(value, dict):
        return {name: at(entry, place) for name, entry in value.items()}
    if isinstance(value, tuple):
        return tuple(at(entry, place) for entry in value)
    return value


#: Verbs of two sets.
TWO = ("minkowski_sum", "cartesian_product", "convex_hull", "intersection", "contains_set", "intersects")
