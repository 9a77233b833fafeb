"""Side information: formulas of signal temporal logic, scenarios, and the service that publishes them.

``side_info.service.service`` is not imported here: who only reads scenarios needs no network.
"""

from fleet_bus.errors import ScenarioError
from side_info.documents.scenario import Requirement, Scenario, shipped
from side_info.stl.ast import (
    Always,
    And,
    Atom,
    Comparison,
    Eventually,
    Formula,
    Implies,
    Not,
    Or,
    Region,
    Until,
)
from side_info.stl.declarations import Declarations
from side_info.stl.predicates import DiscPredicate, LinearPredicate, NonlinearPredicate, Predicate

__all__ = [
    "Always",
    "And",
    "Atom",
    "Comparison",
    "Declarations",
    "DiscPredicate",
    "Eventually",
    "Formula",
    "Implies",
    "LinearPredicate",
    "NonlinearPredicate",
    "Not",
    "Or",
    "Predicate",
    "Region",
    "Requirement",
    "Scenario",
    "ScenarioError",
    "Until",
    "shipped",
]
