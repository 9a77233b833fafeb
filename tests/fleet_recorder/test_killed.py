"""A recorder that is killed leaves everything but its last open chunk, for the plain library to read."""

import signal
import struct
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest
from mcap.exceptions import EndOfFile
from mcap.reader import NonSeekingReader

from fleet_recorder.reader import Reading
from tests.deploy.test_read_only import namespaces_work
from tests.deploy.units import ROOT
from tests.fleet_recorder.made import state
from tests.waiting import DEADLINE

pytestmark = [pytest.mark.integration, pytest.mark.slow]

SIZE, TIME = 3000, 1 << 20
#: Records samples as fast as it can, and says after every round how many are in the file.
RECORD = """
import sys, threading
from pathlib import Path
from fleet_recorder.files import Folder
from fleet_recorder.parts import Rules
from fleet_recorder.recorder import Recorder
from tests.fleet_recorder.made import state
from tests.memory_bus import Network

network = Network()
rules = Rules(keep_free=0, chunk_bytes=int(sys.argv[2]))
with Folder(Path(sys.argv[1])) as folder, Recorder(folder, rules, network.bus, clock=network.time) as recorder:
    n = 0
    while True:
        for _ in range(int(sys.argv[3])):
            recorder.put(state(n))
            n += 1
        network.time.now += 0.1
        recorder.step()
        print(recorder.summary().recorded, flush=True)
"""
#: Of how many messages the file is to be when the recorder is killed, bytes of a chunk, and samples that come at once:
#: chunks end by size, or by time.
MOMENTS = [
    (1, SIZE, 13), (9, TIME, 1), (40, SIZE, 13), (99, TIME, 40), (260, SIZE, 1), (500, TIME, 40), (777, SIZE, 400),
    (1500, TIME, 400), (2300, SIZE, 13), (4000, TIME, 1000),
]  # fmt: skip


@pytest.mark.parametrize(("count", "chunk", "each"), MOMENTS, ids=str)
def test_everything_but_the_last_open_chunk_reads_back(count: int, chunk: int, each: int, tmp_path: Path) -> None:
    command = [sys.executable, "-c", RECORD, str(tmp_path), str(chunk), str(each)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=ROOT) as process:
        assert process.stdout is not None
        told = 0
        while told < count:
            told = int(process.stdout.readline())
        process.send_signal(signal.SIGKILL)
        # It has gone on until then; what it was saying when it was killed may lack its end.
        *more, _ = process.stdout.read().split("\n")
        told = int(more[-1]) if more else told
        assert process.wait(DEADLINE) == -signal.SIGKILL
    (path,) = tmp_path.iterdir()
    found: list[bytes] = []
    # How the library says that a file ends in the middle of something.
    with path.open("rb") as file, suppress(EndOfFile, struct.error):
        reader = NonSeekingReader(file, validate_crcs=True)
        found.extend(message.data for _, _, message in reader.iter_messages(log_time_order=False))
    assert len(found) >= told
    samples = [payload for payload in found if len(payload) == len(state(0).payload)]
    assert samples == [state(n).payload for n in range(len(samples))]
    # Beside them are tokens, of the recorder.
    assert len(found) - len(samples) <= 2
    reading = Reading(path, warn=bool)
    assert [recorded.received.payload for recorded in reading] == found
    assert reading.cut == [path]


#: Records to a disk of its own that is soon full; then room is made, then it goes on.
FULL = """
import errno, os, sys
from pathlib import Path
from fleet_recorder.files import Folder
from fleet_recorder.parts import Rules
from fleet_recorder.reader import Reading
from fleet_recorder.recorder import Recorder
from fleet_bus.pubsub import Received
from tests.memory_bus import Network

disk = Path(sys.argv[1])
network = Network()
ballast = disk / "ballast"
ballast.write_bytes(bytes(700_000))
rules = Rules(keep_free=0, chunk_bytes=30_000)
with Folder(disk / "recordings") as folder, Recorder(folder, rules, network.bus, clock=network.time) as recorder:
    def come(count):
        for _ in range(count):
            n = recorder.summary().received
            recorder.put(Received("k", b"%8d" % n + os.urandom(3000), "e", None, "s", 10**18 + n))
            network.time.now += 0.1
            recorder.step()
    while recorder.parts.trouble is None:
        come(1)
    print(recorder.parts.trouble)
    come(20)
    before = recorder.summary()
    ballast.unlink()
    network.time.now += 1
    come(5)
    assert recorder.parts.trouble is None, recorder.parts.trouble
    assert recorder.summary().recorded > before.recorded
summary = recorder.summary()
reading = Reading(disk / "recordings")
assert [m.sequence for m in reading] == list(range(summary.received)), summary
assert (summary.lost, reading.missing) == (0, 0), summary
print("all", summary.recorded)
"""


def test_a_real_disk_that_is_full_is_survived(tmp_path: Path) -> None:
    if not namespaces_work():
        pytest.skip("mount namespaces need root and a kernel that allows them")
    mount = 'mount -t tmpfs -o size=1m tmpfs "$1" && exec "$2" -c "$3" "$1"'
    done = subprocess.run(
        ["unshare", "-m", "sh", "-c", mount, "sh", str(tmp_path), sys.executable, FULL],
        capture_output=True, text=True, cwd=ROOT, timeout=DEADLINE, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr + done.stdout
    assert "No space left on device" in done.stdout
    assert "all" in done.stdout
