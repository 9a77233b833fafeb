"""Side information: formulas of signal temporal logic, scenarios, and the service that publishes them.

``side_info.service`` is not imported here: who only reads scenarios needs no network.
"""

from fleet_bus.errors import ScenarioError
from side_info.declarations import Declarations
from side_info.formula import Always, And, Atom, Comparison, Formula, Region
from side_info.predicates import DiscPredicate, LinearPredicate, Predicate
from side_info.scenario import Scenario, shipped
from side_info.windows import TimedPredicate

__all__ = [
    "Always",
    "And",
    "Atom",
    "Comparison",
    "Declarations",
    "DiscPredicate",
    "Formula",
    "LinearPredicate",
    "Predicate",
    "Region",
    "Scenario",
    "ScenarioError",
    "TimedPredicate",
    "shipped",
]
