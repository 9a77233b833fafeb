#!/usr/bin/env bash
# Library: commonroad-io 2026.1, commonroad.geometry.occupancy.circle_occupancy.CircleOccupancy.
# Expected: `shapely_object` is the circle as a polygon, with the radius that was given, as `contains_point` and
#   `enclosing_axis_aligned_rect` have it. The class says "radius: Radius of the circle".
# Happens: the polygon is drawn with half the radius. It has a quarter of the area; a point that `contains_point`
#   accepts lies outside, and an obstacle that overlaps the circle by half a metre does not intersect. Rectangles
#   are right.
# Matters: the polygon is what one intersects with a reachable set. Round obstacles then let
#   collisions pass, and nothing looks wrong in a scenario of rectangles. Build the circle from `center` and
#   `radius`, outwards.
set -euo pipefail
tmp=$(mktemp -d)
trap 'rm -rf "$tmp"' EXIT
python3 -m venv "$tmp/venv"
"$tmp/venv/bin/pip" install --quiet --quiet --no-compile --disable-pip-version-check \
    commonroad-io==2026.1 shapely==2.2.0 numpy==1.26.4 scipy==1.17.1
"$tmp/venv/bin/python" - <<'PYTHON'
import math
import sys
from importlib.metadata import version

from commonroad.geometry.occupancy.circle_occupancy import CircleOccupancy
from commonroad.geometry.occupancy.rect_occupancy import RectOccupancy
from shapely import Point

RADIUS = 2.0
circle = CircleOccupancy(radius=RADIUS, circle_center=Point(0.0, 0.0))
rectangle = RectOccupancy(rect_center=Point(0.0, 0.0), width=2 * RADIUS, length=2 * RADIUS, orientation=0.0)
car = RectOccupancy(rect_center=Point(3.5, 0.0), width=1.8, length=4.0, orientation=0.0)  # its rear is at x = 1.5
inside = Point(1.5, 0.0)
polygon = circle.shapely_object
area = polygon.area / (math.pi * RADIUS**2)
print("commonroad-io", version("commonroad-io"), "shapely", version("shapely"))
print(f"circle of radius {RADIUS}: contains_point{inside.coords[0]} = {circle.contains_point(inside)},",
      f"shapely_object.covers = {polygon.covers(inside)}")
print("bounds of its polygon:", tuple(round(bound, 3) for bound in polygon.bounds), f"area: {area:.3f} of the circle's")
print("car that reaches 0.5 m into the circle intersects the polygon:", polygon.intersects(car.shapely_object))
print("the same car intersects the square around the circle:", rectangle.shapely_object.intersects(car.shapely_object))
if not circle.contains_point(inside) or not rectangle.shapely_object.intersects(car.shapely_object):
    sys.exit("changed: the circle or the rectangle no longer has the size that was given")
if polygon.covers(inside) or polygon.intersects(car.shapely_object) or not 0.2 < area < 0.3:
    sys.exit("changed: the polygon of a circle no longer has half its radius")
PYTHON
