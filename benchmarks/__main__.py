"""Run benchmarks; print a report as Markdown.

Both sides of every comparison run here, one after the other, on the same sets. Peers run at their documented defaults,
and at a tight tolerance where that matters.
"""

import argparse
import json
import os
import sys
from importlib import import_module
from pathlib import Path

NAMES = (
    "updates",
    "curves",
    "wire",
    "support",
    "outline",
    "strips",
    "constraints",
    "vehicles",
    "growth",
    "progression",
    "containment",
    "encodings",
    "disc",
)


def main(words: list[str] | None = None) -> int:
    """Entry point."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"which ones, default all: {', '.join(NAMES)}")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all figures here")
    parser.add_argument("--plots", type=Path, metavar="DIR", help="draw how cost grows into this folder (PNG)")
    parser.add_argument("--quick", action="store_true", help="few sets and repeats: does it run?")
    arguments = parser.parse_args(words)
    unknown = [name for name in arguments.names if name not in NAMES]
    if unknown:
        parser.error(f"no benchmark {', '.join(unknown)}; there are {', '.join(NAMES)}")

    # One thread for every side, said before NumPy is loaded.
    for variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "NUMBA_NUM_THREADS"):
        os.environ.setdefault(variable, "1")
    from benchmarks.report import as_json, as_markdown, conditions

    modules = {name: import_module(f"benchmarks.{name}") for name in arguments.names or NAMES}
    tables = {}
    for name, module in modules.items():
        print(f"running {name} …", file=sys.stderr)
        tables[name] = module.run(arguments.quick)
    where = conditions()
    print(as_markdown(where, tables), end="")
    if arguments.json is not None:
        arguments.json.parent.mkdir(parents=True, exist_ok=True)
        arguments.json.write_text(json.dumps(as_json(where, tables), indent=2) + "\n", encoding="utf-8")
    for name, table in tables.items() if arguments.plots is not None else ():
        if hasattr(modules[name], "plot"):
            print(f"drawn: {modules[name].plot(table, arguments.plots)}", file=sys.stderr)
    return 0


if __name__ == "__main__":
    sys.exit(main())
