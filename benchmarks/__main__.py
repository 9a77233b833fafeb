"""``python -m benchmarks`` is ``fleet bench``."""

import runpy
import sys

if __name__ == "__main__":
    sys.argv.insert(1, "bench")
    # By name: what the command imports is below it, not the other way round.
    runpy.run_module("fleet_cli", run_name="__main__")
