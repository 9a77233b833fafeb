"""From samples to regression data: increments, their frame, lagged inputs, runs of consecutive samples."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fleet_bus.messages import VehicleProfile
from reach_server.data.window import Block
from reach_server.numeric.types import FloatArray


@dataclass(frozen=True, slots=True)
class RegressorSpec:
    """How the state and input of a vehicle class enter a model.

    ``pose`` holds the indices (first position, second position, heading) where increments are expressed in
    the vehicle's own frame, else None; ``free`` the indices of the states that the model depends on; ``plane`` those of
    the coordinates in which areas count, where there are two.
    """

    n: int
    m: int
    lags: int
    pose: tuple[int, int, int] | None
    free: tuple[int, ...]
    angles: tuple[int, ...]
    plane: tuple[int, int] | None = None

    @classmethod
    def of(cls, profile: VehicleProfile, frame: str | None = None) -> "RegressorSpec":
        """Layout of a profile, in its own frame or in the one named."""
        n = len(profile.state)
        pose = None
        if (frame or profile.frame) == "body" and profile.heading is not None:
            pose = (*profile.position, profile.heading)
        free = tuple(i for i in range(n) if pose is None or i not in pose)
        angles = tuple(int(i) for i in np.flatnonzero(profile.angles))
        plane = profile.position if n > 1 else None
        return cls(n, len(profile.inputs), profile.input_lags, pose, free, angles, plane)

    @property
    def regressors(self) -> int:
        """Number p of regressors after the constant."""
        return len(self.free) + (self.lags + 1) * self.m


def wrap(angle: FloatArray) -> FloatArray:
    """Angles turned into [-pi, pi)."""
    return (angle + np.pi) % (2 * np.pi) - np.pi


def rotate(angle: FloatArray, vector: FloatArray) -> FloatArray:
    """Planar vectors (..., 2) turned by angles (...)."""
    c, s = np.cos(angle), np.sin(angle)
    return np.stack([c * vector[..., 0] - s * vector[..., 1], s * vector[..., 0] + c * vector[..., 1]], axis=-1)


def runs(linked: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Number (B, S) of consecutive links that end at each sample: how far back its trajectory is unbroken."""
    index = np.arange(linked.shape[1])
    last_break = np.maximum.accumulate(np.where(linked, 0, index), axis=1)
    return index - last_break


def unwrapped(block: Block, layout: RegressorSpec) -> FloatArray:
    """States (B, S, n) with the angles continued along each trajectory, from the first value on."""
    x = block.x.copy()
    start = runs(block.linked) == 0
    for i in layout.angles:
        steps = np.zeros(x.shape[:2])
        steps[:, 1:] = wrap(np.diff(block.x[..., i], axis=1))
        total = np.cumsum(steps, axis=1)
        first = np.maximum.accumulate(np.where(start, np.arange(x.shape[1]), 0), axis=1)
        x[..., i] = np.take_along_axis(wrap(block.x[..., i]) - total, first, axis=1) + total
    return x


def increments(x: FloatArray, layout: RegressorSpec) -> FloatArray:
    """Change (B, S, n) from each state to the next, last row zero; positions in the frame of the earlier state."""
    d = np.zeros_like(x)
    d[:, :-1] = np.diff(x, axis=1)
    if layout.pose is not None:
        first, second, heading = layout.pose
        d[..., [first, second]] = rotate(-x[..., heading], d[..., [first, second]])
    return d


def lagged_inputs(block: Block, layout: RegressorSpec) -> FloatArray:
    """Inputs (B, S, (lags + 1) m): the one in force from each sample on, then the earlier ones by lag."""
    size = block.u.shape[1]
    columns = []
    for lag in range(layout.lags + 1):
        shifted = np.zeros_like(block.u)
        shifted[:, lag:] = block.u[:, : size - lag]
        columns.append(shifted)
    return np.concatenate(columns, axis=-1)


@dataclass(frozen=True, slots=True, eq=False)
class Transitions:
    """Regressors ``z`` (B, T, p), ``target`` (B, T, n) and which rows are ``usable`` (B, T); ``newest`` state (B, n).

    In the world frame the target is the next state, in the body frame the increment. Angles are continued along
    each trajectory, so ``newest`` says which turn they are in.
    """

    z: FloatArray
    target: FloatArray
    usable: NDArray[np.bool_]
    newest: FloatArray


def transitions(block: Block, layout: RegressorSpec) -> Transitions:
    """Every pair of consecutive samples with its lagged inputs."""
    x = unwrapped(block, layout)
    run = runs(block.linked)
    z = np.concatenate([x[..., layout.free], lagged_inputs(block, layout)], axis=-1)
    if layout.pose is None:
        target = np.zeros_like(x)
        target[:, :-1] = x[:, 1:]
    else:
        target = increments(x, layout)
    usable = np.zeros(block.valid.shape, dtype=bool)
    usable[:, :-1] = block.linked[:, 1:] & inputs_known(block, run, layout)[:, :-1]
    return Transitions(z, target, usable, x[:, -1])


def inputs_known(block: Block, run: NDArray[np.int64], layout: RegressorSpec) -> NDArray[np.bool_]:
    """True (B, S) where the input and all its lags are known and belong to the same trajectory."""
    known = block.valid & (run >= layout.lags)
    for lag in range(layout.lags + 1):
        known[:, lag:] &= block.input_known[:, : known.shape[1] - lag]
        known[:, :lag] = False
    return known
