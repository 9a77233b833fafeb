"""Interval rules of elementary functions against decimals of seventy digits: never inside of the true range, and at no
end farther out than some ulps of that end."""

import math
from collections.abc import Callable, Iterator, Sequence
from decimal import Decimal, localcontext
from fractions import Fraction

import casadi
import numpy as np
import pytest

from reach_server.predicates.interval_ad import arithmetic as rules
from reach_server.predicates.interval_ad import elementary as functions
from reach_server.predicates.interval_ad.arithmetic import Bounds
from reach_server.predicates.interval_ad.quadrants import FARTHEST, passes, reduced
from reach_server.predicates.interval_ad.tape import Tape
from tests.examples import examples, generator
from tests.reach_server.predicates import decimals

Exact = Callable[..., Decimal]
pytestmark = pytest.mark.property

INF, MOST, TINY = np.inf, float(np.finfo(np.float64).max), 5e-324
#: How far an end may be from the true one: what a value is widened by, which is twice as many ulps of a number that is
#: just below a power of 2, what it is off by itself, and the grid of the smallest numbers.
ULPS, GRID = 2 * functions.ULPS + 4, 4 * functions.ULPS
#: What the oracle may be off by.
ORACLE = Decimal("1e-60")


@pytest.fixture(autouse=True)
def _many_digits() -> Iterator[None]:
    with localcontext(prec=decimals.WORKING, Emax=10**7, Emin=-(10**7)):
        yield


#: Ends of intervals on which functions go wrong.
UGLY = (
    0.0, -0.0, TINY, -TINY, 1e-323, -1e-310, 2.2250738585072014e-308, 1e-283, -1.8e-45, 1e-160, 1e-20, -1e-20, 1e-9,
    -1e-9, 0.5, -0.5, 1.0, -1.0, math.nextafter(1, 0), math.nextafter(1, 2), math.nextafter(-1, 0), 2.0, math.e, -3.0,
    0.7, 0.75, 0.8, 100.0, -745.2, 709.7, 710.5, 1e5, 1e10, -1e16, 1e100, -1e200, MOST, -MOST, 45.553093477052,
)  # fmt: skip
TURNS = (1, 2, 3, 4, 5, 7, 29, 58, 1000, 12345, 9206271, 63661977)
CIRCLE = tuple(
    sign * step
    for k in TURNS
    for sign in (1.0, -1.0)
    for near in [k * (math.pi / 2)]
    for step in (near, math.nextafter(near, 0), math.nextafter(near, INF))
)


def ugly_intervals(rng: np.random.Generator, count: int, special: Sequence[float], low: float, high: float) -> Bounds:
    """Intervals (count,) within [low, high]: between ugly numbers, points, one ulp wide, of all sizes, unbounded."""
    kinds = rng.integers(0, 5, (2, count))
    sizes = rng.choice([-1.0, 1.0], (2, count)) * 10.0 ** rng.uniform(-330, 308, (2, count))
    moderate = rng.normal(size=(2, count)) * 10.0 ** rng.uniform(-3, 3, (2, count))
    ends = np.select(
        [kinds <= 1, kinds == 2, kinds == 3], [rng.choice(np.array(special), (2, count)), sizes, moderate], moderate
    )
    ends = np.clip(np.sort(ends, axis=0), low, high)
    lower, upper = ends[0].copy(), ends[1].copy()
    shape = rng.integers(0, 8, count)
    upper = np.where(shape == 0, lower, upper)
    with np.errstate(over="ignore"):
        upper = np.where(shape == 1, np.minimum(np.nextafter(lower, INF), high), upper)
    lower = np.where((shape == 2) & (low == -INF), -INF, lower)
    upper = np.where((shape == 3) & (high == INF), INF, upper)
    return lower, np.maximum(lower, upper)


def ulp(value: Decimal) -> Decimal:
    """Distance of floating-point numbers near a value."""
    if not value:
        return Decimal(TINY)
    number = min(max(abs(float(value)), TINY), MOST)
    return Decimal(math.ulp(number))


def assert_end(found: float, true: Decimal | float, side: int, what: str) -> None:
    """``found`` is at or beyond the true lower (side -1) or upper end (side 1), and near it."""
    if isinstance(true, float):
        # A limit at infinity: nothing is beyond, and near is everything.
        assert math.copysign(1.0, true) != side or found == true, what
        assert math.copysign(1.0, true) == side or side * found >= -MOST, what
        return
    assert not math.isnan(found), what
    slack = abs(true) * ORACLE
    if math.isinf(found):
        assert found * side > 0, what
        # As near as numbers come: the next ones overflow.
        assert side * true >= Decimal(MOST) * (1 - Decimal(2) ** -48), what
        return
    beyond = side * (Decimal(found) - true)
    assert beyond >= -slack, f"{what}: inside of the true range by {-beyond:.3}"
    limit = ULPS * ulp(true) + GRID * Decimal(TINY)
    if abs(true) > Decimal(MOST):
        # The bound that lies inwards of a value beyond all numbers.
        assert abs(found) >= MOST * (1 - 2.0**-48), what
        return
    assert beyond <= limit, f"{what}: {float(beyond / ulp(true)):.3g} ulps too far out"


def at(function: Exact, limits: tuple[float, float], x: float) -> Decimal | float:
    """The function at an end, or its limit where that is infinite."""
    if math.isinf(x):
        limit = limits[0] if x < 0 else limits[1]
        return limit if math.isinf(limit) else Decimal(limit)
    return function(Decimal(x))


#: Rising functions: rule, oracle, limits at infinity, domain within which they are tried.
RISING: dict[str, tuple[str, Exact, tuple[float, float], tuple[float, float]]] = {
    "exp": ("OP_EXP", decimals.exp, (0.0, INF), (-INF, INF)),
    "expm1": ("OP_EXPM1", decimals.expm1, (-1.0, INF), (-INF, INF)),
    "log": ("OP_LOG", decimals.log, (-INF, INF), (TINY, INF)),
    "log1p": ("OP_LOG1P", decimals.log1p, (-INF, INF), (math.nextafter(-1, 0), INF)),
    "asin": ("OP_ASIN", decimals.asin, (0.0, 0.0), (-1.0, 1.0)),
    "atan": ("OP_ATAN", decimals.atan, (-math.pi / 2, math.pi / 2), (-MOST, MOST)),
    "sinh": ("OP_SINH", decimals.sinh, (-INF, INF), (-INF, INF)),
    "tanh": ("OP_TANH", decimals.tanh, (-1.0, 1.0), (-INF, INF)),
    "asinh": ("OP_ASINH", decimals.asinh, (-INF, INF), (-INF, INF)),
    "acosh": ("OP_ACOSH", decimals.acosh, (0.0, INF), (1.0, INF)),
    "atanh": ("OP_ATANH", decimals.atanh, (0.0, 0.0), (math.nextafter(-1, 0), math.nextafter(1, 0))),
    "erf": ("OP_ERF", decimals.erf, (-1.0, 1.0), (-INF, INF)),
}


def applied(code: str, *operands: Bounds) -> Bounds:
    """The rule of an operation on intervals (count,), as the tape applies it."""
    symbols = [casadi.SX.sym(f"x{i}") for i in range(len(operands))]
    build: dict[str, Callable[..., casadi.SX]] = {
        "OP_EXP": casadi.exp, "OP_EXPM1": casadi.expm1, "OP_LOG": casadi.log, "OP_LOG1P": casadi.log1p,
        "OP_ASIN": casadi.asin, "OP_ACOS": casadi.acos, "OP_ATAN": casadi.atan, "OP_SINH": casadi.sinh,
        "OP_COSH": casadi.cosh, "OP_TANH": casadi.tanh, "OP_ASINH": casadi.asinh, "OP_ACOSH": casadi.acosh,
        "OP_ATANH": casadi.atanh, "OP_ERF": casadi.erf, "OP_SIN": casadi.sin, "OP_COS": casadi.cos,
        "OP_TAN": casadi.tan, "OP_ATAN2": casadi.atan2, "OP_HYPOT": casadi.hypot, "OP_POW": lambda x, y: x**y,
        "OP_SQRT": casadi.sqrt, "OP_SQ": lambda x: x * x,
    }  # fmt: skip
    tape = Tape(casadi.Function("f", [casadi.vertcat(*symbols)], [build[code](*symbols)]))
    (found,) = tape((np.stack([low for low, _ in operands]), np.stack([high for _, high in operands])))
    return found.lower[0], found.upper[0]


@pytest.mark.parametrize("name", RISING)
@pytest.mark.slow
def test_rising_functions_are_enclosed_to_some_ulps_of_each_end(name: str) -> None:
    code, exact, limits, (low, high) = RISING[name]
    a = ugly_intervals(generator(name), examples(2000), UGLY, low, high)
    found = applied(code, a)
    for first, last, lower, upper in zip(*a, *found, strict=True):
        what = f"{name} of [{first!r}, {last!r}] = [{lower!r}, {upper!r}]"
        # Arguments beyond all numbers are no arguments.
        assert_end(lower, at(exact, limits, first), -1, what)
        assert_end(upper, at(exact, limits, last), 1, what)


@pytest.mark.slow
def test_falling_and_even_functions_are_enclosed_to_some_ulps_of_each_end() -> None:
    rng = generator("acos")
    a = ugly_intervals(rng, examples(2000), UGLY, -1.0, 1.0)
    for first, last, lower, upper in zip(*a, *applied("OP_ACOS", a), strict=True):
        what = f"acos of [{first!r}, {last!r}] = [{lower!r}, {upper!r}]"
        assert_end(lower, decimals.acos(Decimal(last)), -1, what)
        assert_end(upper, decimals.acos(Decimal(first)), 1, what)
    a = ugly_intervals(rng, examples(2000), UGLY, -INF, INF)
    for first, last, lower, upper in zip(*a, *applied("OP_COSH", a), strict=True):
        what = f"cosh of [{first!r}, {last!r}] = [{lower!r}, {upper!r}]"
        least, most = sizes(first, last)
        assert_end(lower, at(decimals.cosh, (INF, INF), least), -1, what)
        assert_end(upper, at(decimals.cosh, (INF, INF), most), 1, what)


def sizes(low: float, high: float) -> tuple[float, float]:
    """Least and greatest absolute value."""
    return (0.0 if low <= 0 <= high else min(abs(low), abs(high))), max(abs(low), abs(high))


def wave_range(first: float, last: float, ahead: int) -> tuple[Decimal, Decimal]:
    """Range of the sine ``ahead`` quarters of a turn further on."""
    function = decimals.cos if ahead else decimals.sin
    ends = [function(Decimal(first)), function(Decimal(last))]
    quarter = decimals.pi() / 2
    top = floor((Decimal(last) / quarter - (1 - ahead)) / 4) >= -floor(-(Decimal(first) / quarter - (1 - ahead)) / 4)
    bottom = floor((Decimal(last) / quarter - (3 - ahead)) / 4) >= -floor(-(Decimal(first) / quarter - (3 - ahead)) / 4)
    return (Decimal(-1) if bottom else min(ends)), (Decimal(1) if top else max(ends))


def floor(value: Decimal) -> int:
    return math.floor(Fraction(value))


@pytest.mark.parametrize(("code", "ahead"), [("OP_SIN", 0), ("OP_COS", 1)])
def test_waves_are_enclosed_to_some_ulps_of_each_end(code: str, ahead: int) -> None:
    a = ugly_intervals(generator(code), examples(4000), UGLY + 2 * CIRCLE, -INF, INF)
    rough = 0
    for first, last, lower, upper in zip(*a, *applied(code, a), strict=True):
        what = f"{code} of [{first!r}, {last!r}] = [{lower!r}, {upper!r}]"
        if max(abs(first), abs(last)) > FARTHEST:
            assert (lower, upper) == (-1, 1), what
            rough += 1
            continue
        least, most = wave_range(first, last, ahead)
        assert_end(lower, least, -1, what)
        assert_end(upper, most, 1, what)
        assert -1 <= lower <= upper <= 1, what
    assert rough < 0.7 * len(a[0])


@pytest.mark.slow
def test_tangents_are_enclosed_between_poles_and_nowhere_else() -> None:
    a = ugly_intervals(generator("tan"), examples(4000), UGLY + 4 * CIRCLE, -FARTHEST, FARTHEST)
    narrow = np.minimum(a[1], a[0] + np.abs(a[0]) * 1e-12 + 0.1)
    quarter, bounded = decimals.pi() / 2, 0
    for first, last, lower, upper in zip(a[0], narrow, *applied("OP_TAN", (a[0], narrow)), strict=True):
        what = f"tan of [{first!r}, {last!r}] = [{lower!r}, {upper!r}]"
        pole = floor((Decimal(last) / quarter - 1) / 2) >= -floor(-(Decimal(first) / quarter - 1) / 2)
        assert pole == ((lower, upper) == (-INF, INF)), what
        if not pole:
            bounded += 1
            assert_end(lower, decimals.tan(Decimal(first)), -1, what)
            assert_end(upper, decimals.tan(Decimal(last)), 1, what)
    assert bounded > len(narrow) / 2


def test_the_rest_of_an_argument_is_right_to_half_an_ulp_and_so_is_what_lies_between() -> None:
    rng = generator("rest")
    near = np.rint(rng.uniform(1, FARTHEST / 1.6, examples(2000))) * (math.pi / 2)
    x = np.concatenate([np.array(CIRCLE), near, rng.uniform(-FARTHEST, FARTHEST, len(near)), [0.0, TINY, FARTHEST]])
    found = reduced(x)
    for argument, turns, rest in zip(x, found.turns, found.rest, strict=True):
        expected = Decimal(argument) - int(turns) * decimals.pi() / 2
        assert abs(Decimal(rest) - expected) <= Decimal("0.5001") * ulp(expected), argument
        assert abs(rest) <= math.pi / 4 + 1e-7
    # A crest is between its neighbours, and not between those on one side of it.
    below, above = reduced(np.array([math.pi / 2])), reduced(np.array([math.nextafter(math.pi / 2, 2)]))
    assert passes(below, above, 1, 4).all()
    assert not passes(below, below, 1, 4).any()
    assert not passes(above, above, 1, 4).any()
    zero = reduced(np.array([0.0]))
    assert passes(zero, zero, 0, 4).all()


def corners(exact: Exact, a: tuple[float, float], b: tuple[float, float]) -> list[Decimal]:
    return [exact(Decimal(x), Decimal(y)) for x in a for y in b]


def test_angles_are_enclosed_to_some_ulps_of_each_end() -> None:
    rng = generator("atan2")
    special = (0.0, -0.0, 0.0, TINY, -TINY, 1.0, -1.0, 3.0, -1e-9, 1e200, -1e300)
    y, x = (ugly_intervals(rng, examples(4000), special, -1e300, 1e300) for _ in range(2))
    for low, high, left, right, lower, upper in zip(*y, *x, *applied("OP_ATAN2", y, x), strict=True):
        what = f"atan2 of [{low!r}, {high!r}], [{left!r}, {right!r}] = [{lower!r}, {upper!r}]"
        if low < 0 <= high and left < 0:
            least, most = -decimals.pi(), decimals.pi()
        else:
            angles = corners(decimals.atan2, (low, high), (left, right))
            least, most = min(angles), max(angles)
        assert_end(lower, least, -1, what)
        assert_end(upper, most, 1, what)


@pytest.mark.parametrize(
    ("y", "x", "low", "high"),
    [
        ((0, 1), (-2, -1), 2.356194, math.pi), ((0, 0), (-2, -1), math.pi, math.pi), ((0, 0), (1, 2), 0, 0),
        ((0, 1), (0, 1), 0, math.pi / 2), ((-1, 1), (0, 1), -math.pi / 2, math.pi / 2),
        ((-1, 0), (0, 2), -math.pi / 2, 0),
        ((-1, 0), (-2, -1), -math.pi, math.pi), ((-1, 1), (-2, 3), -math.pi, math.pi), ((0, 2), (-1, 1), 0, math.pi),
        ((1, 2), (-1, 1), 0.785398, 2.356194), ((0, 0), (0, 0), 0, 0), ((-0.0, -0.0), (-2, -1), math.pi, math.pi),
    ],
)  # fmt: skip
def test_angles_of_boxes_that_touch_the_cut(
    y: tuple[float, float], x: tuple[float, float], low: float, high: float
) -> None:
    lower, upper = applied("OP_ATAN2", *((np.array([a[0]], float), np.array([a[1]], float)) for a in (y, x)))
    assert lower[0] == pytest.approx(low, abs=1e-6)
    assert upper[0] == pytest.approx(high, abs=1e-6)


@pytest.mark.slow
def test_hypotenuses_and_powers_are_enclosed_to_some_ulps_of_each_end() -> None:
    rng = generator("hypot")
    x, y = (ugly_intervals(rng, examples(2000), UGLY, -MOST, MOST) for _ in range(2))
    for low, high, left, right, lower, upper in zip(*x, *y, *applied("OP_HYPOT", x, y), strict=True):
        what = f"hypot of [{low!r}, {high!r}], [{left!r}, {right!r}] = [{lower!r}, {upper!r}]"
        ends = [
            decimals.hypot(Decimal(a), Decimal(b)) for a, b in zip(sizes(low, high), sizes(left, right), strict=True)
        ]
        assert_end(lower, ends[0], -1, what)
        assert_end(upper, ends[1], 1, what)
    base = ugly_intervals(rng, examples(2000), UGLY, TINY, MOST)
    exponent = ugly_intervals(rng, examples(2000), (0.0, 0.5, -0.5, 1.0, 2.0, -3.0, 1e-300), -30.0, 30.0)
    for low, high, left, right, lower, upper in zip(*base, *exponent, *applied("OP_POW", base, exponent), strict=True):
        what = f"power of [{low!r}, {high!r}], [{left!r}, {right!r}] = [{lower!r}, {upper!r}]"
        values = corners(decimals.power, (low, high), (left, right))
        assert_end(lower, min(values), -1, what)
        assert_end(upper, max(values), 1, what)


@pytest.mark.parametrize("n", [0, 1, 2, 3, 4, 7, 10, -1, -2, -3])
def test_whole_powers_of_any_base_are_enclosed_to_some_ulps_of_each_end(n: int) -> None:
    a = ugly_intervals(generator("whole", n + 10), examples(800), UGLY, -MOST, MOST)
    exponent = np.full_like(a[0], n), np.full_like(a[0], n)
    for first, last, lower, upper in zip(*a, *applied("OP_POW", a, exponent), strict=True):
        what = f"[{first!r}, {last!r}]^{n} = [{lower!r}, {upper!r}]"
        if n < 0 and first <= 0 <= last:
            assert (lower, upper) == (-INF, INF), what
            continue
        ends = [decimals.power(Decimal(x), Decimal(n)) for x in ((first, last) if n % 2 else sizes(first, last))]
        assert_end(lower, min(ends), -1, what)
        assert_end(upper, max(ends), 1, what)


@pytest.mark.parametrize("name", ["add", "subtract", "multiply", "divide"])
def test_arithmetic_is_enclosed_to_an_ulp_of_each_end(name: str) -> None:
    rng, rule = generator(name), getattr(rules, name)
    a, b = (ugly_intervals(rng, examples(4000), UGLY, -MOST, MOST) for _ in range(2))
    if name == "divide":
        keep = ~rules.holds_zero(b)
        a, b = (a[0][keep], a[1][keep]), (b[0][keep], b[1][keep])
    exact: Callable[[Fraction, Fraction], Fraction] = {
        "add": lambda x, y: x + y, "subtract": lambda x, y: x - y, "multiply": lambda x, y: x * y,
        "divide": lambda x, y: x / y,
    }[name]  # fmt: skip
    with np.errstate(all="ignore"):
        found = rule(a, b)
    for low, high, left, right, lower, upper in zip(*a, *b, *found, strict=True):
        what = f"{name} of [{low!r}, {high!r}], [{left!r}, {right!r}] = [{lower!r}, {upper!r}]"
        values = [exact(Fraction(x), Fraction(y)) for x in (low, high) for y in (left, right)]
        assert_next(lower, min(values), -1, what)
        assert_next(upper, max(values), 1, what)


def assert_next(found: float, true: Fraction, side: int, what: str) -> None:
    """``found`` is beyond ``true`` by 2 ulps at most, and 0 where that is."""
    if not true:
        assert abs(found) <= (0.0 if what.startswith(("multiply", "divide")) else TINY), what
    if math.isinf(found):
        assert found * side > 0, what
        assert side * true > Fraction(MOST) * (1 - Fraction(1, 2**50)), what
        return
    assert side * (Fraction(found) - true) >= 0, what
    size = min(max(abs(float(true)) if abs(true) < Fraction(MOST) else MOST, TINY), MOST)
    assert abs(true) > Fraction(MOST) or side * (Fraction(found) - true) <= 2 * Fraction(math.ulp(size)), what


def test_squares_and_roots_are_enclosed_to_an_ulp_of_each_end() -> None:
    a = ugly_intervals(generator("square"), examples(4000), UGLY, -MOST, MOST)
    for first, last, lower, upper in zip(*a, *applied("OP_SQ", a), strict=True):
        least, most = sizes(first, last)
        what = f"square of [{first!r}, {last!r}] = [{lower!r}, {upper!r}]"
        assert_next(lower, Fraction(least) ** 2, -1, what)
        assert_next(upper, Fraction(most) ** 2, 1, what)
    a = np.maximum(a[0], 0.0), np.maximum(a[1], 0.0)
    for first, last, lower, upper in zip(*a, *applied("OP_SQRT", a), strict=True):
        what = f"root of [{first!r}, {last!r}] = [{lower!r}, {upper!r}]"
        assert_end(lower, Decimal(first).sqrt(), -1, what)
        assert_end(upper, Decimal(last).sqrt(), 1, what)


#: Exact where the function is: (operation, argument, value).
EXACT = [
    ("OP_SIN", 0.0, 0.0), ("OP_TAN", 0.0, 0.0), ("OP_ASIN", 0.0, 0.0), ("OP_ACOS", 1.0, 0.0), ("OP_ATAN", 0.0, 0.0),
    ("OP_SINH", 0.0, 0.0), ("OP_COSH", 0.0, 1.0), ("OP_TANH", 0.0, 0.0), ("OP_ASINH", 0.0, 0.0), ("OP_ACOSH", 1.0, 0.0),
    ("OP_ATANH", 0.0, 0.0), ("OP_EXP", 0.0, 1.0), ("OP_EXPM1", 0.0, 0.0), ("OP_LOG", 1.0, 0.0), ("OP_LOG1P", 0.0, 0.0),
    ("OP_ERF", 0.0, 0.0), ("OP_SQRT", 0.0, 0.0), ("OP_SQ", 0.0, 0.0),
]  # fmt: skip


@pytest.mark.parametrize(("code", "argument", "value"), EXACT)
def test_what_is_exact_stays_so_and_no_bound_crosses_it(code: str, argument: float, value: float) -> None:
    place = np.array([argument])
    np.testing.assert_array_equal(applied(code, (place, place)), [[value], [value]])
    if code not in ("OP_COSH", "OP_ACOS", "OP_SQ"):
        above = np.array([math.nextafter(argument, INF)])
        assert applied(code, (place, above))[0] == value
        assert applied(code, (above, above))[0] >= value


def one(expression: Callable[[casadi.SX], casadi.SX], low: float, high: float) -> tuple[float, float]:
    x = casadi.SX.sym("x")
    (found,) = Tape(casadi.Function("f", [x], [expression(x)]))((np.array([[low]]), np.array([[high]])))
    return found.lower[0, 0], found.upper[0, 0]


@pytest.mark.parametrize(("low", "high"), [(0.0, 1e-9), (1e-283, 1.8e-45), (0.0, 0.0), (1e-300, 1e-300), (0.0, 3.0)])
def test_what_is_made_of_a_small_sine_is_bounded(low: float, high: float) -> None:
    assert one(casadi.sin, -high, -low)[1] <= 0
    roots: list[Callable[[casadi.SX], casadi.SX]] = [
        lambda x: casadi.sqrt(casadi.sin(x)),
        lambda x: casadi.sqrt(x * x + casadi.tan(x) ** 2),
    ]
    for expression in roots:
        lower, upper = one(expression, low, min(high, 1.5))
        assert 0 <= lower <= upper < INF
    if low > 0:
        assert one(lambda x: casadi.log(casadi.sin(x)), low, high)[0] == pytest.approx(math.log(low), rel=1e-12)
        assert one(lambda x: 1 / casadi.sin(x), low, high)[1] == pytest.approx(1 / low, rel=1e-12)


def test_the_oracle_agrees_with_the_library_and_with_identities() -> None:
    for x in (-3.0, -1e-5, 0.3, 0.99, 2.0, 40.0):
        for name in ("sin", "cos", "tan", "exp", "expm1", "sinh", "cosh", "tanh", "asinh", "atan", "erf"):
            value = float(getattr(decimals, name)(Decimal(x)))
            assert value == pytest.approx(getattr(math, name)(x), rel=1e-14), (name, x)
        d = Decimal(x)
        assert abs(decimals.sin(d) ** 2 + decimals.cos(d) ** 2 - 1) < Decimal("1e-25")
        assert abs(decimals.asinh(decimals.sinh(d)) - d) < Decimal("1e-60") * abs(d)
    for x in (0.3, 0.999, 1e-200):
        for name in ("asin", "acos", "atanh", "log1p", "log"):
            assert float(getattr(decimals, name)(Decimal(x))) == pytest.approx(getattr(math, name)(x), rel=1e-14)
    assert float(decimals.acosh(Decimal("1.5"))) == pytest.approx(math.acosh(1.5), rel=1e-14)
    assert str(decimals.pi())[:42] == "3.1415926535897932384626433832795028841971"
