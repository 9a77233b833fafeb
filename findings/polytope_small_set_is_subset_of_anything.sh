#!/usr/bin/env bash
# Library: polytope 0.2.5 (TuLiP), `is_subset` and the operator <=.
# Expected: `is_subset(small, big)` is False when the two sets do not even touch; the docstring says "Return True if
#   small is a subset of big". The tolerance `abs_tol` (1e-7) is not described; in `contains` and `is_inside` it is
#   a length.
# Happens: the tolerance is a volume. A set is a subset of any other as soon as what sticks out has less than 1e-7
#   units of volume: a wall without thickness, far away, and also a 4-D box (position, heading, speed) of 1 cm, 1
#   cm, 0.01 rad, 0.01 m/s. `contains` says of its corner that it is outside.
# Matters: "reachable set <= safe set" is the check of a verifier. It passes for precise state estimates (the higher
#   the dimension, the larger the boxes) and for degenerate zonotopes. Compare support values, face by face.
set -euo pipefail
tmp=$(mktemp -d)
trap 'rm -rf "$tmp"' EXIT
python3 -m venv "$tmp/venv"
"$tmp/venv/bin/pip" install --quiet --quiet --no-compile --disable-pip-version-check \
    polytope==0.2.5 numpy==1.26.4 scipy==1.17.1 networkx==3.6.1
"$tmp/venv/bin/python" - <<'PYTHON'
import logging
import sys
from importlib.metadata import version

logging.disable(logging.WARNING)  # polytope tells which solver of linear programs it found

import numpy as np
import polytope

safe = polytope.box2poly([[0.0, 1.0]] * 4)
claims = {}
for name, box, corner in (
    ("1 cm wide, 4 away", [[5.0, 5.01]] * 4, [5.0] * 4),
    ("10 cm wide, 4 away", [[5.0, 5.1]] * 4, [5.0] * 4),
    ("wall without thickness, 4 away", [[5.0, 6.0]] * 3 + [[0.5, 0.5]], [5.0] * 3 + [0.5]),
):
    reach = polytope.box2poly(box)
    inside = bool(safe.contains(np.array(corner).reshape(4, 1))[0])
    claims[name] = (bool(polytope.is_subset(reach, safe)), bool(reach <= safe), inside)
print("polytope", version("polytope"), "numpy", version("numpy"))
for name, (function, operator, inside) in claims.items():
    print(f"4-D box, {name}: is_subset of the unit box: {function}, <=: {operator}; corner in the unit box: {inside}")
if any(inside for _, _, inside in claims.values()) or claims["10 cm wide, 4 away"][0]:
    sys.exit("changed: points outside are inside, or a large box is a subset")
if claims["1 cm wide, 4 away"][:2] != (True, True) or claims["wall without thickness, 4 away"][:2] != (True, True):
    sys.exit("changed: a small or flat set outside is no longer a subset")
PYTHON
