"""What ``fleet scenario show`` prints."""

import textwrap
from datetime import UTC, datetime
from typing import Final

import numpy as np
from rich.console import Console
from rich.table import Table
from rich.text import Text

from fleet_cli.scenario_activity import Activity, spans
from fleet_cli.scenario_files import Checked, describe, place, predicate_text
from side_info.documents.scenario import Scenario

#: Characters of a predicate that are printed.
_LONGEST: Final = 110

#: Runs of activity that are listed of one predicate.
_MOST_SPANS: Final = 3


def print_scenario(checked: Checked, activity: Activity) -> None:
    """Formulas, predicates with the times at which they are asked for, and what lint found."""
    scenario = checked.scenario
    console = Console(highlight=False)
    facts = Table.grid(padding=(0, 2))
    facts.add_column(style="bold")
    facts.add_column(overflow="fold")
    facts.add_row("scenario", f"{scenario.name} v{scenario.version}")
    facts.add_row("about", Text(describe(scenario)))
    facts.add_row("states", Text(", ".join(f"{name} [{unit}]" for name, unit in scenario.state.items())))
    facts.add_row("time zero", _time_zero(scenario))
    facts.add_row("semantics", scenario.semantics)
    facts.add_row("assume", Text(str(scenario.assume)))
    for name, formula in scenario.monitor.items():
        facts.add_row("monitor", Text(f"{name}: {formula}"))
    console.print(facts)
    table = Table(
        title=f"asked for, s since time zero (a sample each {activity.sample_time:g} s)", title_justify="left"
    )
    table.add_column("predicate", overflow="fold")
    table.add_column("holds where", overflow="fold")
    table.add_column("in any case")
    table.add_column("in some case")
    for p, predicate in enumerate(scenario.predicates):
        if not activity.some[:, p].any():
            continue
        always, some = activity.always[:, p], activity.some[:, p] & ~activity.always[:, p]
        table.add_row(
            Text(predicate.name),
            Text(textwrap.shorten(predicate_text(predicate), _LONGEST, placeholder=" …")),
            _times(always, activity.sample_time),
            _times(some, activity.sample_time),
        )
    console.print(table)
    if activity.cut_short:
        console.print(f"only the first {len(activity.some)} samples were looked at", soft_wrap=True)
    for finding in checked.findings:
        console.print(f"{place(checked, finding)}: warning: {finding.message}", markup=False, soft_wrap=True)


def _time_zero(scenario: Scenario) -> str:
    if scenario.time_zero is None:
        return "each vehicle's own start"
    return datetime.fromtimestamp(scenario.time_zero // 10**9, UTC).isoformat()


def _times(active: np.typing.NDArray[np.bool_], sample_time: float) -> str:
    found = spans(active, sample_time)
    texts = [f"{start:g}" if start == end else f"{start:g}–{end:g}" for start, end in found[:_MOST_SPANS]]
    more = len(found) - len(texts)
    return ", ".join(texts) + (f" and {more} more" if more else "") or "–"
