"""How often the audit is wrong about an honest record, and how soon it tells of one that is not."""

import numpy as np

from benchmarks.report import Cell, Claim, Table
from reach_server.audit.prediction_check import RECENT, bands
from reach_server.numeric.types import BoolArray

ALPHA = 0.01
#: Misses in a row, on average, where they come in groups.
GROUP = 3.0


def run(quick: bool) -> Table:
    """Times that simulated records leave their band, and how long they are outside."""
    records, checks = (20, 4000) if quick else (200, 100_000)
    rng = np.random.default_rng(0)
    rows: list[tuple[Cell, ...]] = []
    for name, missed in (
        ("honest: 1 %, independent", rng.random((checks, records)) < ALPHA),
        (f"1 %, in groups of {GROUP:g}", _grouped(rng, checks, records)),
        ("twice as many: 2 %, independent", rng.random((checks, records)) < 2 * ALPHA),
    ):
        left, outside = _watch(missed)
        told = np.where(outside.any(axis=0), outside.argmax(axis=0), checks)
        later = left[RECENT:].mean()
        rows.append((
            name, 100 * float(missed.mean()), float(left[:RECENT].sum(axis=0).mean()), float(later) * 10_000,
            float(1 / later) if later else None, 100 * float(outside[RECENT:].mean()), float(np.median(told)),
        ))  # fmt: skip
    return Table(
        "False alarms of the audit",
        f"{records} simulated records of {checks} checks each, judged as a server judges: by the newest {RECENT} "
        f"checks, after each of them, at a confidence of {100 * (1 - ALPHA):g} %. 'Left': how often a record left its "
        f"band, in its first {RECENT} checks, and in 10 000 later ones. 'Told': checks until half of the records had "
        "left it.",
        (
            "misses", "missed %", f"left, first {RECENT}", "left, in 10 000", "checks between", "outside %", "told",
        ),
        rows,
        [
            Claim("honest record: times it leaves its band in 10 000 checks", float(str(rows[0][3])), "≤", 0.5),
            Claim("honest record: % of the time outside", float(str(rows[0][5])), "≤", 5.0),
            Claim("twice as many misses: % of the time outside", float(str(rows[2][5])), "≥", 50.0),
        ],
    )  # fmt: skip


def _grouped(rng: np.random.Generator, checks: int, records: int) -> BoolArray:
    """Misses (checks, records) as often as ``ALPHA``, that begin at random and end with one chance in ``GROUP``."""
    begin = ALPHA / GROUP / (1 - ALPHA)
    missed = np.zeros((checks, records), dtype=bool)
    now = np.zeros(records, dtype=bool)
    for k, draw in enumerate(rng.random((checks, records))):
        missed[k] = now = np.where(now, draw >= 1 / GROUP, draw < begin)
    return missed


def _watch(missed: BoolArray) -> tuple[BoolArray, BoolArray]:
    """When records leave their bands, and when they are outside (checks, records)."""
    leaves, returns = bands(ALPHA)
    total = np.cumsum(missed, axis=0, dtype=np.int32)
    recent = total.copy()
    recent[RECENT:] -= total[:-RECENT]
    left, outside = np.zeros_like(missed), np.zeros_like(missed)
    now = np.zeros(missed.shape[1], dtype=bool)
    for k, misses in enumerate(recent):
        held = min(k + 1, RECENT)
        left[k] = ~now & (misses > leaves[held])
        now = (now | left[k]) & ~(now & (misses <= returns[held]))
        outside[k] = now
    return left, outside
