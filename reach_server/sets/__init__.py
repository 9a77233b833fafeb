"""Zonotopes and constrained zonotopes, batch axes first (docs: mathematics, section 1)."""

from reach_server.numeric.checks import SetError
from reach_server.numeric.intervals import Interval
from reach_server.sets.approximation import Direction
from reach_server.sets.constrained_zonotope import ConstrainedZonotope
from reach_server.sets.zonotope import Zonotope

__all__ = ["ConstrainedZonotope", "Direction", "Interval", "SetError", "Zonotope"]
