"""Predicates: strips that cut a set to the states that satisfy one, and three-valued verdicts on whole sets."""

from reach_server.predicates.discs import DISC_TANGENTS, tangents
from reach_server.predicates.interface import HOLDS, MAY_HOLD, NEVER, Context, ContextCache, Strips
from reach_server.predicates.literals import Literals

__all__ = ["DISC_TANGENTS", "HOLDS", "MAY_HOLD", "NEVER", "Context", "ContextCache", "Literals", "Strips", "tangents"]
