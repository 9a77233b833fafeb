// Mouse, fingers and keys on the map.

const CLICK = 5; // pixels: a finger is never quite still
const PANS = { ArrowLeft: [40, 0], ArrowRight: [-40, 0], ArrowUp: [0, 40], ArrowDown: [0, -40] };

/** Let `map` (zoom, drag, hover, pick, fit, nearest) hear what is done on an element. */
export function listen(element, map) {
  const pointers = new Map();
  let pressed = null;
  const on = (name, handle) => element.addEventListener(name, handle, { passive: false });
  const at = (event) => {
    const { left, top } = element.getBoundingClientRect();
    return [event.clientX - left, event.clientY - top];
  };
  const far = ([x, y]) => !pressed || Math.hypot(x - pressed[0], y - pressed[1]) >= CLICK;

  on("wheel", (event) => {
    event.preventDefault();
    map.zoom(Math.exp(-0.0015 * event.deltaY), ...at(event));
  });
  on("pointerdown", (event) => {
    element.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, at(event));
    pressed = pointers.size === 1 ? at(event) : null;
  });
  on("pointermove", (event) => {
    const before = pointers.get(event.pointerId), now = at(event);
    if (!before) return map.hover(map.nearest(...now));
    if (pointers.size === 2) {
      const [, other] = [...pointers].find(([id]) => id !== event.pointerId);
      const apart = (point) => Math.max(10, Math.hypot(point[0] - other[0], point[1] - other[1]));
      map.zoom(apart(now) / apart(before), (now[0] + other[0]) / 2, (now[1] + other[1]) / 2);
    } else if (far(now)) {
      pressed = null; // from here on it is no click
      map.drag(now[0] - before[0], now[1] - before[1]);
    } else return;
    pointers.set(event.pointerId, now);
  });
  for (const name of ["pointerup", "pointercancel"]) {
    on(name, (event) => {
      pointers.delete(event.pointerId);
      if (name === "pointerup" && pressed && !far(at(event))) map.pick(map.nearest(...at(event)));
    });
  }
  on("pointerleave", () => map.hover(null));
  on("keydown", (event) => {
    if (event.key === "+" || event.key === "-") map.zoom(event.key === "+" ? 1.3 : 1 / 1.3);
    else if (event.key === "0") map.fit();
    else if (PANS[event.key]) map.drag(...PANS[event.key]);
    else return;
    event.preventDefault();
  });
}
