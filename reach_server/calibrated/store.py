"""What is kept of every vehicle, by slot, for compiled loops. Samples are named by their number in the stream."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from reach_server.calibrated.terms import Terms
from reach_server.rows import with_room
from reach_server.sets.arrays import Array, Mask
from reach_server.windows import Ints


class Model(NamedTuple):
    """Regressions of V vehicles with F features and C = N n columns.

    ``mean``, ``scale``, ``limit`` (V, F) standardise the features; ``gram`` (V, F, F) lower triangle and ``cross``
    (V, F, C) are sums over the data numbered from ``oldest`` to before ``newest`` (V,), ``data`` (V,) in number;
    ``ridge`` (V,); ``matrix`` (V, F, C).
    """

    mean: Array
    scale: Array
    limit: Array
    gram: Array
    cross: Array
    matrix: Array
    data: Ints
    oldest: Ints
    newest: Ints
    ridge: Array


class Record(NamedTuple):
    """Errors of the predictions of V vehicles, by the place of the sample that showed them, S places.

    ``codes`` (V, S, N, n) their magnitudes (``scores.encoded``, 0 where not known); ``scores`` (V, S, K), NaN where not
    known, K = N, or N + 1 with those of whole tubes last; ``known`` (V, K) their numbers, ``limits`` (V, K) their rank
    statistics. Sizes: a = sqrt(B ψ) with B = ``shape`` (V, N, Q, n) and ψ at most ``clip`` (V, N, Q); ``margin`` (V, N)
    scales the sizes, ``ratio`` (V, N) those of whole tubes.
    """

    codes: NDArray[np.uint16]
    scores: NDArray[np.float32]
    known: Ints
    limits: Array
    shape: Array
    clip: Array
    margin: Array
    ratio: Array


class Waiting(NamedTuple):
    """Predictions of V vehicles that wait for what they predict, by their number modulo N.

    ``number`` (V, N), -1 for none; ``center`` and ``size`` (V, N, N, n); ``angle`` (V, N) of the frame. ``last`` (V, n)
    is the newest one-step error in units of its box, of sample ``last_number`` (V,); ``seen`` (V,) samples are taken
    in, ``glitches`` (V,) counted; ``fitted`` (V,): there is a model.
    """

    number: Ints
    center: Array
    size: Array
    angle: Array
    last: Array
    last_number: Ints
    seen: Ints
    glitches: Ints
    fitted: Mask


def empty(terms: Terms, places: int, *, tube: bool) -> tuple[Model, Record, Waiting]:
    """Arrays for no vehicle yet, with a ring of ``places``."""
    f, n, steps, columns = terms.total, terms.n, terms.horizon, terms.horizon * terms.n
    kinds = steps + int(tube)

    def real(*shape: int) -> Array:
        return np.zeros((0, *shape))

    def whole(*shape: int) -> Ints:
        return np.zeros((0, *shape), dtype=np.int64)

    model = Model(
        mean=real(f), scale=real(f), limit=real(f), gram=real(f, f), cross=real(f, columns), matrix=real(f, columns),
        data=whole(), oldest=whole(), newest=whole(), ridge=real(),
    )  # fmt: skip
    record = Record(
        codes=np.zeros((0, places, steps, n), dtype=np.uint16), scores=np.zeros((0, places, kinds), dtype=np.float32),
        known=whole(kinds), limits=real(kinds), shape=real(steps, terms.sizes, n), clip=real(steps, terms.sizes),
        margin=real(steps), ratio=real(steps),
    )  # fmt: skip
    waiting = Waiting(
        number=whole(steps), center=real(steps, steps, n), size=real(steps, steps, n), angle=real(steps),
        last=real(n), last_number=whole(), seen=whole(), glitches=whole(), fitted=np.zeros(0, dtype=bool),
    )  # fmt: skip
    return model, record, waiting


def grown(arrays: Any, slots: int) -> Any:
    """One of the above with room for ``slots`` vehicles."""
    return type(arrays)(*(with_room(array, slots, array) for array in arrays))
