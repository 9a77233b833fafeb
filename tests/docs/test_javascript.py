"""The block of JavaScript on the wire page, run by node on a tube with numbers that 53 bits do not hold."""

import json
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest

from tests.docs.test_docs import DOCS, blocks
from tests.fleet_bus.messages.examples import a_tube

NODE = shutil.which("node") or shutil.which("nodejs")
(BLOCK,) = blocks(DOCS / "reference" / "wire.md", "js")

#: As much of msgpack as a tube needs, with the option that the page asks for.
DECODER = r"""
function decode(payload, options = {}) {
  const view = new DataView(payload.buffer, payload.byteOffset, payload.byteLength);
  let at = 0;
  const take = (n) => { at += n; return at - n; };
  const whole = (big) => options.useBigInt64 ? big : Number(big);
  const many = (n, each) => Array.from({length: n}, each);
  const text = (n) => new TextDecoder().decode(payload.subarray(take(n), at));
  const map = (n) => Object.fromEntries(many(n, () => [one(), one()]));
  const one = () => {
    const head = view.getUint8(take(1));
    if (head < 0x80) return head;
    if (head < 0x90) return map(head & 15);
    if (head < 0xa0) return many(head & 15, one);
    if (head < 0xc0) return text(head & 31);
    if (head >= 0xe0) return head - 256;
    switch (head) {
      case 0xc4: { const n = view.getUint8(take(1)); return payload.subarray(take(n), at); }
      case 0xc5: { const n = view.getUint16(take(2)); return payload.subarray(take(n), at); }
      case 0xcb: return view.getFloat64(take(8));
      case 0xcc: return view.getUint8(take(1));
      case 0xcd: return view.getUint16(take(2));
      case 0xce: return view.getUint32(take(4));
      case 0xcf: return whole(view.getBigUint64(take(8)));
      case 0xd3: return whole(view.getBigInt64(take(8)));
      case 0xd9: return text(view.getUint8(take(1)));
      case 0xdc: return many(view.getUint16(take(2)), one);
      case 0xde: return map(view.getUint16(take(2)));
      default: throw new Error(`not expected: ${head}`);
    }
  };
  return one();
}
"""
SAYS = r"""
const said = {
  t, epoch, serverEpoch, times, ahead, center, K, first: vertex(0, 0), last: vertex(h - 1, K - 1),
  differ: [1n, 2n, 127n].every((n) => epoch !== epoch + n && Number(epoch) === Number(epoch + n)),
};
console.log(JSON.stringify(said, (_, value) => typeof value === "bigint" ? String(value) : value));
"""


def run(payload: bytes, block: str, at: Path) -> dict[str, Any]:
    """What the block found, with integers of 64 bits as text."""
    assert NODE is not None
    script = at / "tube.js"
    script.write_text(f'{DECODER}\nconst payload = Buffer.from("{payload.hex()}", "hex");\n{block}\n{SAYS}')
    done = subprocess.run([NODE, str(script)], capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
    found: dict[str, Any] = json.loads(done.stdout)
    return found


@pytest.mark.integration
@pytest.mark.skipif(NODE is None, reason="needs node, to run JavaScript")
def test_the_block_reads_a_tube_to_the_last_bit(tmp_path: Path) -> None:
    # A multiple of 256, so that what is less than half of that above it is lost in a double.
    epoch = 1_795_000_000_000_000_000 // 256 * 256
    tube = a_tube(epoch=epoch, server_epoch=epoch + 1)
    found = run(tube.encode(), BLOCK, tmp_path)
    assert [int(found[name]) for name in ("t", "epoch", "serverEpoch")] == [tube.t, epoch, epoch + 1]
    assert [int(time) for time in found["times"]] == tube.times.tolist()
    assert found["ahead"] == [0.05, 0.1, 0.15]
    assert found["center"] == tube.center.ravel().tolist()
    assert found["first"] == (tube.center[0, :2] + tube.outline[0, 0]).tolist()
    assert found["last"] == (tube.center[-1, :2] + tube.outline[-1, -1]).tolist()
    assert found["differ"]
    # Without the option, what the page warns of: the two epochs are one.
    rounded = run(tube.encode(), BLOCK.replace(", {useBigInt64: true}", ""), tmp_path)
    assert rounded["serverEpoch"] == rounded["epoch"]


@pytest.mark.integration
@pytest.mark.skipif(NODE is None, reason="needs node, to run JavaScript")
def test_small_integers_come_as_numbers_and_are_taken(tmp_path: Path) -> None:
    found = run(a_tube(epoch=3, server_epoch=5).encode(), BLOCK, tmp_path)
    assert (found["epoch"], found["serverEpoch"]) == ("3", "5")
