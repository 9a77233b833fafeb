#!/usr/bin/env bash
# Library: foxglove-sdk 0.30.3 (Python).
# Expected: a channel that the program holds, and a server that was started with the same context, live as long as the
#   program holds the two: `Channel(..., context=context)` and `start_server(context=context)` take the context.
# Happens: neither keeps it. Once the last reference to the context is gone, all channels are closed, and the running
#   server announces nothing: a client gets `serverInfo` and no `advertise`. `log` says so once, as a warning of the
#   logger, and raises nothing. The documentation of `Context`, `Channel` and `start_server` says nothing of it.
# Matters: a function that makes a context, a channel and a server, and returns the latter two, as one would write it,
#   gives a server that serves nothing, without an error.
set -euo pipefail
tmp=$(mktemp -d)
trap 'rm -rf "$tmp"' EXIT
python3 -m venv "$tmp/venv"
"$tmp/venv/bin/pip" install --quiet --quiet --no-compile --disable-pip-version-check \
    foxglove-sdk==0.30.3 websockets==17.4
"$tmp/venv/bin/python" - <<'PYTHON'
import gc
import json
import sys
from importlib.metadata import version

import foxglove
from websockets.sync.client import connect


def begin(port=0):
    context = foxglove.Context()
    channel = foxglove.Channel("/topic", message_encoding="json", context=context)
    server = foxglove.start_server(port=port, context=context)
    return context, channel, server


def announced(port: int) -> list[str]:
    """Topics that a client is told of at once, or within three seconds."""
    with connect(f"ws://127.0.0.1:{port}", subprotocols=["foxglove.sdk.v1"]) as client:
        try:
            while True:
                told = json.loads(client.recv(timeout=3))
                if told["op"] == "advertise":
                    return [found["topic"] for found in told["channels"]]
        except TimeoutError:
            return []


print("foxglove-sdk", version("foxglove-sdk"))
context, channel, server = begin()
held = announced(server.port)
print("context held:   ", held)
server.stop()

_, channel, server = begin()
_ = None
gc.collect()
dropped = announced(server.port)
print("context dropped:", dropped)
channel.log({"x": 1})
print("log on the channel raises nothing")
server.stop()
if held != ["/topic"]:
    sys.exit("no channel is announced at all: nothing can be said")
if dropped:
    sys.exit("changed: a channel outlives its context")
PYTHON
