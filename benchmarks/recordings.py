"""Real cars: how often the sets hold, and how large they are at equal coverage. ``fleet evaluate`` in a table."""

from benchmarks.conditions import ROOT
from benchmarks.report import Cell, Claim, Table
from fleet_lab.evaluation import MethodFigures, Settings, evaluate, plan_trials
from fleet_lab.profile_files import find_profile
from vehicle_agent.recording import load_recording

FOLDER = ROOT / "tests" / "data" / "recordings"
#: Name, file and profile of the recordings that come with the project.
RECORDINGS = (
    ("DART", "fix_dart_free.npz", "dart"),
    ("F1TENTH, Koopman", "fix_f1tenth_koopman.npz", "f1tenth"),
    ("F1TENTH, particle filter", "fix_upenn_pf.npz", "upenn"),
)
METHODS = ("calibrated", "paper")
#: The confidence that the profiles state, %.
WANTED = 99.0


def run(quick: bool) -> Table:
    """Coverage, worst runs, areas at equal coverage and labels, by recording and method."""
    rows: list[tuple[Cell, ...]] = []
    claims: list[Claim] = []
    for name, file, profile_name in RECORDINGS[2:] if quick else RECORDINGS:
        profile = find_profile(profile_name)
        trials = plan_trials([load_recording(FOLDER / file)], profile, test_runs="0" if quick else None)
        figures = evaluate(trials, profile, Settings(METHODS, 2 if quick else None))
        for method in METHODS:
            rows.append((name, method, *_cells(figures[method])))
        least = min(100 * step.inside / step.checked for step in figures["calibrated"].steps)
        claims.append(Claim(f"{name}, calibrated: least share inside at a step, %", least, "≥", WANTED))
    return Table(
        "Real cars",
        "The recordings that come with the project, as `fleet evaluate` takes them: the first part fills the window, "
        "which then rolls on over the rest, each sample predicted before it enters; the later inputs are known. "
        "'Inside': measured states in their sets at the first step, at the last one, and at the worst of all steps; "
        "'worst run': the least share of a run at the last step. Areas, m²: mean of sets scaled about their centres so "
        "that 99 % of the states lie inside; 'published' is the mean of the sets as they are. 'Contradicted': tubes "
        "that were labelled so. The recipe of `calibrated` was tuned on recordings of these cars.",
        (
            "recording", "method", "checked", "inside, first %", "inside, last %", "inside, least %", "worst run %",
            "area at 99 %, first", "area at 99 %, last", "published, last", "contradicted %",
        ),
        rows,
        claims,
        keys=2,
    )  # fmt: skip


def _cells(found: MethodFigures) -> tuple[Cell, ...]:
    shares = [100 * step.inside / step.checked for step in found.steps]
    first, last = found.steps[0], found.steps[-1]
    labels = found.label_counts
    return (
        sum(step.checked for step in found.steps), shares[0], shares[-1], min(shares),
        None if last.worst_run is None else 100 * last.worst_run, first.area_equal, last.area_equal, last.area_mean,
        100 * labels.get("contradicted", 0) / sum(labels.values()),
    )  # fmt: skip
