#!/usr/bin/env bash
# Library: rosbags 0.11.9, `Typestore.serialize_cdr` with NumPy arrays.
# Expected: an array that equals [1, 2, 3] is written as 1, 2, 3 whatever its byte order in memory; or it is
#   refused, as an array of another width is (float64 for a float32[] field raises).
# Happens: `serialize_cdr` copies the bytes as they lie. A '>f4' array, as np.frombuffer gives for a sensor or a
#   file in network order, comes back as 4.6e-41, 9e-44, 2.3e-41: no error, right length, tiny finite numbers.
#   `serialize_ros1` of the same library writes the same array right. The docstring is silent on the byte order of
#   arrays.
# Matters: ranges and covariances next to zero pass every check for NaN and size, and a covariance near zero is the
#   most confident one there is. Convert with `.astype(dtype.newbyteorder("="))` before writing; check a round trip.
set -euo pipefail
tmp=$(mktemp -d)
trap 'rm -rf "$tmp"' EXIT
python3 -m venv "$tmp/venv"
"$tmp/venv/bin/pip" install --quiet --quiet --no-compile --disable-pip-version-check \
    rosbags==0.11.9 numpy==2.4.6
"$tmp/venv/bin/python" - <<'PYTHON'
import struct
import sys
from importlib.metadata import version

import numpy as np
from rosbags.typesys import Stores, get_typestore

TRUE = [1.0, 2.0, 3.0]
store = get_typestore(Stores.ROS2_HUMBLE)
store1 = get_typestore(Stores.ROS1_NOETIC)
NAME = "std_msgs/msg/Float32MultiArray"


def message(types, values: np.ndarray):
    layout = types["std_msgs/msg/MultiArrayLayout"](dim=[], data_offset=0)
    return types[NAME](layout=layout, data=values)


def cdr(values: np.ndarray, little: bool) -> np.ndarray:
    raw = store.serialize_cdr(message(store.types, values), NAME, little_endian=little)
    return store.deserialize_cdr(raw, NAME).data


def ros1(values: np.ndarray) -> np.ndarray:
    return store1.deserialize_ros1(store1.serialize_ros1(message(store1.types, values), NAME), NAME).data


native = np.array(TRUE, np.float32)
network = np.frombuffer(struct.pack(">3f", *TRUE), ">f4")
print("rosbags", version("rosbags"), "numpy", version("numpy"), "arrays equal:", bool(np.array_equal(native, network)))
came = {}
for name, trip in (("CDR little", lambda v: cdr(v, True)), ("CDR big", lambda v: cdr(v, False)), ("ROS 1", ros1)):
    kept, swapped = trip(native), trip(network)
    print(f"{name}: native {kept.tolist()}, '>f4' {[float(f'{x:.3g}') for x in swapped]}")
    if kept.tolist() != TRUE:
        sys.exit("changed: native arrays no longer survive the round trip")
    came[name] = swapped
try:
    cdr(native.astype(np.float64), True)
    sys.exit("changed: an array of the wrong width is no longer refused")
except ValueError as error:
    print("float64 for float32[]:", type(error).__name__)
if came["ROS 1"].tolist() != TRUE:
    sys.exit("changed: the ROS 1 form no longer keeps a big-endian array")
if any((came[name] != native.byteswap()).any() for name in ("CDR little", "CDR big")):
    sys.exit("changed: CDR no longer brings a big-endian array back with its bytes swapped")
PYTHON
