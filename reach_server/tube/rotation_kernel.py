"""Increments turned by an uncertain heading, compiled.

With position p, heading θ = θ_c + tξ, |tξ| <= ρ, and increment d = d_c + Dξ over
common factors ξ,

    R(θ) d = R(θ_c) [ d_c + (D + J d_c t) ξ + J (Dξ)(tξ) + (cos - 1) d + (sin - tξ) J d ],  J = [[0, -1], [1, 0]]

The linear part keeps its generators. A product of linear forms is enclosed by
``(aξ)(bξ) ∈ ½ Σ a_i b_i ± (|a|₁|b|₁ - ½ Σ |a_i b_i|)``: squares lie in [0, 1], mixed terms in [-1, 1]. The cosine part
lies in [-ρ²/2, 0] d, the sine part in ±ρ³/6 |d| with the components exchanged. Beyond ρ = 1.5 all of
``(R(tξ) - I) d`` is enclosed by ±2 |d| instead.

Rounding: ``(G + 16) EPS`` times the sizes of position and increment is added to what is not linear.
"""

import numpy as np

from reach_server.numeric.jit import leaf_kernel
from reach_server.numeric.rounding import EPS
from reach_server.numeric.types import FloatArray

#: Beyond this heading half-width the rotation is enclosed as a whole.
WIDE_TURN = 1.5


@leaf_kernel
def turn_one(
    center: FloatArray,
    generators: FloatArray,
    used: int,
    shift: FloatArray,
    moved: FloatArray,
    count: int,
    pose: tuple[int, int, int],
    rest: FloatArray,
) -> None:
    """Turn an increment, of center ``shift`` and ``count`` columns ``moved``, in place by the heading of a state, whose
    generators are the first ``used``. ``rest``: two columns more for the position, for what is not linear."""
    first, second, heading = pose
    x, y = moved[first], moved[second]
    dx, dy = shift[first], shift[second]
    rho, x_half, y_half = 0.0, 0.0, 0.0
    xt, yt, xt_size, yt_size = 0.0, 0.0, 0.0, 0.0
    for k in range(used):
        t = generators[heading, k]
        rho += abs(t)
        xt += x[k] * t
        yt += y[k] * t
        xt_size += abs(x[k] * t)
        yt_size += abs(y[k] * t)
    for k in range(count):
        x_half += abs(x[k])
        y_half += abs(y[k])
    x_most, y_most = abs(dx) + x_half, abs(dy) + y_half
    if rho <= WIDE_TURN:
        for k in range(used):
            t = generators[heading, k]
            x[k], y[k] = x[k] - dy * t, y[k] + dx * t
        square, cube = rho * rho, rho * rho * rho / 6
        x_rest = y_half * rho - 0.5 * yt_size + 0.25 * square * abs(dx) + 0.5 * square * x_half + cube * y_most
        y_rest = x_half * rho - 0.5 * xt_size + 0.25 * square * abs(dy) + 0.5 * square * y_half + cube * x_most
        dx, dy = dx - 0.5 * yt - 0.25 * square * dx, dy + 0.5 * xt - 0.25 * square * dy
    else:
        x_rest = y_rest = 2.0 * np.hypot(x_most, y_most)
    lost = (count + 16) * EPS * ((1.0 + rho) * (x_most + y_most) + abs(center[first]) + abs(center[second]))
    cos, sin = np.cos(center[heading]), np.sin(center[heading])
    for k in range(count):
        x[k], y[k] = cos * x[k] - sin * y[k], sin * x[k] + cos * y[k]
    shift[first], shift[second] = cos * dx - sin * dy, sin * dx + cos * dy
    rest[0], rest[1] = cos * (x_rest + lost), sin * (x_rest + lost)
    rest[2], rest[3] = -sin * (y_rest + lost), cos * (y_rest + lost)
