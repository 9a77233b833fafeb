#!/usr/bin/env bash
# Library: scipy 1.17.1, scipy.optimize.linprog with its default method (HiGHS inside).
# Expected: a linear program that is solved "successfully" meets its constraints to the tolerances that linprog
#   documents (1e-7), and `slack` is b - A x.
# Happens: coefficients of 1e-9 and below are dropped before solving, however large the variable. Here the
#   constraint is x + 5e-10 y <= 1 with y = 1e9, so x <= 0.5; linprog returns x = 1, status 0, and a slack of 0
#   where b - A x is -0.5. HiGHS warns of it in its own log, which linprog shows with disp=True only, and has an
#   option for the limit, which linprog does not pass on; its documentation mentions neither.
# Matters: support functions of sets with mixed units (metres, nanoseconds) come out wrong by half without a sign of
#   it. Scale rows and columns first, and recompute the residual of every answer; `slack` cannot be used for that.
set -euo pipefail
tmp=$(mktemp -d)
trap 'rm -rf "$tmp"' EXIT
python3 -m venv "$tmp/venv"
"$tmp/venv/bin/pip" install --quiet --quiet --no-compile --disable-pip-version-check \
    scipy==1.17.1 numpy==2.4.6
"$tmp/venv/bin/python" - <<'PYTHON'
import sys
from importlib.metadata import version

import numpy as np
from scipy.optimize import linprog


def largest_x(unit: float):
    """max x subject to x + 5e-10 y <= 1 and y = 1e9, with y counted in ``unit``."""
    matrix = np.array([[1.0, 5e-10 * unit]])
    y = 1e9 / unit
    answer = linprog([-1.0, 0.0], A_ub=matrix, b_ub=[1.0], bounds=[(0.0, 10.0), (y, y)])
    return answer.status, answer.x[0], answer.slack[0], 1.0 - (matrix @ answer.x)[0]


print("scipy", version("scipy"), "numpy", version("numpy"))
found = {}
for unit in (1.0, 1e9):
    found[unit] = status, x, slack, residual = largest_x(unit)
    print(f"y in units of {unit:g}: status {status}, x = {x:.6g} (exact: 0.5),",
          f"slack {slack:.3g}, b - A x = {residual:.3g}")
if not np.allclose(found[1e9], (0, 0.5, 0.0, 0.0), atol=1e-6):
    sys.exit("changed: the scaled program is not solved any more")
if not np.allclose(found[1.0], (0, 1.0, 0.0, -0.5), atol=1e-6):
    sys.exit("changed: small coefficients are no longer dropped in silence")
PYTHON
