#!/usr/bin/env bash
# Library: rtamt 0.4.10, its discrete-time and its dense-time monitor of signal temporal logic.
# Expected: the two agree on signals that step at the sample times. The README gives one formula for both: rho(phi
#   until psi, t) = max over t' of min(rho(psi, t'), min of rho(phi) over [t, t')), open at t'.
# Happens: the discrete monitor does that. The dense one wants phi at t' as well: where phi ends in the very sample
#   in which psi begins, one says satisfied by 1, the other violated by 1. With one sample of overlap they agree
#   again.
# Matters: "keep the lane until the turn begins" is a hand-over of this kind. Moving a monitor from sampled to dense
#   time turns a verdict around, sign and all; whoever compares with rtamt must say which until is meant.
set -euo pipefail
tmp=$(mktemp -d)
trap 'rm -rf "$tmp"' EXIT
python3 -m venv "$tmp/venv"
"$tmp/venv/bin/pip" install --quiet --quiet --no-compile --disable-pip-version-check \
    antlr4-python3-runtime==4.7 rtamt==0.4.10
"$tmp/venv/bin/python" - <<'PYTHON'
import sys
from importlib.metadata import version

import rtamt

TIMES = [0, 1, 2, 3]
TURN = [-1.0, -1.0, 1.0, 1.0]
FORMULA = "(lane >= 0) until[0,3] (turn >= 0)"


def prepared(monitor):
    for name in ("lane", "turn"):
        monitor.declare_var(name, "float")
    monitor.spec = FORMULA
    monitor.parse()
    return monitor


def discrete(lane: list[float]) -> float:
    monitor = prepared(rtamt.StlDiscreteTimeSpecification())
    return monitor.evaluate({"time": TIMES, "lane": lane, "turn": TURN})[0][1]


def dense(lane: list[float]) -> float:
    monitor = prepared(rtamt.StlDenseTimeSpecification())
    signals = {"lane": lane, "turn": TURN}
    return monitor.evaluate(*([name, [[float(t), v] for t, v in zip(TIMES, signals[name])]] for name in signals))[0][1]


def formula_of_the_readme(lane: list[float]) -> float:
    return max(min([TURN[end], *lane[:end]]) for end in range(len(TIMES)))


print("rtamt", version("rtamt"), "robustness at time 0 of", FORMULA, "with turn =", TURN)
found = {}
for name, lane in (("hand-over", [1.0, 1.0, -1.0, -1.0]), ("overlap", [1.0, 1.0, 1.0, -1.0])):
    found[name] = (discrete(lane), dense(lane), formula_of_the_readme(lane))
    print(f"{name}: lane = {lane}: discrete {found[name][0]:+}, dense {found[name][1]:+}, README {found[name][2]:+}")
if found["overlap"] != (1.0, 1.0, 1.0):
    sys.exit("changed: the two monitors no longer agree where the operands overlap")
if found["hand-over"] != (1.0, -1.0, 1.0):
    sys.exit("changed: the two monitors no longer contradict each other at a hand-over")
PYTHON
