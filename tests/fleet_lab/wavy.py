"""A recording of a simulated car on a wavy line, whose delay and noise are known."""

from pathlib import Path

import numpy as np

from vehicle_agent.recording import Recording

#: Half-widths of the uniform measurement noise of each state.
NOISE = (0.002, 0.002, 0.002, 0.01)


def wavy(samples: int = 700, *, delay: int = 0, runs: int = 1, dt: float = 0.05, seed: int = 1) -> Recording:
    """States x, y, yaw, v and inputs steering, velocity; the steering acts ``delay`` samples late."""
    rng = np.random.default_rng(seed)
    t = dt * np.arange(samples, dtype=np.float64)
    steering = 0.3 * np.sin(1.7 * t) * np.sin(0.31 * t) + 0.05 * rng.normal(size=samples)
    velocity = 0.8 + 0.2 * np.sin(0.31 * t)
    x = np.zeros((samples, 4))
    for k in range(samples - 1):
        px, py, yaw, v = x[k]
        turned = dt * v * np.tan(steering[max(k - delay, 0)]) / 0.32
        x[k + 1] = [px + dt * v * np.cos(yaw), py + dt * v * np.sin(yaw), yaw + turned, v + 0.3 * (velocity[k] - v)]
    x += rng.uniform(-1, 1, x.shape) * NOISE
    return Recording(
        t, x, np.column_stack([steering, velocity]), np.arange(samples) * runs // samples,
        ("x", "y", "yaw", "v"), ("m", "m", "rad", "m/s"), ("steering", "velocity"), ("rad", "m/s"), "wavy",
    )  # fmt: skip


def write(recording: Recording, path: Path) -> Path:
    """The recording as a file."""
    np.savez(
        path, t=recording.t, x=recording.x, u=recording.u, seg=recording.segment, x_names=recording.state_names,
        x_units=recording.state_units, u_names=recording.input_names, u_units=recording.input_units,
        name=recording.name,
    )  # fmt: skip
    return path
