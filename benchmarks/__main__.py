"""Run all benchmarks; print Markdown, and JSON to the file given."""

import argparse
import json
import os
import platform
import sys
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(_name, "1")


def main() -> int:
    """Entry point."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("--json", type=Path, help="write all figures here")
    arguments = parser.parse_args()
    import numpy

    from benchmarks import engine, sets, wire

    report: dict[str, Any] = {
        "date": datetime.now(UTC).date().isoformat(),
        "machine": f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}",
        "numpy": numpy.__version__,
    }
    for name, work in (
        ("engine", engine.run), ("supports", sets.supports), ("strips", sets.strips), ("wire", wire.run),
    ):  # fmt: skip
        print(f"running {name} …", file=sys.stderr)
        report[name] = work()
    print(f"# Benchmarks, {report['date']}\n\n{report['machine']}, NumPy {report['numpy']}; medians.\n")
    print("| method | vehicles | µs a vehicle and update |\n| --- | ---: | ---: |")
    for row in report["engine"]:
        print(f"| {row['method']} | {row['vehicles']} | {row['us_a_vehicle']:.0f} |")
    for name in ("supports", "strips", "wire"):
        print(f"\n| {name} | |\n| --- | ---: |")
        for key, value in report[name].items():
            print(f"| {key} | {value:.4g} |")
    if arguments.json is not None:
        arguments.json.write_text(json.dumps(report, indent=2) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
