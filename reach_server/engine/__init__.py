"""One step for a batch of vehicles of a class: windows, models, tubes, audit."""

from reach_server.engine.engine import Engine
from reach_server.engine.results import Tubes

__all__ = ["Engine", "Tubes"]
