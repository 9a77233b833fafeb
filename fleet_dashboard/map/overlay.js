// What lies over the sets: grid, scale, regions, vehicles and their names, on a plain canvas.
import { ASTRAY, STALE } from "./frame.js";

const MOST_NAMES = 40;

/** The distance between two lines of the grid: 1, 2 or 5 times a power of ten, at least `pixels` on the screen. */
function gridStep(scale, pixels) {
  const least = pixels / scale;
  const power = 10 ** Math.floor(Math.log10(least));
  return power * [1, 2, 5, 10].find((factor) => factor * power >= least);
}

export function metres(length) {
  if (length >= 1000) return `${length / 1000} km`;
  if (length >= 1) return `${length} m`;
  return length >= 0.01 ? `${Math.round(length * 100)} cm` : `${+(length * 1000).toPrecision(3)} mm`;
}

/** Draw all of it; `shown` says what: frame, ids, regions, active, followed, hovered, colours, theme, names. */
export function drawOverlay(context, view, ratio, shown) {
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, view.width, view.height);
  context.font = "12px Roboto, system-ui, sans-serif";
  drawGrid(context, view, shown.theme);
  for (const region of shown.regions) {
    drawRegion(context, view, region, shown.active.has(`${region.scenario}/${region.name}`), shown.theme);
  }
  if (shown.frame) drawVehicles(context, view, shown);
  drawScale(context, view, shown.theme);
}

function drawGrid(context, view, theme) {
  const step = gridStep(view.scale, 80);
  const [left, bottom, right, top] = view.bounds();
  const digits = Math.max(0, -Math.floor(Math.log10(step)));
  context.lineWidth = 1;
  context.strokeStyle = theme.grid;
  context.fillStyle = theme.faint;
  context.beginPath();
  const texts = [];
  for (let k = Math.ceil(left / step); k * step <= right; k++) {
    const x = Math.round(view.toScreen(k * step, 0)[0]) + 0.5;
    context.moveTo(x, 0);
    context.lineTo(x, view.height);
    texts.push([(k * step).toFixed(digits), x + 3, view.height - 5]);
  }
  for (let k = Math.ceil(bottom / step); k * step <= top; k++) {
    const y = Math.round(view.toScreen(0, k * step)[1]) + 0.5;
    context.moveTo(0, y);
    context.lineTo(view.width, y);
    texts.push([(k * step).toFixed(digits), 4, y - 3]);
  }
  context.stroke();
  context.textAlign = "left";
  for (const [text, x, y] of texts) context.fillText(text, x, y);
}

function drawScale(context, view, theme) {
  const length = gridStep(view.scale, 80), width = length * view.scale;
  const x = view.width - width - 16, y = view.height - 22;
  context.strokeStyle = theme.text;
  context.fillStyle = theme.text;
  context.lineWidth = 2;
  context.beginPath();
  context.moveTo(x, y - 5);
  context.lineTo(x, y);
  context.lineTo(x + width, y);
  context.lineTo(x + width, y - 5);
  context.stroke();
  context.textAlign = "center";
  context.fillText(metres(length), x + width / 2, y - 6);
}

function drawRegion(context, view, region, active, theme) {
  const points = region.segments;
  context.strokeStyle = active ? theme.active : theme.region;
  context.lineWidth = active ? 2.5 : 1.25;
  context.beginPath();
  for (let i = 0; i < points.length; i += 4) {
    context.moveTo(...view.toScreen(points[i], points[i + 1]));
    context.lineTo(...view.toScreen(points[i + 2], points[i + 3]));
  }
  context.stroke();
  const [x, y] = view.toScreen(...region.at);
  context.fillStyle = active ? theme.active : theme.region;
  context.textAlign = "left";
  context.fillText(active ? `${region.name} · cuts now` : region.name, x + 5, y + 15);
}

function drawVehicles(context, view, { frame, ids, followed, hovered, colours, theme, names }) {
  const rgb = (i) => {
    const code = frame.codes[i];
    return `rgb(${((code >> 8) & STALE ? colours[colours.length - 1] : colours[code & 255]).join(",")})`;
  };
  const size = frame.count > 300 ? 4 : 7;
  const texts = [], shapes = new Map(), rings = { chosen: new Path2D(), astray: new Path2D() };
  for (let i = 0; i < frame.count; i++) {
    const [x, y] = view.toScreen(frame.origin[0] + frame.poses[3 * i], frame.origin[1] + frame.poses[3 * i + 1]);
    if (!(x > -20 && y > -20 && x < view.width + 20 && y < view.height + 20)) continue;
    const label = frame.codes[i] & 255, marks = frame.codes[i] >> 8, id = ids[frame.rows[i]];
    const hollow = marks & STALE || label === 2 || label > 3;
    const key = `${rgb(i)} ${hollow ? 1 : 0}`;
    if (!shapes.has(key)) shapes.set(key, { colour: rgb(i), hollow, body: new Path2D(), cross: new Path2D() });
    addVehicle(shapes.get(key), x, y, frame.poses[3 * i + 2], size, label === 3);
    const chosen = id === followed || id === hovered;
    if (chosen || marks & ASTRAY) {
      const ring = marks & ASTRAY ? rings.astray : rings.chosen;
      ring.moveTo(x + size + 8, y);
      ring.arc(x, y, size + 8, 0, 2 * Math.PI);
    }
    const urgent = chosen || marks & ASTRAY || label === 3;
    if (!id || !(urgent || (names && frame.count <= MOST_NAMES))) continue;
    const age = frame.figures[4 * i];
    const why = marks & 64 ? " · left its scenario" : marks & 128 ? " · violates" : "";
    const stale = marks & STALE && isFinite(age) ? ` · stale ${age.toFixed(0)} s` : "";
    texts.push({ text: id + why + stale, x: x + size + (urgent ? 13 : 6), y: y - size, urgent });
  }
  // One path for all that look alike: a call for each vehicle is slow.
  for (const { colour, hollow, body, cross } of shapes.values()) {
    context.lineWidth = 1.5;
    context.fillStyle = hollow ? theme.halo : colour;
    context.fill(body);
    context.strokeStyle = hollow ? colour : theme.halo;
    context.stroke(body);
    context.strokeStyle = colour;
    context.lineWidth = 2;
    context.stroke(cross);
  }
  context.lineWidth = 2;
  context.strokeStyle = theme.text;
  context.stroke(rings.chosen);
  context.strokeStyle = theme.alarm;
  context.stroke(rings.astray);
  drawNames(context, texts, theme);
}

/** Names, what is urgent first; one that would lie over another is left out. */
function drawNames(context, texts, theme) {
  const taken = [];
  texts.sort((a, b) => Boolean(b.urgent) - Boolean(a.urgent));
  context.textAlign = "left";
  context.lineWidth = 3;
  context.strokeStyle = theme.halo;
  context.fillStyle = theme.text;
  for (const { text, x, y } of texts) {
    const right = x + context.measureText(text).width;
    if (taken.some((box) => x < box.right && right > box.x && Math.abs(y - box.y) < 13)) continue;
    taken.push({ x, right, y });
    context.strokeText(text, x, y);
    context.fillText(text, x, y);
  }
}

/** An arrow along the heading, a circle without one. The label shows in the shape as well as in the colour. */
function addVehicle({ body, cross }, x, y, heading, size, crossed) {
  if (isFinite(heading)) {
    // Along the heading and to its left; the second axis of the screen points down.
    const [c, s] = [Math.cos(heading), Math.sin(heading)];
    const at = (along, left) => [x + size * (along * c - left * s), y - size * (along * s + left * c)];
    body.moveTo(...at(1.5, 0));
    body.lineTo(...at(-1, 0.9));
    body.lineTo(...at(-0.5, 0));
    body.lineTo(...at(-1, -0.9));
    body.closePath();
  } else {
    body.moveTo(x + 0.8 * size, y);
    body.arc(x, y, 0.8 * size, 0, 2 * Math.PI);
  }
  if (!crossed) return;
  cross.moveTo(x - 2 * size, y - 2 * size);
  cross.lineTo(x + 2 * size, y + 2 * size);
  cross.moveTo(x - 2 * size, y + 2 * size);
  cross.lineTo(x + 2 * size, y - 2 * size);
}
