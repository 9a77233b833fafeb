"""Tubes of a batch of vehicles from what is known of them: predicted, cut by side information, labelled."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fleet_bus.messages import EventKind, VehicleProfile
from fleet_bus.messages.methods import FROM_LIMITS
from reach_server.audit.coverage import CoverageRecord
from reach_server.audit.labels import Labels
from reach_server.data.events import EngineEvent
from reach_server.engine.results import Tubes
from reach_server.methods import Forecast, Method
from reach_server.methods.request import Prior, TubeRequest
from reach_server.models.kinematic_bounds import limit_sets
from reach_server.numeric.checks import stack_columns
from reach_server.numeric.slot_table import take_rows
from reach_server.predicates.cut_kinds import CUT_KINDS
from reach_server.sets.polygon import outer_polygon
from reach_server.sets.raw import RawSets
from reach_server.side_information.scenarios import Assignments, InitialConditions
from reach_server.tube.branching_reach import branching
from reach_server.tube.cut_schedule import CutSchedule, CutScheduler
from reach_server.tube.reach_sets import ReachSets
from reach_server.tube.state_bounds import within
from reach_server.tube.unbranched import box_tubes


class TubeBuilder:
    """Builds the tubes of one class out of the parts that its ``Engine`` keeps.

    Args:
        profile: the class.
        horizon: number of steps N.
        method_name: what ``Tubes.methods`` says.
        method: the model of the class.
        names: ids by slot, as the engine goes on to change them.
        assignments: which scenarios cut which vehicle.
        labels: what may be claimed.
        record: one-step predictions, and what became of them; told of those that are made here.
    """

    def __init__(
        self,
        profile: VehicleProfile,
        horizon: int,
        method_name: str,
        method: Method,
        *,
        names: Sequence[str],
        assignments: Assignments,
        labels: Labels,
        record: CoverageRecord,
    ) -> None:
        self._profile = profile
        self._horizon = horizon
        self._method_name = method_name
        self._method = method
        self._names = names
        self._assignments = assignments
        self._labels = labels
        self._record = record
        self._scheduler = self._new_scheduler()
        #: Vehicles of which the data has excluded fitted bounds at some time.
        self._excluded: set[int] = set()

    def forget(self, slot: int) -> None:
        """Forget what the data of a vehicle has excluded."""
        self._excluded.discard(slot)

    def tubes(self, served: TubeRequest, events: list[EngineEvent], waiting: dict[str, str]) -> Tubes:
        """Tubes of the vehicles that are served; what these contradict is added to ``events``, and vehicles whose sets
        are not finite to ``waiting`` instead."""
        if self._profile.filtered and not self._method.claims_measured:
            rows, sets = self._record.predictions.prior(served.slots, served.epoch, served.seq)
            kept = ~self._record.refuted[served.slots[rows]]
            served = replace(served, prior=Prior(rows[kept], take_rows(sets, kept)))
        forecast = self._method.forecast(served)
        instants = self._instants(served, forecast)
        # Sets that outgrow all numbers are found out where they are complete, and are not published.
        with np.errstate(over="ignore", invalid="ignore"):
            reach = self._reach(served, forecast, instants)
            unseen, held = forecast.outlook.unseen, forecast.outlook.held
            if forecast.outlook.low is not None and forecast.outlook.high is not None:
                reach, cut = within(
                    reach, forecast.outlook.low, forecast.outlook.high, self._profile.position,
                    np.flatnonzero(self._profile.angles).tolist(),
                )  # fmt: skip
                held[:, 0] |= cut
            publishable = reach.publishable()
        if not publishable.all():
            for slot in served.slots[~publishable].tolist():
                waiting[self._names[slot]] = "the sets grow beyond all numbers within the horizon: shorten it"
            rows = np.flatnonzero(publishable)
            served, reach, instants = served.rows(rows), reach.rows(rows), take_rows(instants, rows)
            unseen, held = unseen[rows], held[rows]
        events += self._contradictions(served, reach)
        times = self._times(served)
        unclaimed = self._labels.unclaimed(np.asarray(unseen.any(axis=1)))
        self._record.predictions.keep(
            served.slots, served.epoch, served.seq, times[:, 0], reach.steps[0], reach.free[0]
        )
        # What claims nothing is not held against a confidence.
        self._record.predictions.withhold(served.slots[unclaimed])
        slots = served.slots.tolist()
        deficient = self._method.rank_deficient(served.slots)
        against = np.isin(served.slots, sorted(self._assignments.contradicted()))
        wrong = self._record.refuted[served.slots] | reach.excluded | self._record.restless(served.slots)
        if self._labels.audited:
            wrong = wrong | self._record.outside[served.slots]
        return Tubes(
            vehicles=tuple(self._names[slot] for slot in slots),
            epoch=served.epoch,
            seq=served.seq,
            t=served.t,
            times=times,
            steps=reach.steps,
            free=reach.free,
            area=reach.area,
            area_free=reach.area_free,
            outline=outer_polygon(reach.heights),
            hull=reach.hull,
            labels=self._labels.of(wrong, unclaimed),
            methods=(self._method_name,) * len(slots),
            cuts=self._assignments.describe(reach.active),
            notes=self._labels.notes(deficient, against, reach.emptied, unseen, held),
            verdicts=self._verdicts(instants, reach.steps),
            events=(),
            waiting={},
        )

    def _times(self, served: TubeRequest) -> NDArray[np.int64]:
        steps = np.arange(1, self._horizon + 1)
        return np.asarray(served.t[:, None] + steps * self._profile.sample_time_ns)

    def _instants(self, served: TubeRequest, forecast: Forecast) -> InitialConditions:
        # Where true states start is known; measured ones are off by the noise.
        spread = self._method.bounds.measurement if self._method.claims_measured else forecast.start.generators
        center, half = forecast.start.center, np.abs(spread).sum(axis=-1)
        return InitialConditions(served.slots, served.t, center - half, center + half)

    def _reach(self, served: TubeRequest, forecast: Forecast, instants: InitialConditions) -> ReachSets:
        """Sets of the vehicles that are served: of the unbranched ones all at once, of the others step by step."""
        row, obligation, tested = self._assignments.obligations(served.slots)
        count = len(served.slots)
        if self._scheduler.table is not self._assignments.table:
            self._scheduler = self._new_scheduler()
        if CUT_KINDS[self._profile.cuts].adds_constraints:
            plan = CutSchedule.nothing(count, self._horizon, len(self._profile.state))
            plan.unbranched[row] = False
        else:
            plan = self._scheduler.of(row, obligation, tested, self._horizon, *(forecast.ahead() or (None, None)))
        parts: list[ReachSets] = []
        stepwise = ~plan.unbranched
        straight = np.flatnonzero(plan.unbranched)
        if len(straight):
            tubes = forecast.unbranched(straight, plan.rows(straight))
            if tubes is None:
                stepwise[:] = True
            else:
                # Who is to blame for a set of which cuts left nothing is found out step by step.
                stepwise[straight[tubes.ended >= 0]] = True
                found = ReachSets.of(tubes, plan, self._assignments.literals.count)
                kept = np.flatnonzero(~stepwise[straight])
                parts.append(found if len(kept) == len(straight) else found.rows(kept))
        others = np.flatnonzero(stepwise)
        if len(others):
            chosen = stepwise[row]
            asked = row[chosen], obligation[chosen], tested
            parts.append(
                branching(forecast.motion, forecast.start, others, asked, instants, self._assignments, self._profile)
            )
        order = np.argsort(np.concatenate([np.flatnonzero(~stepwise), others]), kind="stable")
        return ReachSets.together(parts, order)

    def _new_scheduler(self) -> CutScheduler:
        side = self._assignments
        return CutScheduler(side.table, side.literals, len(self._profile.state), side.plane)

    def tubes_from_limits(self, limited: TubeRequest, waiting: dict[str, str]) -> Tubes:
        """Tubes of vehicles without a model, from what the profile says of every vehicle: outer; none where it says too
        little. Those that get one leave ``waiting``."""
        x = limited.block.x[:, -1]
        boxes = limit_sets(self._profile, x, self._horizon)
        count, n = x.shape
        if boxes is None:
            return self.no_tubes(waiting)
        plan = CutSchedule.nothing(count, self._horizon, n)
        start = np.broadcast_to(self._method.bounds.measurement, (count, *self._method.bounds.measurement.shape))
        reach = ReachSets.of(
            box_tubes(*boxes, x, start, plan, self._profile.position, "zonotope"),
            plan,
            self._assignments.literals.count,
        )
        names = [self._names[slot] for slot in limited.slots.tolist()]
        bounded = np.flatnonzero(reach.publishable())
        reach, limited = reach.rows(bounded), limited.rows(bounded)
        names = [names[row] for row in bounded.tolist()]
        notes = tuple((f"from limits alone, {waiting[name]}",) for name in names)
        for name in names:
            waiting.pop(name)
        instants = InitialConditions(limited.slots, limited.t, x[bounded], x[bounded])
        return Tubes(
            vehicles=tuple(names),
            epoch=limited.epoch,
            seq=limited.seq,
            t=limited.t,
            times=self._times(limited),
            steps=reach.steps,
            free=reach.free,
            area=reach.area,
            area_free=reach.area_free,
            outline=outer_polygon(reach.heights),
            hull=reach.hull,
            labels=self._labels.of_limits(len(names)),
            methods=(FROM_LIMITS,) * len(names),
            cuts=((),) * len(names),
            notes=notes,
            verdicts=self._verdicts(instants, reach.steps, true_sets=True),
            events=(),
            waiting={},
        )

    def _verdicts(
        self, instants: InitialConditions, steps: tuple[RawSets, ...], *, true_sets: bool = False
    ) -> tuple[Mapping[str, str], ...]:
        """What the requirements come to on the sets, enlarged to hold true states where they speak about measured
        ones."""
        measured = self._method.claims_measured and not true_sets
        noise = self._method.bounds.measurement if measured else np.zeros((len(self._profile.state), 0))
        if not self._assignments.requires:
            return ({},) * len(instants.slots)
        return self._assignments.verdicts(instants, [(s.center, stack_columns(s.generators, noise)) for s in steps])

    def no_tubes(self, waiting: dict[str, str]) -> Tubes:
        """What a batch comes to in which no vehicle gets a tube, and why."""
        ids, times = np.zeros(0, dtype=np.uint64), np.zeros((0, self._horizon), dtype=np.int64)
        areas, bounds = np.zeros((0, self._horizon)), np.zeros((0, self._horizon, 2, len(self._profile.state)))
        return Tubes(
            vehicles=(),
            epoch=ids,
            seq=ids,
            t=times[:, 0],
            times=times,
            steps=(),
            free=(),
            area=areas,
            area_free=areas,
            outline=bounds,
            hull=bounds,
            labels=(),
            methods=(),
            cuts=(),
            notes=(),
            verdicts=(),
            events=(),
            waiting=waiting,
        )

    def _contradictions(self, served: TubeRequest, reach: ReachSets) -> list[EngineEvent]:
        """Events where cuts left nothing, and where the data excludes the stated bounds."""
        events: list[EngineEvent] = []
        # A calibrated set may be wrong itself: only what was measured contradicts for good.
        for row, (step, literals) in {} if self._method.claims_measured else reach.responsible.items():
            slot, ahead = int(served.slots[row]), step * self._profile.sample_time_ns
            events += self._assignments.contradict(slot, self._names[slot], int(served.t[row]), literals, ahead)
        for row in np.flatnonzero(reach.excluded).tolist():
            slot = int(served.slots[row])
            # A bound that is stated is wrong, if only for a time; one that was fitted is a hypothesis that fails here.
            news = self._record.refute(slot) if self._labels.certain else slot not in self._excluded
            if not self._labels.certain:
                self._excluded.add(slot)
            if news:
                message = "the data contradicts the stated noise or Lipschitz bounds: widen them in the profile"
                vehicle, t = self._names[slot], int(served.t[row])
                events.append(EngineEvent(EventKind.DATA_CONTRADICTED, vehicle, t, message))
        return events
