"""Write ``reach_server/service/kernels.json`` anew: run each method, look which kernels it called, and time them."""

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from numba.core import event

from reach_server.service import warm_up
from reach_server.service.kernel_list import FILE, Kernel, called
from reach_server.sets import support

ROOT = Path(__file__).resolve().parents[1]


class Times(event.Listener):
    """How long kernels took to compile, all that they call included (s), by name."""

    def __init__(self) -> None:
        self.began: list[float] = []
        self.seconds: dict[str, float] = {}

    def on_start(self, event: event.Event) -> None:
        self.began.append(time.process_time())

    def on_end(self, event: event.Event) -> None:
        function = event.data["dispatcher"].py_func
        name = f"{function.__module__}:{function.__name__}"
        self.seconds[name] = self.seconds.get(name, 0.0) + time.process_time() - self.began.pop()


def child(*words: str, **more: str) -> object:
    """What this file prints as JSON in a process of its own."""
    done = subprocess.run(
        [sys.executable, __file__, *words], env={**os.environ, **more}, stdout=subprocess.PIPE, check=True, text=True
    )
    return json.loads(done.stdout)


def main() -> int:
    """Write the list, or as a child print what one method calls, or how long kernels take."""
    if sys.argv[1:2] == ["time"]:
        times = Times()
        event.register("numba:compile", times)
        warm_up.run(warm_up.METHODS)
        support.warm_up()
        print(json.dumps(times.seconds))
        return 0
    if sys.argv[1:]:
        if sys.argv[1:] == [warm_up.CONSTRAINED]:
            support.warm_up()
        else:
            warm_up.run(sys.argv[1:])
        print(json.dumps(sorted(called())))
        return 0
    with tempfile.TemporaryDirectory() as folder:
        seconds = child("time", FLEET_KERNEL_CACHE=folder)
        assert isinstance(seconds, dict)
        methods: dict[str, set[Kernel]] = {}
        for method in (*warm_up.METHODS, warm_up.CONSTRAINED):
            # What is compiled in a process brings in what it calls: only the second run shows what is called from here.
            for _ in range(2):
                rows = child(method, FLEET_KERNEL_CACHE=folder)
                assert isinstance(rows, list)
                methods[method] = {Kernel(*row) for row in rows}
    kernels = sorted(set().union(*methods.values()), key=lambda kernel: (-seconds.get(kernel.name, 0.0), kernel))
    lines = [
        json.dumps(
            {"kernel": k.name, "methods": [m for m, own in methods.items() if k in own], "types": json.loads(k.types)}
        )
        for k in kernels
    ]
    path = ROOT / "reach_server" / "service" / FILE
    path.write_text("[\n" + ",\n".join(lines) + "\n]\n", encoding="utf-8")
    print(f"{len(kernels)} kernels listed in {path}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
