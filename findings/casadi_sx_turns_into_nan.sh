#!/usr/bin/env bash
# Library: casadi 3.8.2 (Python), scalar symbols SX.
# Expected: math.cos of a symbol raises, as it does for the other symbol type, MX; so does storing a symbol in an
#   array of numbers.
# Happens: SX has a float value, NaN. `math.cos(SX)` is NaN, a row of np.zeros takes SX in as NaN, and the model is
#   built without a word. Its Jacobian is structurally zero there, `is_linear` calls it linear, and fmax(., 0) makes
#   a clean 0 of it, so that not even the result needs to be NaN. `SX.__float__` is not described.
# Matters: one `math.` instead of `casadi.` in a vehicle's kinematics gives a model without heading that converges.
#   After tracing, refuse a graph with a NaN constant, and compare with plain numbers at a few points.
set -euo pipefail
tmp=$(mktemp -d)
trap 'rm -rf "$tmp"' EXIT
python3 -m venv "$tmp/venv"
"$tmp/venv/bin/pip" install --quiet --quiet --no-compile --disable-pip-version-check \
    casadi==3.8.2 numpy==2.4.6
"$tmp/venv/bin/python" - <<'PYTHON'
import math
import sys
from importlib.metadata import version

import casadi
import numpy as np


def outcome(build, symbol):
    """What ``build`` makes of a symbol: its value, or the name of what it raises."""
    try:
        return build(symbol)
    except Exception as error:
        return type(error).__name__


def store(symbol):
    row = np.zeros(2)
    row[0] = symbol
    return row[0]


print("casadi", version("casadi"), "numpy", version("numpy"))
found = {}
for kind in (casadi.SX, casadi.MX):
    found[kind] = [outcome(build, kind.sym("heading")) for build in (math.cos, store)]
    print(f"{kind.__name__}: math.cos gives {found[kind][0]}, stored in np.zeros it is {found[kind][1]}")

heading = casadi.SX.sym("heading")
speed = casadi.SX.sym("speed")
ahead = casadi.fmax(speed * math.cos(heading), 0)  # of these, casadi.cos would be right
model = casadi.Function("ahead", [speed, heading], [ahead])
value = float(model(10.0, 0.0))
structure = casadi.jacobian(ahead, heading).nnz()
linear = casadi.is_linear(speed * math.cos(heading), casadi.vertcat(speed, heading))
print(f"fmax(10 * math.cos(0), 0) by the traced model: {value} (by numbers: 10.0);",
      f"entries of its Jacobian by heading: {structure}; product called linear: {linear}")
if any(not isinstance(made, str) for made in found[casadi.MX]):
    sys.exit("changed: MX no longer refuses to be a number")
if any(isinstance(made, str) or not math.isnan(made) for made in found[casadi.SX]):
    sys.exit("changed: SX no longer turns into NaN")
if value != 0.0 or structure != 0 or not linear:
    sys.exit("changed: the NaN no longer hides in the model")
PYTHON
