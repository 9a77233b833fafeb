"""Zonotopes and constrained zonotopes, batch axes first (docs: mathematics, section 1)."""

from reach_server.sets.arrays import SetError
from reach_server.sets.constrained import ConstrainedZonotope
from reach_server.sets.direction import Direction
from reach_server.sets.intervals import Interval
from reach_server.sets.zonotope import Zonotope

__all__ = ["ConstrainedZonotope", "Direction", "Interval", "SetError", "Zonotope"]
