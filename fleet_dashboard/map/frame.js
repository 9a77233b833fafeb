// Reads a frame as fleet_dashboard/frames.py writes it. Arrays are views of the buffer: nothing is copied.

const MAGIC = 0x314d5246;
const VERSION = 1;

// Marks of fleet_dashboard/picture.py: silent, tube old, server silent; left its scenario, violates a requirement.
export const STALE = 1 | 2 | 4;
export const ASTRAY = 64 | 128;

/** The frame in a buffer, or null if it has another layout than this file knows. */
export function readFrame(buffer) {
  const head = new DataView(buffer);
  if (buffer.byteLength < 64 || head.getUint32(0, true) !== MAGIC || head.getUint32(4, true) !== VERSION) return null;
  const [count, polygons, corners] = [32, 36, 40].map((offset) => head.getUint32(offset, true));
  let at = 64;
  const take = (Type, length) => {
    const array = new Type(buffer, at, length);
    at += 4 * length;
    return array;
  };
  return {
    time: head.getFloat64(8, true),
    origin: [head.getFloat64(16, true), head.getFloat64(24, true)],
    count,
    polygons,
    corners,
    hidden: head.getUint32(44, true),
    past: (head.getUint32(48, true) & 1) !== 0,
    rows: take(Uint32Array, count),
    poses: take(Float32Array, 3 * count),
    figures: take(Float32Array, 4 * count),
    codes: take(Uint32Array, count),
    owners: take(Uint32Array, polygons),
    steps: take(Uint32Array, polygons),
    outline: take(Float32Array, 2 * polygons * corners),
  };
}
