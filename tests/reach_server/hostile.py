"""Traffic that decodes, and that no sound fleet sends: extreme numbers, in any order, from vehicles of its own."""

import dataclasses
import re
from collections.abc import Callable, Iterator, Mapping
from functools import lru_cache
from typing import Any

import msgpack
import numpy as np

from fleet_bus import keys
from fleet_bus.messages import (
    Assignment,
    ScenarioDocument,
    StateFlag,
    StateSample,
    VehicleProfile,
    parse_profile,
    ranges,
)
from fleet_bus.messages.ranges import Range
from fleet_bus.messages.state import ENCODING
from fleet_bus.pubsub import Received
from reach_server.numeric.types import FloatArray
from side_info import Scenario
from side_info.documents.scenario import shipped
from tests.reach_server.drives import START, SVEA, history

#: Ids that hostile traffic uses: few, so that what one message leaves behind meets the next one. The steady ones mostly
#: send what follows from what they sent before, so that models are made of it.
STEADY = tuple(f"steady{i}" for i in range(8))
WILD = tuple(f"wild{i}" for i in range(4))
VEHICLES = (*STEADY, *WILD)
FORGER = "forger"
METHODS = ("default", "calibrated", "set_membership", "residual_hull", "paper", "lti")
EARLIEST, LATEST = int(ranges.TIME.low), int(ranges.TIME.high)


@lru_cache
def texts() -> dict[str, str]:
    """The documents that ship."""
    return {name: Scenario.load(name).text for name in shipped()}


@dataclasses.dataclass
class Sender:
    """What a hostile vehicle has last said."""

    n: int = 4
    m: int = 2
    sample_time: float = SVEA.dt
    epoch: int = 1
    seq: int = 0
    t: int = START
    place: int = 0
    size: float = 1.0
    shift: float = 0.0


class Hostile:
    """An endless stream of messages that decode, drawn with ``seed``; ``sound`` are the well-behaved, with profiles.

    ``classes`` is the number of other profiles that come; None for a new one each time.
    """

    def __init__(self, seed: int, sound: Mapping[str, VehicleProfile], classes: int | None = None) -> None:
        self._rng = np.random.default_rng(seed)
        self._shared, self._sound = list(sound.values()), list(sound)
        self._pool = [self._odd_profile() for _ in range(classes or 0)]
        self._senders = {vehicle: Sender() for vehicle in VEHICLES}
        kinds: list[tuple[Callable[[], list[Received]], float]] = [
            (self.states, 30), (self.drive, 60), (self.profile, 2), (self.assignment, 5), (self.document, 1),
            (self.token, 2), (self.misplaced, 1), (self.forged, 1),
        ]  # fmt: skip
        self._kinds = [kind for kind, _ in kinds]
        self._weights = np.array([weight for _, weight in kinds]) / sum(weight for _, weight in kinds)

    def __iter__(self) -> Iterator[Received]:
        while True:
            yield from self._kinds[int(self._rng.choice(len(self._kinds), p=self._weights))]()

    # --- numbers ------------------------------------------------------------------------------------------------------
    def _one_of(self, options: Any) -> Any:
        return options[int(self._rng.integers(len(options)))]

    def _chance(self, probability: float) -> bool:
        return bool(self._rng.random() < probability)

    def _whole(self, span: Range, *more: int) -> int:
        low, high = int(span.low), int(span.high)
        ends = [low, low + 1, high - 1, high, *more]
        return int(min(max(int(self._one_of(ends)), low), high))

    def _number(self, span: Range) -> float:
        """A number of a range: an end, of any magnitude in between, or nothing much."""
        low, high = (np.nextafter(span.low, span.high), np.nextafter(span.high, span.low)) if span.between else (
            span.low, span.high,
        )  # fmt: skip
        kind = self._rng.integers(4)
        if kind == 0:
            return float(self._one_of([low, high]))
        if kind == 1:
            return float(np.clip(self._one_of([1.0, -1.0, 1e-300, 5e-324, 0.0]), low, high))
        value = 10.0 ** self._rng.uniform(-12, 30 if kind == 2 else 2) * self._one_of([1.0, -1.0])
        return float(np.clip(value, low, high))

    def _numbers(self, span: Range, *shape: int) -> FloatArray:
        return np.array([self._number(span) for _ in range(int(np.prod(shape)))]).reshape(shape)

    def _session(self, own: str) -> str:
        """The session of a writer, now and then another one."""
        return own if self._chance(0.999) else str(self._one_of(["", "another", "a third"]))

    # --- states -------------------------------------------------------------------------------------------------------
    def states(self) -> list[Received]:
        """One sample, of which anything may be extreme."""
        vehicle = self._one_of(WILD if self._chance(0.9) else STEADY)
        sender, dt = self._senders[vehicle], round(self._senders[vehicle].sample_time * 1e9)
        if self._chance(0.1):
            sender.epoch = self._whole(ranges.EPOCH, sender.epoch + 1, sender.epoch - 1, 1, START)
        if self._chance(0.15):
            sender.seq = self._whole(ranges.SEQ, sender.seq + 5, sender.seq - 3, sender.seq)
        else:
            sender.seq = min(sender.seq + 1, int(ranges.SEQ.high))
        if self._chance(0.15):
            leap = 10 ** int(self._rng.integers(18))
            sender.t = self._whole(ranges.TIME, START, sender.t, sender.t - dt, sender.t + leap)
        else:
            sender.t = min(sender.t + dt, LATEST)
        n, m = sender.n, sender.m
        if self._chance(0.03):
            n, m = int(self._rng.integers(1, 33)), int(self._rng.integers(17))
        x, u = self._numbers(ranges.VALUE, n), self._numbers(ranges.VALUE, m)
        if self._chance(0.5):
            x, u = np.zeros(n) + self._rng.normal(size=n), np.clip(self._rng.normal(size=m), -0.5, 0.5)
        steps = min(self._one_of([0, 0, 1, 9, 40]), (480 - 2 * n - 2 * m) // max(m, 1))
        sample = StateSample(
            sender.epoch, sender.seq, sender.t, x, u, StateFlag(int(self._one_of([0, 0, 0, 1, 2, 8, 11]))),
            self._numbers(ranges.SIZE, n) * self._one_of([0.0, 1.0]) if self._chance(0.2) else None,
            self._numbers(ranges.VALUE, steps, m) if steps and m else None,
            self._numbers(ranges.SIZE, m) if steps and m and self._chance(0.5) else None,
        )  # fmt: skip
        return [self._state(vehicle, sample)]

    def drive(self) -> list[Received]:
        """The next sample of a steady vehicle, now and then a few."""
        return self._further(self._one_of(STEADY), int(self._one_of([1, 1, 1, 3])))

    def _further(self, vehicle: str, count: int) -> list[Received]:
        """Samples that follow those before: a sound drive, in a size of its own, one number of which may be odd."""
        sender, whole, found = self._senders[vehicle], history(1), []
        for _ in range(count):
            sender.seq = min(sender.seq + 1, int(ranges.SEQ.high))
            sender.t = min(sender.t + round(sender.sample_time * 1e9), LATEST)
            k = sender.place = (sender.place + 1) % len(whole.measured)
            x = np.clip(np.resize(whole.measured[k], sender.n) * sender.size + sender.shift, -1e30, 1e30)
            u = np.resize(whole.inputs[k], sender.m)
            if self._chance(0.01):
                x[int(self._rng.integers(sender.n))] = self._number(ranges.VALUE)
            plan = self._numbers(ranges.VALUE, 29, sender.m) if self._chance(0.02) and sender.m else None
            if plan is None and sender.m and self._chance(0.5):
                plan = np.zeros((29, sender.m))
            flags = StateFlag(int(self._one_of([0] * 60 + [1, 2, 8])))
            found.append(self._state(vehicle, StateSample(sender.epoch, sender.seq, sender.t, x, u, flags, plan=plan)))
        return found

    def _state(self, vehicle: str, sample: StateSample) -> Received:
        return Received(keys.state(vehicle), sample.encode(), ENCODING, None, self._session(vehicle))

    # --- rare messages ------------------------------------------------------------------------------------------------
    def profile(self) -> list[Received]:
        """A profile of a hostile vehicle: shared with the well-behaved, or one with numbers at the ends of ranges."""
        vehicle = self._one_of(VEHICLES)
        if self._chance(0.4):
            profile = self._one_of(self._shared)
        else:
            profile = self._one_of(self._pool) if self._pool else self._odd_profile()
        sender = self._senders[vehicle]
        sender.n, sender.m = len(profile.state), len(profile.inputs)
        sender.sample_time = profile.sample_time
        sender.size = float(self._one_of([1.0, 1.0, 1.0, 1e-200, 1e12, 1e29, 0.0]))
        sender.shift = float(self._one_of([0.0, 0.0, 0.0, 1e15]))
        # With what a cache holds, most have a model at once.
        caught_up = self._further(vehicle, int(self._one_of([0, 60, 130])))
        return [
            Received(keys.profile(vehicle), profile.encode(), VehicleProfile.encoding(), None, self._session(vehicle)),
            *caught_up,
        ]

    def _odd_profile(self) -> VehicleProfile:
        n, m = int(self._one_of([1, 2, 3, 4, 6])), int(self._one_of([0, 1, 2]))
        body = n >= 4 and self._chance(0.5)
        state: dict[str, Any] = {f"s{i}": {"unit": "m", "angle": bool(i == 2 and n > 2)} for i in range(n)}
        inputs: dict[str, Any] = {f"u{i}": {"unit": "m"} for i in range(m)}
        for entry in (*state.values(), *inputs.values()):
            if self._chance(0.5) or entry in list(inputs.values()):
                entry["limits"] = sorted(self._numbers(ranges.VALUE, 2).tolist())
                entry["rate"] = self._number(ranges.RATE)
        fields: dict[str, Any] = {
            "class": "odd", "state": state, "inputs": inputs, "sample_time": self._one_of([1e-4, 0.05, 0.05, 60.0]),
            "tolerance": self._number(ranges.TOLERANCE), "window": int(self._one_of([8, 40, 120])),
            "confidence": self._one_of([0.9, 0.99, self._number(ranges.CONFIDENCE)]),
            "input_lags": int(self._one_of([0, 1, 4])), "horizon": int(self._one_of([1, 5, 10, 30])),
            "method": self._one_of(METHODS), "cuts": self._one_of(["zonotope", "constrained", "frobenius"]),
            "future_inputs": self._one_of(["limits", "rate", "plan", "learned"]),
            "reservoir": int(self._one_of([0, 0, 20])), "nearest": int(self._one_of([1, 64])),
            "filtered": self._chance(0.3), "margin": self._one_of(["step", "tube"]),
            "frame": "body" if body else "world", "maps_to": {"x1": "s0", "x2": f"s{min(1, n - 1)}"},
        }  # fmt: skip
        if body:
            fields["roles"] = {"position": ["s0", "s1"], "heading": "s2", "speed": "s3"}
            fields["maps_to"] |= {"yaw": "s2", "v": "s3"}
            state["s2"]["unit"], state["s3"]["unit"] = "rad", "m/s"
        if self._chance(0.8):
            origin, noise = self._one_of(["given", "calibrated"]), {}
            for what in ("process", "measurement"):
                form = self._one_of(["box", "generators", "small"])
                if form == "generators":
                    noise[what] = {"generators": self._numbers(ranges.VALUE, n, int(self._one_of([1, 3, 9]))).tolist()}
                else:
                    size = self._numbers(ranges.SIZE, n) if form == "box" else np.full(n, 0.01)
                    noise[what] = {"box": size.tolist()}
                noise[what]["origin"] = origin
            fields["noise"] = noise
            p = (n - 3 if body else n) + (fields["input_lags"] + 1) * m
            if self._chance(0.7):
                bound = np.abs(self._numbers(ranges.VALUE, n, p))
                small = np.minimum(bound, 2.0)
                bound = bound if self._chance(0.4) else small
                matrix = {"matrix": bound.tolist(), "of": self._one_of(["dynamics", "residual"])}
                pair = {"lower": (-bound).tolist(), "upper": bound.tolist()}
                fields["lipschitz"] = {**self._one_of([matrix, pair]), "origin": origin}
        return parse_profile(fields)

    def assignment(self) -> list[Received]:
        """A hostile vehicle takes part in a scenario, or no longer, from any time on."""
        vehicle = self._one_of(VEHICLES)
        sender = self._senders[vehicle]
        name = self._one_of([*texts(), "never-published"])
        zero = self._whole(ranges.TIME, START, sender.t, sender.t + 10**9, sender.t - 10**9)
        offset = self._one_of([0.0, 0.0, 0.02, 3600.0, 5e-324, 1.0])
        assignment = Assignment(
            scenario=name, vehicle=vehicle, time_zero=zero, active=self._chance(0.8), clock_offset=offset
        )
        return [
            Received(
                keys.assignment(name, vehicle),
                assignment.encode(),
                Assignment.encoding(),
                None,
                self._session("service"),
            )
        ]

    def document(self) -> list[Received]:
        """A document that ships, with another version, a time zero, or a constant that is something else."""
        name = self._one_of(list(texts()))
        text, version = texts()[name], self._whole(ranges.VERSION, 1, 2, 3)
        text = re.sub(r"(?m)^version: \d+", f"version: {version}", text)
        if self._chance(0.3):
            text = text.replace("zero: on_start", f'zero: "{self._one_of(["1970", "2001", "2199"])}-01-02T00:00:00Z"')
        if self._chance(0.3):
            text = re.sub(r"\[0:T\]", f"[0:{self._one_of(['1 ms', '1000000 s', '5 s'])}]", text)
        document = ScenarioDocument(scenario=name, version=version, text=text)
        return [
            Received(
                keys.document(name), document.encode(), ScenarioDocument.encoding(), None, self._session("service")
            )
        ]

    def token(self) -> list[Received]:
        """The liveliness token of a hostile vehicle comes (payload 1) or goes (payload 0)."""
        return [Received(keys.alive(self._one_of(VEHICLES)), b"1" if self._chance(0.5) else b"0", "", None)]

    def misplaced(self) -> list[Received]:
        """A message on a key that it does not belong to, or one that is none."""
        (message, *_) = self._one_of([self.states, self.assignment, self.document])()
        wrong = self._one_of(
            [keys.profile("wild0"), keys.document("convoy"), keys.assignment("box", "wild1"), "fleet/@x/profile"]
        )
        payload = self._one_of([message.payload, b"", msgpack.packb({"v": 2**64 - 1}), b"\xdd\xff\xff\xff\xff"])
        return [Received(wrong, payload, message.encoding, None)]

    def forged(self) -> list[Received]:
        """A profile, a document or an assignment of the well-behaved, from somebody else."""
        kind = int(self._rng.integers(3))
        if kind == 0:
            profile = self._odd_profile()
            key = keys.profile(self._one_of(self._sound))
            return [Received(key, profile.encode(), VehicleProfile.encoding(), None, FORGER)]
        if kind == 1:
            text = re.sub(r"(?m)^scenario: .*", "scenario: box", texts()["parking-lot"])
            version = self._whole(ranges.VERSION, 2, 3)
            text = re.sub(r"(?m)^version: \d+", f"version: {version}", text)
            document = ScenarioDocument(scenario="box", version=version, text=text)
            return [Received(keys.document("box"), document.encode(), ScenarioDocument.encoding(), None, FORGER)]
        vehicle = self._one_of(self._sound)
        assignment = Assignment(
            scenario="box", vehicle=vehicle, time_zero=self._whole(ranges.TIME, START), active=self._chance(0.5)
        )
        return [Received(keys.assignment("box", vehicle), assignment.encode(), Assignment.encoding(), None, FORGER)]
