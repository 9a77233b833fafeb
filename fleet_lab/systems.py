"""Systems whose dynamics, noise sets and slopes are known: the ground truth of the containment evidence.

Every bound that a profile states is true here for all states and inputs within their limits; where a set may leave the
region in which data lies the bounds hold there, too. Commands keep the limits and rates of the profile.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from fleet_bus.messages import VehicleProfile, parse_profile
from reach_server.numeric.types import FloatArray
from vehicle_agent.svea import SveaParameters, jacobian_bounds, step
from vehicle_agent.svea import profile as svea_profile

#: Next state (..., n) of states (..., n), inputs by lag (..., lags + 1, m) and process noise (..., n).
Step = Callable[[FloatArray, FloatArray, FloatArray], FloatArray]

DT = 0.05
SVEA = SveaParameters()
WINDOW = 200
#: A set of corners of the noise is drawn this often, else a point of its inside.
CORNERS = 0.6


@dataclass(frozen=True, eq=False)
class System:
    """A known system: its true step, what its profile states, which methods its assumptions cover, and by how much (m)
    inputs may be off the plan that it publishes; no plan is published where that is None."""

    name: str
    step: Step
    profile: VehicleProfile
    methods: tuple[str, ...]
    plan_tolerance: FloatArray | None = None

    @property
    def n(self) -> int:
        """States."""
        return len(self.profile.state)

    @property
    def limits(self) -> FloatArray:
        """Lower and upper limits (2, m) of the inputs."""
        return np.array([spec.limits for spec in self.profile.inputs.values()], dtype=np.float64).T

    @property
    def reach(self) -> FloatArray:
        """How far each input (m) may move in one sample; a command at the very limit must not be beyond it."""
        rates = [np.inf if spec.rate is None else spec.rate for spec in self.profile.inputs.values()]
        return np.array(rates) * self.profile.sample_time * (1 - 1e-9)

    def noise(self, kind: str) -> FloatArray:
        """Generators (n, g) of the ``process`` or ``measurement`` noise."""
        found = getattr(self.profile.noise, kind)
        generators: FloatArray = found.matrix()
        return generators


@dataclass(frozen=True, eq=False)
class Drives:
    """K samples of V vehicles: true and measured states (K, V, n), commands (K, V, m) in force from each on."""

    truth: FloatArray
    measured: FloatArray
    inputs: FloatArray


def members(rng: np.random.Generator, generators: FloatArray, shape: tuple[int, ...]) -> FloatArray:
    """Points (*shape, n) of the zonotope of ``generators`` (n, g) around zero, many of them at its corners."""
    factors = rng.uniform(-1.0, 1.0, (*shape, generators.shape[1]))
    corner = rng.random((*shape, 1)) < CORNERS
    return np.asarray(np.where(corner, np.sign(factors), factors) @ generators.T)


def drive(system: System, vehicles: int, samples: int, rng: np.random.Generator) -> Drives:
    """Vehicles that are driven over all their commands, with noise at the corners of its sets."""
    low, high = system.limits
    lags, m = system.profile.input_lags, len(low)
    truth, inputs = np.zeros((samples, vehicles, system.n)), np.zeros((samples, vehicles, m))
    target = command = np.zeros((vehicles, m))
    held = np.zeros((vehicles, lags + 1, m))
    for k in range(samples):
        anew = rng.random((vehicles, 1)) < 0.15
        target = np.where(anew, rng.uniform(low, high, (vehicles, m)), target)
        command = np.clip(command + np.clip(target - command, -system.reach, system.reach), low, high)
        inputs[k] = command
        held = np.concatenate([command[:, None], held[:, :-1]], axis=1)
        if k + 1 < samples:
            w = members(rng, system.noise("process"), (vehicles,))
            truth[k + 1] = system.step(truth[k], held, w)
    measured = truth + members(rng, system.noise("measurement"), (samples, vehicles))
    angles = system.profile.angles
    measured[..., angles] = (measured[..., angles] + np.pi) % (2 * np.pi) - np.pi
    return Drives(truth, measured, inputs)


def continuations(
    system: System, drives: Drives, k: int, count: int, horizon: int, rng: np.random.Generator
) -> FloatArray:
    """States (V, count, N, n) that the vehicles can be in after 1 to N steps from sample ``k`` as far as anybody knows.

    The state now is any that the measured one allows, the input now is known, later ones are any that the plan or the
    limits and rates allow, the noise is any. A third each: all anew at each step; one noise for good, input hard to one
    side; noise anew, input hard to one side. The first is what really happened.
    """
    vehicles = drives.truth.shape[1]
    lags = system.profile.input_lags
    state = drives.measured[k][:, None] - members(rng, system.noise("measurement"), (vehicles, count))
    if system.profile.filtered:
        # What was measured before excludes some of these states, but never the true one.
        state = np.repeat(drives.truth[k][:, None], count, axis=1)
    held = np.stack([drives.inputs[k - lag] for lag in range(lags + 1)], axis=1)
    held = np.repeat(held[:, None], count, axis=1)
    steady = np.arange(count) % 3 == 1
    constant = members(rng, system.noise("process"), (vehicles, count))
    side = np.sign(rng.uniform(-1, 1, (vehicles, count, held.shape[-1])))
    found = np.zeros((vehicles, count, horizon, system.n))
    for h in range(horizon):
        if h:
            command = _command(system, drives.inputs[k + h], held[..., 0, :], side, rng)
            held = np.concatenate([command[..., None, :], held[..., :-1, :]], axis=-2)
        w = np.where(steady[:, None], constant, members(rng, system.noise("process"), (vehicles, count)))
        state = found[:, :, h] = system.step(state, held, w)
    found[:, 0] = np.swapaxes(drives.truth[k + 1 : k + 1 + horizon], 0, 1)
    return found


def _command(
    system: System, planned: FloatArray, before: FloatArray, side: FloatArray, rng: np.random.Generator
) -> FloatArray:
    """Inputs (V, count, m) one sample after ``before``: around the plan (V, m), or within limits and rates."""
    count = before.shape[1]
    which = np.arange(count)[:, None] % 3
    share = rng.uniform(-1.0, 1.0, before.shape)
    share = np.where(rng.random((*before.shape[:2], 1)) < CORNERS, np.sign(share), share)
    share = np.where(which == 0, share, side)
    low, high = system.limits
    if system.plan_tolerance is not None:
        return np.asarray(np.clip(planned[:, None] + share * system.plan_tolerance, low, high))
    wanted = (low + high) / 2 + share * (high - low) / 2
    reach = system.reach if system.profile.future_inputs == "rate" else np.inf
    return np.asarray(np.clip(np.clip(wanted, before - reach, before + reach), low, high))


def _profile(name: str, states: dict[str, str], **fields: Any) -> VehicleProfile:
    return parse_profile(
        {
            "class": name,
            "state": states,
            "inputs": {"u": {"unit": "m", "limits": [-1.0, 1.0], "rate": 8.0}},
            "sample_time": DT,
            "window": WINDOW,
            "future_inputs": "rate",
            "horizon": 10,
            **fields,
        }
    )


def _stated(process: FloatArray, measurement: FloatArray, lower: FloatArray, upper: FloatArray) -> dict[str, Any]:
    """Noise and slopes as a user states them."""
    return {
        "noise": {
            "process": {"generators": process.tolist(), "origin": "given"},
            "measurement": {"generators": measurement.tolist(), "origin": "given"},
        },
        "lipschitz": {"lower": lower.tolist(), "upper": upper.tolist(), "origin": "given"},
    }


GUARANTEED = ("set_membership", "residual_hull", "paper")


def _linear_step(A: FloatArray, B: FloatArray) -> Step:
    """``x+ = A x + Σ_lag B_lag u_(k-lag) + w`` with B (lags + 1, n, m)."""

    def step_of(x: FloatArray, u: FloatArray, w: FloatArray) -> FloatArray:
        return np.asarray(x @ A.T + np.einsum("...lm,lnm->...n", u, B) + w)

    return step_of


def _around(A: FloatArray, B: FloatArray, spread: float) -> tuple[FloatArray, FloatArray]:
    """Bounds of the slopes of a linear step that are known no better than to ± ``spread``."""
    middle = np.concatenate([A, *B], axis=1)
    return middle - spread, middle + spread


def linear() -> System:
    """Three states, box noise, inputs limited in rate."""
    A = np.array([[0.95, 0.15, 0.0], [-0.15, 0.9, 0.1], [0.0, 0.0, 0.7]])
    B = np.array([[[0.0], [0.1], [0.3]]])
    stated = _stated(0.01 * np.eye(3), 0.003 * np.eye(3), *_around(A, B, 0.01))
    return System(
        "linear", _linear_step(A, B), _profile("linear", {"a": "m", "b": "m", "c": "m"}, **stated), (*GUARANTEED, "lti")
    )


def delayed() -> System:
    """Two states, an input that acts two and three samples late, slanted measurement noise."""
    A = np.array([[0.97, 0.1], [-0.1, 0.92]])
    B = np.array([[[0.0], [0.0]], [[0.0], [0.0]], [[0.05], [0.12]], [[-0.02], [0.06]]])
    measurement = np.array([[0.004, 0.002], [0.004, -0.001]])
    stated = _stated(np.diag([0.008, 0.012]), measurement, *_around(A, B, 0.01))
    profile = _profile("delayed", {"a": "m", "b": "m"}, input_lags=3, **stated)
    return System("delay", _linear_step(A, B), profile, (*GUARANTEED, "lti"))


def correlated() -> System:
    """The noise of the paper's experiments, each one diagonal segment; a plan with a tolerance."""
    A, B = 0.97 * np.eye(2), np.array([0.4 * np.eye(2)])
    stated = _stated(np.array([[0.9], [0.9]]), np.array([[0.01], [0.01]]), *_around(A, B, 0.01))
    inputs = {name: {"unit": "m/s", "limits": [-2.0, 2.0], "rate": 40.0} for name in ("u1", "u2")}
    profile = _profile("correlated", {"a": "m", "b": "m"}, inputs=inputs, future_inputs="plan", **stated)
    return System(
        "correlated noise", _linear_step(A, B), profile, (*GUARANTEED, "lti"), plan_tolerance=np.array([0.3, 0.2])
    )


def stiff() -> System:
    """A slow state and a fast one that jumps after it, counted in a unit a thousand times smaller.

    a+ = 0.98 a - 0.02 b + 0.01 u, b+ = 0.02 b + 0.8 a + 0.1 tanh(2 (a - b)) + 0.2 u; |tanh'| <= 1.
    """

    def step_of(x: FloatArray, u: FloatArray, w: FloatArray) -> FloatArray:
        a, b, force = x[..., 0], x[..., 1] / 1000, u[..., 0, 0]
        slow = 0.98 * a - 0.02 * b + 0.01 * force
        fast = 0.02 * b + 0.8 * a + 0.1 * np.tanh(2 * (a - b)) + 0.2 * force
        return np.asarray(np.stack([slow, 1000 * fast], axis=-1) + w)

    lower = np.array([[0.98, -2e-5, 0.01], [800.0, -0.18, 200.0]]) - 1e-9
    upper = np.array([[0.98, -2e-5, 0.01], [1000.0, 0.02, 200.0]]) + 1e-9
    stated = _stated(np.diag([0.002, 10.0]), np.diag([0.001, 3.0]), lower, upper)
    profile = _profile("stiff", {"a": "m", "b": "mm"}, **{**stated, "future_inputs": "limits"})
    return System("stiff", step_of, profile, GUARANTEED)


def kinked() -> System:
    """Two kinks: the function of the counterexample to the printed algorithm, flatter, and |a|."""

    def step_of(x: FloatArray, u: FloatArray, w: FloatArray) -> FloatArray:
        a, b = x[..., 0], x[..., 1]
        after = 0.4 * np.where(a <= 1.0, a, 3.0 - 2.0 * a) + 0.9 * u[..., 0, 0]
        return np.asarray(np.stack([after, 0.5 * b + 0.5 * np.abs(a)], axis=-1) + w)

    lower = np.array([[-0.8, 0.0, 0.9], [-0.5, 0.5, 0.0]]) - 1e-9
    upper = np.array([[0.4, 0.0, 0.9], [0.5, 0.5, 0.0]]) + 1e-9
    stated = _stated(np.diag([0.02, 0.01]), np.diag([0.005, 0.005]), lower, upper)
    profile = _profile("kinked", {"a": "m", "b": "m"}, **{**stated, "future_inputs": "plan"})
    return System("kink", step_of, profile, GUARANTEED, plan_tolerance=np.array([0.02]))


def _car(x: FloatArray, u: FloatArray, w: FloatArray) -> FloatArray:
    """The simulated SVEA, noise in its own frame."""
    return step(SVEA, x, u[..., SVEA.steering_delay, 0], u[..., 0, 1], w)


def bicycle_body() -> System:
    """The simulated SVEA in its own frame: a kinematic bicycle, steering two samples late, a plan with a tolerance."""
    own = svea_profile(SVEA)
    profile = own.model_copy(update={"window": WINDOW})
    return System(
        "bicycle, body frame", _car, profile, ("set_membership", "residual_hull"), plan_tolerance=np.array([0.05, 0.1])
    )


def bicycle_world() -> System:
    """The same car as a user sees it who names no roles: slopes of the world-frame step, noise in the world frame.

    p+ = p + R(θ) d, so |∂p+/∂θ| = |d| <= the longest arc, and the other columns of d turn: at most the length of both
    components of the body frame.
    """

    def step_of(x: FloatArray, u: FloatArray, w: FloatArray) -> FloatArray:
        return np.asarray(_car(x, u, np.zeros_like(w)) + w)

    body_lower, body_upper = jacobian_bounds(SVEA)
    largest = np.maximum(np.abs(body_lower), np.abs(body_upper))
    turned = np.hypot(largest[0], largest[1])
    longest = SVEA.dt * 2.0
    lower, upper = np.zeros((4, 3 + len(turned))), np.zeros((4, 3 + len(turned)))
    lower[2:, 3:], upper[2:, 3:] = body_lower[2:], body_upper[2:]
    lower[:2, 3:], upper[:2, 3:] = -turned, turned
    lower[:2, 2], upper[:2, 2] = -longest, longest
    for bound in (lower, upper):
        bound[range(4), range(4)] += 1.0
    own = svea_profile(SVEA).model_dump(by_alias=True, exclude_none=True)
    stated = {"lower": lower.tolist(), "upper": upper.tolist(), "origin": "given"}
    profile = parse_profile(
        {**own, "class": "world", "frame": "world", "roles": {}, "lipschitz": stated, "window": WINDOW}
    )
    return System("bicycle, world frame", step_of, profile, GUARANTEED, plan_tolerance=np.array([0.05, 0.1]))


def systems() -> tuple[System, ...]:
    """All of them."""
    return linear(), bicycle_body(), bicycle_world(), stiff(), delayed(), correlated(), kinked()
