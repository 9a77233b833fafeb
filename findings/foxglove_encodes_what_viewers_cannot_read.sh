#!/usr/bin/env bash
# Library: foxglove-sdk 0.30.3 (Python).
# Expected: a typed SDK for a viewer refuses, or repairs, what the viewer cannot use: a number that JSON has no word for,
#   a rotation that is none. And `Timestamp`, which goes out as google.protobuf.Timestamp, takes what that can hold.
# Happens: `Channel.log` of a dict with NaN sends the word NaN, which is no JSON: a strict parser drops the whole message.
#   A `Pose` without orientation, and `Quaternion()`, go out as nothing at all, which reads as 0, 0, 0, 0 (an identity has
#   w = 1). NaN as a coordinate is encoded as it is. `Timestamp` ends in February 2106, with an OverflowError, since
#   its seconds have 32 bits; those of the message on the wire have 64.
# Matters: a plot stops, a set is not drawn or stands somewhere, and nothing says why. Numbers have to be checked before,
#   every orientation to be written out, and a stamp from a broken clock must not end the program.
set -euo pipefail
tmp=$(mktemp -d)
trap 'rm -rf "$tmp"' EXIT
python3 -m venv "$tmp/venv"
"$tmp/venv/bin/pip" install --quiet --quiet --no-compile --disable-pip-version-check \
    foxglove-sdk==0.30.3 websockets==17.4
"$tmp/venv/bin/python" - <<'PYTHON'
import json
import sys
import time
from importlib.metadata import version

import foxglove
from foxglove.messages import Point3, Pose, Quaternion, Timestamp, Vector3
from websockets.sync.client import connect

print("foxglove-sdk", version("foxglove-sdk"))
context = foxglove.Context()
channel = foxglove.Channel("/numbers", message_encoding="json", context=context)
server = foxglove.start_server(port=0, context=context)
with connect(f"ws://127.0.0.1:{server.port}", subprotocols=["foxglove.sdk.v1"]) as client:
    told = {}
    while told.get("op") != "advertise":
        told = json.loads(client.recv(timeout=30))
    number = told["channels"][0]["id"]
    client.send(json.dumps({"op": "subscribe", "subscriptions": [{"id": 1, "channelId": number}]}))
    for _ in range(3000):  # until the server has heard of it
        if channel.has_sinks():
            break
        time.sleep(0.01)
    else:
        sys.exit("the server takes no subscription: nothing can be said")
    channel.log({"x": float("nan")})
    # One byte that says what follows, the subscription, the time.
    sent = client.recv(timeout=30)[1 + 4 + 8 :]
server.stop()
print("a dict with NaN goes out as", sent)

pose = Pose(position=Vector3(x=1.0)).encode()
written = Pose(position=Vector3(x=1.0), orientation=Quaternion(w=1.0)).encode()
print("a pose without orientation: ", pose.hex(), "with one:", written.hex(), "Quaternion():", Quaternion().encode())
point = Point3(x=float("nan")).encode()
print("a point at NaN:             ", point.hex())
Timestamp(2**32 - 1, 0)
try:
    Timestamp(2**32, 0)
    ends = ""
except OverflowError as error:
    ends = str(error)
print("the second after 2**32 - 1: ", ends)
if sent != b'{"x": NaN}':
    sys.exit("changed: NaN no longer goes out in JSON")
if not written.startswith(pose) or Quaternion().encode():
    sys.exit("changed: an orientation that is left out is no longer left out")
if len(point) != 9:
    sys.exit("changed: a coordinate that is NaN is no longer encoded")
if not ends:
    sys.exit("changed: stamps no longer end in February 2106")
PYTHON
