#!/usr/bin/env bash
# Library: mcap 1.6.0, `NonSeekingReader(..., validate_crcs=True)` on a whole file of `Writer` with its defaults.
# Expected: chunks have checksums, which are validated, so that a flipped bit among the messages is an error.
# Happens: the checksum of a chunk covers what is in it, not the head of its record. One flipped bit in the opcode
#   makes a record of an unknown kind of it, which is skipped: all messages of the chunk are missing, no error, and
#   the reader does not look at the statistics behind, which count them. The checksum of the whole data section would
#   show it, but the writer leaves that out unless it is told otherwise (`enable_data_crcs=False`).
# Matters: whoever reads a recording in file order, as one must where the summary is lost, takes part of it for all.
#   Write with `enable_data_crcs=True`, or compare the number of messages with the statistics.
set -euo pipefail
tmp=$(mktemp -d)
trap 'rm -rf "$tmp"' EXIT
python3 -m venv "$tmp/venv"
"$tmp/venv/bin/pip" install --quiet --quiet --no-compile --disable-pip-version-check \
    mcap==1.6.0 zstandard==0.25.0 lz4==4.4.5
"$tmp/venv/bin/python" - <<'PYTHON'
import io
import sys
from importlib.metadata import version

from mcap.opcode import Opcode
from mcap.reader import NonSeekingReader
from mcap.stream_reader import CRCValidationError
from mcap.writer import Writer


def write(**more) -> tuple[bytearray, int]:
    """A file of three chunks of ten messages, and where the second one begins."""
    file = io.BytesIO()
    writer = Writer(file, **more)
    writer.start()
    channel = writer.register_channel("/topic", "json", 0)
    places = []
    for chunk in range(3):
        places.append(file.tell())
        for n in range(10):
            writer.add_message(channel, log_time=10 * chunk + n, data=b"{}", publish_time=0)
        writer.flush()
    writer.finish()
    return bytearray(file.getvalue()), places[1]


def read(content: bytes) -> list[int]:
    reader = NonSeekingReader(io.BytesIO(content), validate_crcs=True)
    return [message.log_time for _, _, message in reader.iter_messages(log_time_order=False)]


print("mcap", version("mcap"))
content, place = write()
assert content[place] == Opcode.CHUNK
print("whole:                   ", len(read(content)), "messages")
content[place] ^= 1 << 5
came = read(content)
print("one bit of a head flipped:", len(came), "messages, no error")
if came != [*range(10), *range(20, 30)]:
    sys.exit("changed: a chunk whose head is damaged is no longer skipped in silence")
content, place = write(enable_data_crcs=True)
content[place] ^= 1 << 5
try:
    read(content)
except CRCValidationError as error:
    print("with enable_data_crcs:   ", error)
else:
    sys.exit("changed: the checksum of the data section no longer shows it")
PYTHON
