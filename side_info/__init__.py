"""Side information: formulas of signal temporal logic, scenarios, and the service that publishes them.

``side_info.service`` is not imported here: who only reads scenarios needs no network.
"""

from fleet_bus.errors import ScenarioError
from side_info.declarations import Declarations
from side_info.formula import (
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
from side_info.predicates import DiscPredicate, LinearPredicate, NonlinearPredicate, Predicate
from side_info.scenario import Requirement, Scenario, shipped

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
