"""The page beside the demo, which goes on without it."""

import threading
from importlib.util import find_spec
from typing import Final

from fleet_bus.errors import FleetError
from fleet_cli.processes import Children

#: Seconds that the page has to answer.
READY_SECONDS: Final = 60.0


def start_page(children: Children, router: str, port: int, stop: threading.Event) -> str:
    """Start the page on ``port``, or the next one that is free, and return a line that says where it is, or why it is
    not."""
    if find_spec("nicegui") is None:
        return "no page: pip install 'fleet-reach[dashboard]'"
    options = ("--port", str(port), "--next-port", "--router", router)
    try:
        return children.start("page", "dashboard", *options).wait_for("page on", READY_SECONDS, stop)
    except FleetError as error:
        return f"no page: {error}"
