"""What is kept of every vehicle, by slot, for compiled loops. Samples are named by their number in the stream."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from reach_server.models.conformal.spec import FeatureSpec
from reach_server.numeric.slot_table import grow_rows
from reach_server.numeric.types import BoolArray, FloatArray, IntArray


class Model(NamedTuple):
    """Regressions of V vehicles with F features and C = N n columns.

    ``mean``, ``scale``, ``limit`` (V, F) standardise the features; ``gram`` (V, F, F) lower triangle and ``cross``
    (V, F, C) are sums over the data numbered from ``oldest`` to before ``newest`` (V,), ``data`` (V,) in number;
    ``ridge`` (V,); ``matrix`` (V, F, C). ``low`` and ``high`` (V, n + m): the ranges of states and
    inputs (``observed_range``).
    """

    mean: FloatArray
    scale: FloatArray
    limit: FloatArray
    gram: FloatArray
    cross: FloatArray
    matrix: FloatArray
    data: IntArray
    oldest: IntArray
    newest: IntArray
    ridge: FloatArray
    low: FloatArray
    high: FloatArray


class ScoreHistory(NamedTuple):
    """Errors of the predictions of V vehicles, by the place of the sample that showed them, S places.

    ``codes`` (V, S, N, n) their magnitudes (``scores.encoded``, 0 where not known). The positions and the other states
    are G groups (one, where there are positions only), each with ``scores`` (V, G, S, K), ``encoded_score``, K = N,
    or N + 1 with those of whole tubes last; ``known`` (V, G, K) their numbers, ``limits`` (V, G, K) their rank
    statistics.
    Sizes: a = sqrt(B ψ) with B = ``shape`` (V, N, Q, n) and ψ at most ``clip`` (V, N, Q); ``margin`` (V, G, N) scales
    the sizes, ``ratio`` (V, G, N) those of whole tubes. ``fastest`` (V, n): the greatest change of each state from one
    sample to the next that the window shows (of positions, the length of the way), in units of the state.
    """

    codes: NDArray[np.uint16]
    scores: NDArray[np.uint16]
    known: IntArray
    limits: FloatArray
    shape: FloatArray
    clip: FloatArray
    margin: FloatArray
    ratio: FloatArray
    fastest: FloatArray


class PendingPredictions(NamedTuple):
    """Predictions of V vehicles that wait for what they predict, by their number modulo N.

    ``number`` (V, N), -1 for none; ``center`` and ``size`` (V, N, N, n); ``angle`` (V, N) of the frame. ``last`` (V, n)
    is the newest one-step error in units of its box, of sample ``last_number`` (V,); ``seen`` (V,) samples are taken
    in, ``glitches`` (V,) counted; ``fitted`` (V,): there is a model.
    """

    number: IntArray
    center: FloatArray
    size: FloatArray
    angle: FloatArray
    last: FloatArray
    last_number: IntArray
    seen: IntArray
    glitches: IntArray
    fitted: BoolArray


def empty(
    spec: FeatureSpec, indices: int, groups: int, *, tube: bool
) -> tuple[Model, ScoreHistory, PendingPredictions]:
    """Arrays for no vehicle yet, with a ring of ``indices`` and so many groups of states."""
    f, n, steps, columns = spec.total, spec.n, spec.horizon, spec.horizon * spec.n
    kinds = steps + int(tube)

    def real(*shape: int) -> FloatArray:
        return np.zeros((0, *shape))

    def whole(*shape: int) -> IntArray:
        return np.zeros((0, *shape), dtype=np.int64)

    model = Model(
        mean=real(f), scale=real(f), limit=real(f), gram=real(f, f), cross=real(f, columns), matrix=real(f, columns),
        data=whole(), oldest=whole(), newest=whole(), ridge=real(), low=real(n + spec.m), high=real(n + spec.m),
    )  # fmt: skip
    record = ScoreHistory(
        codes=np.zeros((0, indices, steps, n), dtype=np.uint16),
        scores=np.zeros((0, groups, indices, kinds), dtype=np.uint16),
        known=whole(groups, kinds), limits=real(groups, kinds),
        shape=real(steps, spec.sizes, n), clip=real(steps, spec.sizes),
        margin=real(groups, steps), ratio=real(groups, steps), fastest=real(n),
    )  # fmt: skip
    pending = PendingPredictions(
        number=whole(steps), center=real(steps, steps, n), size=real(steps, steps, n), angle=real(steps),
        last=real(n), last_number=whole(), seen=whole(), glitches=whole(), fitted=np.zeros(0, dtype=bool),
    )  # fmt: skip
    return model, record, pending


def grown(arrays: Any, slots: int) -> Any:
    """One of the above with room for ``slots`` vehicles."""
    return type(arrays)(*(grow_rows(array, slots, array) for array in arrays))
