"""Decoding states: a batch at once against one by one."""

import numpy as np

from benchmarks.report import Table
from benchmarks.timing import median_seconds
from fleet_bus.messages import StateSample, decode_states
from fleet_bus.messages.state import ENCODING

MESSAGES = 2000


def run(quick: bool) -> Table:
    """Microseconds a message."""
    rng = np.random.default_rng(0)
    payloads = [StateSample(1, seq, 10**18 + seq, rng.normal(size=4), np.zeros(2)).encode() for seq in range(MESSAGES)]
    encodings = [ENCODING] * MESSAGES
    batch = median_seconds(lambda: decode_states(payloads, encodings), 5 if quick else 20) / MESSAGES
    single = median_seconds(lambda: [StateSample.decode(payload) for payload in payloads], 5) / MESSAGES
    return Table(
        "Decoding states",
        f"{MESSAGES} messages.",
        ("way", "µs a message", "ratio"),
        [("batch", batch * 1e6, 1.0), ("one by one", single * 1e6, single / batch)],
    )
