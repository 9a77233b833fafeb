"""Predicates as cuts: what a set loses if a predicate is to hold of its states, and whether one certainly does."""

from reach_server.predicates.discs import DISC_TANGENTS, tangents
from reach_server.predicates.interface import HOLDS, MAY_HOLD, NEVER, Context, ContextCache, Strips
from reach_server.predicates.literals import Literals

__all__ = ["DISC_TANGENTS", "HOLDS", "MAY_HOLD", "NEVER", "Context", "ContextCache", "Literals", "Strips", "tangents"]
