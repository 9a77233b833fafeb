"""Interval evaluation: no value of a function over a box is outside of what the tape says."""

import math
from collections.abc import Callable

import casadi
import numpy as np
import pytest
from numpy.typing import NDArray

from reach_server.numeric.types import FloatArray
from reach_server.predicates.interval_ad.tape import Tape
from side_info import ScenarioError

#: Values in more than double precision.
Long = NDArray[np.longdouble]
INF = np.inf


def boxes(rng: np.random.Generator, rows: int, low: float, high: float) -> tuple[FloatArray, FloatArray]:
    """Boxes (2, rows) within [low, high]: wide, narrow, degenerate, and with round ends."""
    ends = np.sort(rng.uniform(low, high, (2, 2, rows)), axis=0)
    width = rng.choice([1.0, 1e-3, 1e-12, 0.0], rows)
    lower = ends[0]
    upper = lower + width * (ends[1] - lower)
    whole = rng.random(rows) < 0.3
    lower = np.where(whole, np.ceil(lower), lower)
    return lower, np.maximum(np.where(whole, np.floor(upper), upper), lower)


def points(rng: np.random.Generator, lower: FloatArray, upper: FloatArray, count: int) -> FloatArray:
    """Points (count, *lower.shape) of boxes, many at their ends."""
    place = rng.random((count, *lower.shape))
    place = np.where(rng.random(place.shape) < 0.3, np.round(place), place)
    return np.clip(lower + place * (upper - lower), lower, upper)


def _choose(condition: Long, value: Long) -> Long:
    return np.where(condition != 0, value, 0)


#: Operations of one operand: the CasADi function, the same in long doubles, and where it is looked at.
UNARY: dict[str, tuple[Callable[[casadi.SX], casadi.SX], Callable[[Long], Long], float, float]] = {
    "neg": (lambda x: -x, np.negative, -5, 5),
    "twice": (lambda x: 2 * x, lambda x: 2 * x, -5, 5),
    "sq": (lambda x: x * x, np.square, -5, 5),
    "cube": (lambda x: x**3, lambda x: x**3, -5, 5),
    "sixth": (lambda x: x**6, lambda x: x**6, -5, 5),
    "constpow": (lambda x: x**1.7, lambda x: np.power(x, np.longdouble(1.7)), 0, 5),
    "inv": (lambda x: 1 / x, lambda x: 1 / x, -5, 5),
    "sqrt": (casadi.sqrt, np.sqrt, 0, 50),
    "exp": (casadi.exp, np.exp, -30, 30),
    "expm1": (casadi.expm1, np.expm1, -3, 3),
    "log": (casadi.log, np.log, 1e-300, 50),
    "log1p": (casadi.log1p, np.log1p, -0.999, 5),
    "sin": (casadi.sin, np.sin, -20, 20),
    "cos": (casadi.cos, np.cos, -20, 20),
    "sine far out": (casadi.sin, np.sin, -1e6, 1e6),
    "cos farther": (casadi.cos, np.cos, -1e12, 1e12),
    "tan": (casadi.tan, np.tan, -20, 20),
    "asin": (casadi.asin, np.arcsin, -1, 1),
    "acos": (casadi.acos, np.arccos, -1, 1),
    "atan": (casadi.atan, np.arctan, -50, 50),
    "sinh": (casadi.sinh, np.sinh, -20, 20),
    "cosh": (casadi.cosh, np.cosh, -20, 20),
    "tanh": (casadi.tanh, np.tanh, -5, 5),
    "asinh": (casadi.asinh, np.arcsinh, -50, 50),
    "acosh": (casadi.acosh, np.arccosh, 1, 50),
    "atanh": (casadi.atanh, np.arctanh, -0.999, 0.999),
    "fabs": (casadi.fabs, np.abs, -5, 5),
    "floor": (casadi.floor, np.floor, -5, 5),
    "ceil": (casadi.ceil, np.ceil, -5, 5),
    "sign": (casadi.sign, np.sign, -5, 5),
    "not": (casadi.logic_not, lambda x: np.longdouble(1) * (x == 0), -2, 2),
}

BINARY: dict[str, tuple[Callable[[casadi.SX, casadi.SX], casadi.SX], Callable[[Long, Long], Long], float, float]] = {
    "add": (lambda x, y: x + y, np.add, -5, 5),
    "sub": (lambda x, y: x - y, np.subtract, -5, 5),
    "mul": (lambda x, y: x * y, np.multiply, -5, 5),
    "div": (lambda x, y: x / y, np.divide, -5, 5),
    "pow": (lambda x, y: x**y, np.power, 0.0, 5),
    # The real zero has no sign.
    "atan2": (casadi.atan2, lambda y, x: np.arctan2(y + 0.0, x + 0.0), -5, 5),
    "hypot": (casadi.hypot, np.hypot, -5, 5),
    "fmin": (casadi.fmin, np.minimum, -5, 5),
    "fmax": (casadi.fmax, np.maximum, -5, 5),
    "lt": (lambda x, y: x < y, lambda x, y: np.longdouble(1) * (x < y), -3, 3),
    "le": (lambda x, y: x <= y, lambda x, y: np.longdouble(1) * (x <= y), -3, 3),
    "eq": (lambda x, y: x == y, lambda x, y: np.longdouble(1) * (x == y), -3, 3),
    "ne": (lambda x, y: x != y, lambda x, y: np.longdouble(1) * (x != y), -3, 3),
    "and": (casadi.logic_and, lambda x, y: np.longdouble(1) * ((x != 0) & (y != 0)), -2, 2),
    "or": (casadi.logic_or, lambda x, y: np.longdouble(1) * ((x != 0) | (y != 0)), -2, 2),
    "if_else_zero": (lambda x, y: casadi.if_else(x, y, 0), _choose, -2, 2),
}


def violations(
    tape: Tape, truth: Callable[[Long], Long], lower: FloatArray, upper: FloatArray, rng: np.random.Generator
) -> int:
    """Points of boxes (k, rows) whose value is not enclosed."""
    (found,) = tape((lower, upper))
    inside = points(rng, lower, upper, 40)
    with np.errstate(all="ignore"):
        values = np.asarray(truth(np.moveaxis(inside.astype(np.longdouble), 1, 0)))
    assert np.isfinite(values.astype(np.float64)).any()
    return int((~np.isnan(values) & ((values < found.lower[0]) | (values > found.upper[0]))).sum())


@pytest.mark.parametrize("name", UNARY)
def test_no_value_of_an_operation_is_outside(name: str) -> None:
    build, truth, low, high = UNARY[name]
    x = casadi.SX.sym("x", 2)
    tape = Tape(casadi.Function("f", [x], [build(x[0])]))
    rng = np.random.default_rng(sum(map(ord, name)))
    lower, upper = boxes(rng, 2000, low, high)
    lower, upper = np.clip(lower, low, high), np.clip(upper, low, high)
    assert violations(tape, lambda v: truth(v[0]), lower, upper, rng) == 0


@pytest.mark.parametrize("name", BINARY)
def test_no_value_of_an_operation_of_two_is_outside(name: str) -> None:
    build, truth, low, high = BINARY[name]
    x = casadi.SX.sym("x", 2)
    tape = Tape(casadi.Function("f", [x], [build(x[0], x[1])]))
    rng = np.random.default_rng(sum(map(ord, name)))
    lower, upper = boxes(rng, 2000, low, high)
    lower, upper = np.clip(lower, low, high), np.clip(upper, low, high)
    assert violations(tape, lambda v: truth(v[0], v[1]), lower, upper, rng) == 0


def test_the_error_function_has_no_value_outside() -> None:
    # The C library's, which is wrong by an ulp, against SciPy's.
    erf = np.vectorize(math.erf, otypes=[np.float64])
    x = casadi.SX.sym("x")
    rng = np.random.default_rng(0)
    lower, upper = (b[:1] for b in boxes(rng, 2000, -4, 4))
    assert violations(Tape(casadi.Function("f", [x], [casadi.erf(x)])), lambda v: erf(v[0]), lower, upper, rng) == 0


@pytest.mark.parametrize("name", UNARY)
def test_a_narrow_box_has_narrow_bounds(name: str) -> None:
    build, truth, low, high = UNARY[name]
    x = casadi.SX.sym("x")
    at = np.array([[low + 0.37 * (high - low)]])
    (found,) = Tape(casadi.Function("f", [x], [build(x)]))((at, at))
    if name == "cos farther":
        np.testing.assert_array_equal([found.lower[0, 0], found.upper[0, 0]], [-1, 1])
    else:
        value = float(truth(at.astype(np.longdouble))[0, 0])
        assert found.upper[0, 0] - found.lower[0, 0] <= 1e-13 * max(abs(value), 1.0 + value**2 * (name == "tan"))
        assert found.smooth.all()


def smooth_and_kinked() -> dict[str, casadi.SX]:
    x = casadi.SX.sym("x", 4)
    a, b, c, d = casadi.vertsplit(x)
    made = {
        "norm": 1.429 - casadi.sqrt((a - 0.307) ** 2 + (b - 0.044) ** 2),
        "disc": 1.429**2 - ((a - 0.307) ** 2 + (b - 0.044) ** 2),
        "bearing": 0.5 - casadi.atan2(b - 1, a + 2) ** 2,
        "acceleration": 3 - d**2 * casadi.tan(c) / 2.7,
        "waves": casadi.sin(c) * a - casadi.cos(c) * b + casadi.exp(-d / 3),
        "ratio": a / (d + 3) - casadi.log(d + 4) + casadi.sqrt(d + 3.5),
        "powers": (d + 3) ** 1.7 + a**3 - b**4 + a**-3 + (a + 3) ** b,
        "kinks": casadi.fmin(a, b) + casadi.fmax(c, d) + casadi.fabs(a - b),
        "cases": casadi.if_else(a > b, a * b, c),
        "hyperbolic": casadi.tanh(a * b) + casadi.sinh(c) + casadi.cosh(c * d) + casadi.erf(d),
        "inverse": casadi.asin(a / 3) + casadi.acos(b / 3) + casadi.atan(c) + casadi.asinh(d) + casadi.acosh(d + 3),
        "others": casadi.atanh(a / 4) + casadi.hypot(a, b) + casadi.log1p(d + 2) + casadi.expm1(c) + casadi.sign(a),
    }
    return {name: casadi.densify(casadi.vertcat(h, *_derivatives(h, x))) for name, h in made.items()} | {"x": x}


def _derivatives(h: casadi.SX, x: casadi.SX) -> tuple[casadi.SX, casadi.SX]:
    hessian, gradient = casadi.hessian(h, x)
    return gradient, casadi.vec(casadi.densify(hessian))


FUNCTIONS = smooth_and_kinked()


@pytest.mark.parametrize("name", [name for name in FUNCTIONS if name != "x"])
def test_no_value_gradient_or_hessian_is_outside(name: str) -> None:
    function = casadi.Function("f", [FUNCTIONS["x"]], [FUNCTIONS[name]])
    rng = np.random.default_rng(sum(map(ord, name)))
    center = rng.uniform(-2, 2, (4, 300))
    half = rng.uniform(0, 1, (4, 300)) * rng.choice([0.0, 1e-3, 0.1, 1.0], 300)
    lower, upper = center - half, center + half
    (found,) = Tape(function)((lower, upper))
    # CasADi's own rounding at a point is covered, too: each operation of it is enclosed.
    for at in points(rng, lower, upper, 20):
        values = np.array(function.map(300)(at))
        assert not (~np.isnan(values) & ((values < found.lower) | (values > found.upper))).any()
    assert np.isfinite(found.upper).all(axis=0).mean() > 0.5


def one(expression: Callable[[casadi.SX], casadi.SX], low: float, high: float) -> tuple[float, float, bool]:
    x = casadi.SX.sym("x")
    (found,) = Tape(casadi.Function("f", [x], [expression(x)]))((np.array([[low]]), np.array([[high]])))
    return found.lower[0, 0], found.upper[0, 0], bool(found.smooth[0])


@pytest.mark.parametrize(
    ("expression", "low", "high"),
    [
        (casadi.sqrt, -1e-300, 1), (casadi.log, 0, 1), (lambda x: 1 / x, -1, 1), (lambda x: 1 / x, 0, 1),
        (casadi.asin, 0, 1 + 1e-15), (casadi.acosh, 0.5, 2), (casadi.tan, 1, 2), (casadi.atanh, 0, 1),
        (casadi.log1p, -1, 0), (lambda x: x**0.3, -1, 2), (lambda x: x**-3, -1, 2), (lambda x: x**x, -1, 2),
        # What comes after an undefined value is not defined either, though its range be.
        (lambda x: casadi.sin(casadi.sqrt(x)), -1, 4), (lambda x: casadi.fmin(1 / x, 0), -1, 1),
    ],
)  # fmt: skip
def test_nothing_is_known_outside_of_the_domain(
    expression: Callable[[casadi.SX], casadi.SX], low: float, high: float
) -> None:
    assert one(expression, low, high) == (-INF, INF, False)


def test_what_is_not_chosen_need_not_be_defined() -> None:
    assert one(lambda x: casadi.if_else(x > 5, casadi.sqrt(x - 5), 0), 0, 1) == (0, 0, True)
    assert one(lambda x: casadi.if_else(x > 5, casadi.sqrt(x - 5), 0), 0, 6)[:2] == (-INF, INF)


@pytest.mark.parametrize(
    ("expression", "smooth", "kinked"),
    [
        (casadi.fabs, (0, 2), (-1e-9, 2)),
        (lambda x: casadi.fmin(x, 1), (-1, 1), (-1, 1.1)),
        (lambda x: casadi.fmax(x, 1), (1, 3), (0.9, 3)),
        (casadi.floor, (1, 1.9), (1, 2)),
        (casadi.sign, (1e-9, 1), (0, 1)),
        (lambda x: casadi.atan2(x, -1), (0.1, 1), (-0.1, 1)),
        (lambda x: casadi.if_else(x > 1, x, 0), (-1, 0.9), (0.9, 1.1)),
        (lambda x: casadi.sqrt(x * x), (0, 1), (-1, 1)),
    ],
)
def test_kinks_are_seen_where_they_are(
    expression: Callable[[casadi.SX], casadi.SX], smooth: tuple[float, float], kinked: tuple[float, float]
) -> None:
    assert one(expression, *smooth)[2]
    assert not one(expression, *kinked)[2]


def test_a_kink_of_what_is_not_differentiated_is_none() -> None:
    x, p = casadi.SX.sym("x"), casadi.SX.sym("p")
    function = casadi.Function("f", [x, p], [x * casadi.fabs(p) + casadi.if_else(p > 0, x, 2 * x)])
    box = np.array([[-1.0]]), np.array([[1.0]])
    assert Tape(function)(box, box)[0].smooth.all()
    assert not Tape(function, differentiated=(0, 1))(box, box)[0].smooth.any()


def test_unbounded_boxes_large_numbers_and_subnormals() -> None:
    assert one(casadi.sin, -INF, INF) == (-1, 1, True)
    assert one(casadi.exp, -INF, 0)[0] == 0
    assert one(casadi.exp, 0, INF)[1] == INF
    low, high, _ = one(casadi.exp, 1000, 1000)
    assert low == np.finfo(np.float64).max
    assert high == INF
    assert one(lambda x: x * 0.5, -INF, INF)[:2] == (-INF, INF)
    assert one(lambda x: 1 / x, 1, INF)[0] == 0
    assert one(casadi.log, 1, INF) == (0, INF, True)
    assert one(casadi.log1p, 0, INF) == (0, INF, True)
    assert one(lambda x: x / (1 + x), 0, INF)[:2] == (0, INF)
    tiny = 5e-324
    low, high, _ = one(lambda x: x * x, tiny, tiny)
    assert low == 0
    assert high == tiny
    low, high, _ = one(lambda x: x * (x + 1e300), tiny, 2 * tiny)
    assert 0 <= low <= high < 1e-20
    assert one(casadi.tan, 1e300, 1e300) == (-INF, INF, False)
    assert one(casadi.cos, 1e300, 1e300)[:2] == (-1, 1)
    # The least number below which a cosine is not 1.
    low, high, _ = one(casadi.cos, -1e-9, 1e-9)
    assert low < 1
    assert high == 1


def test_empty_boxes_stay_empty_and_nan_is_anything() -> None:
    x = casadi.SX.sym("x", 2)
    tape = Tape(casadi.Function("f", [x], [x[0] + x[1], casadi.sin(x[0])]))
    lower, upper = np.array([[INF, np.nan, 0], [0, 0, 0]]), np.array([[-INF, np.nan, 0], [1, 1, 1]])
    total, sine = tape((lower, upper))
    np.testing.assert_allclose(total.lower[0], [INF, -INF, 0], atol=1e-300)
    np.testing.assert_allclose(total.upper[0], [-INF, INF, 1], rtol=1e-15)
    np.testing.assert_array_equal(sine.upper[0, :2], [-INF, 1])


def test_sparse_outputs_and_constants() -> None:
    x = casadi.SX.sym("x", 3)
    function = casadi.Function("f", [x], [casadi.jacobian(x[0] * x[2], x), casadi.SX(3), casadi.SX(0, 1)])
    at = np.array([[1.0, 1.0], [2.0, 2.0], [4.0, 5.0]])
    gradient, three, nothing = Tape(function)((at, at))
    np.testing.assert_array_equal(gradient.lower, [[4, 5], [1, 1]])
    np.testing.assert_array_equal(three.upper, [[3, 3]])
    assert nothing.lower.shape == (0, 2)


def test_operations_without_a_rule_are_refused_by_name() -> None:
    x = casadi.SX.sym("x", 2)
    with pytest.raises(ScenarioError, match="OP_FMOD"):
        Tape(casadi.Function("f", [x], [casadi.fmod(x[0], x[1])]))
