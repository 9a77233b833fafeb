"""The messages of the bus: frozen data, strict and bounded coding, one schema name and version each."""

from fleet_bus.messages.checkpoint import CheckpointPart
from fleet_bus.messages.documents import (
    Assignment,
    Document,
    Event,
    EventKind,
    ScenarioDocument,
    ServiceStatus,
)
from fleet_bus.messages.journal import JournalRound
from fleet_bus.messages.profile import Lipschitz, NoiseSet, VehicleProfile, load_profile, parse_profile
from fleet_bus.messages.state import StateBatch, StateFlag, StateSample, decode_states
from fleet_bus.messages.tube import Audit, Cut, Label, ReachTube

__all__ = [
    "Assignment",
    "Audit",
    "CheckpointPart",
    "Cut",
    "Document",
    "Event",
    "EventKind",
    "JournalRound",
    "Label",
    "Lipschitz",
    "NoiseSet",
    "ReachTube",
    "ScenarioDocument",
    "ServiceStatus",
    "StateBatch",
    "StateFlag",
    "StateSample",
    "VehicleProfile",
    "decode_states",
    "load_profile",
    "parse_profile",
]
