#!/usr/bin/env bash
# Library: shapely 2.2.0 (GEOS inside), `minimum_bounding_circle` and `minimum_rotated_rectangle`.
# Expected: both give an outer shape. By their docstrings the circle "encloses an input geometry", and so does the
#   rectangle; neither says that a polygon stands in for the circle.
# Happens: the circle comes as a polygon inscribed in it, so what touches the circle sticks out of the polygon
#   unless it sits on one of its corners: up to 0.5 % of the radius, 12 cm at 25 m. Of 200 random clouds of ten
#   points it covers none. The rectangle misses most of them too, there by a rounding only.
# Matters: used as a quick cover of a reachable set or of an obstacle, both are not covers. Take the radius from
#   `minimum_bounding_radius` and the centre, and draw the polygon around the circle; widen rectangles outwards.
set -euo pipefail
tmp=$(mktemp -d)
trap 'rm -rf "$tmp"' EXIT
python3 -m venv "$tmp/venv"
"$tmp/venv/bin/pip" install --quiet --quiet --no-compile --disable-pip-version-check \
    shapely==2.2.0 numpy==2.4.6
"$tmp/venv/bin/python" - <<'PYTHON'
import sys
from importlib.metadata import version

import numpy as np
import shapely

rng = np.random.default_rng(0)
clouds = shapely.multipoints(25.0 * rng.standard_normal((200, 10, 2)))
print("shapely", version("shapely"), "GEOS", shapely.geos_version_string)
missed = {}
for name, cover in (("circle", shapely.minimum_bounding_circle), ("rectangle", shapely.minimum_rotated_rectangle)):
    covers = cover(clouds)
    points = shapely.get_parts(clouds).reshape(200, 10)
    out = shapely.distance(points, covers[:, None]).max(axis=1) / shapely.minimum_bounding_radius(clouds)
    missed[name] = int((~shapely.covers(covers, clouds)).sum()), float(out.max())
    print(f"{name}: {missed[name][0]} of 200 clouds not covered; farthest out: {missed[name][1]:.2g} of the radius")
if missed["circle"][0] < 190 or not 1e-3 < missed["circle"][1] < 1e-2:
    sys.exit("changed: the bounding circle now covers its points")
if missed["rectangle"][0] < 50 or missed["rectangle"][1] > 1e-9:
    sys.exit("changed: the rotated rectangle now covers its points, or misses them by more than a rounding")
PYTHON
