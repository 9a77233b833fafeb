"""How many samples are missing before a method has a model."""

import numpy as np
from numpy.typing import NDArray

from reach_server.data.window import Window


def samples_missing(
    window: Window, slots: NDArray[np.intp], usable: NDArray[np.int64], needed: int, links: int
) -> NDArray[np.int64]:
    """Least number (B,) of samples to come until each vehicle has ``needed`` data, of which it has ``usable`` (B,).

    A datum ends at a sample that at least ``links`` links in a row lead to: its lagged inputs, and its steps ahead. So
    the vehicle first completes the links that its newest sample lacks; from then on each sample brings a datum, if it
    follows the one before it, has an input, and no datum leaves the window. 0 where there is enough.
    """
    newest = (window.count[slots] - 1) % window.size
    run = np.where(window.count[slots] > 0, window.arrays().run[slots, newest].astype(np.int64), -1)
    lacking = np.maximum(needed - usable, 0)
    return np.where(lacking > 0, lacking + np.maximum(links - 1 - run, 0), 0)


def too_few(method: str, missing: int) -> str:
    """The reason given while a vehicle has too few samples."""
    return f"too few samples for {method}: at least {missing} more"
