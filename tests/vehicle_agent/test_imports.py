"""The edge stays light: what an agent loads, seen in a process of its own."""

import subprocess
import sys

PROGRAM = """
import sys
import numpy as np
import vehicle_agent.agent
from vehicle_agent.filters import KinematicFilter
tested = KinematicFilter([0.1], 0.05)
for k in range(3):
    tested.update(k * 50_000_000, np.array([0.1 * k]))
print([name for name in ("matplotlib", "casadi", "reach_server", "side_info") if name in sys.modules])
"""


def test_an_agent_loads_neither_matplotlib_nor_casadi() -> None:
    done = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
