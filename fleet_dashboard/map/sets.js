// The sets, by WebGL: all outlines in one call, the last step of each tube filled in another. Where there is no WebGL, a
// plain canvas draws the same, slower.
import { THREE } from "nicegui-scene";
import { STALE } from "./frame.js";

const FILL = 0.22;

/** Opacity of a step: near ones strong, far ones faint, the last one a little stronger, for it is the border of all. */
function strength(step, steps) {
  const far = steps > 1 ? (step - 1) / (steps - 1) : 1;
  return step === steps ? 0.75 : 0.85 - 0.6 * far;
}

export class SetLayer {
  constructor(canvas) {
    this.canvas = canvas;
    this.frame = null;
    try {
      this.renderer = new THREE.WebGLRenderer({ canvas, antialias: true, alpha: true });
      // Colours as they are given: they shall be those of the legend.
      this.renderer.outputColorSpace = THREE.LinearSRGBColorSpace;
    } catch {
      this.renderer = null;
      this.context = canvas.getContext("2d");
      return;
    }
    this.camera = new THREE.OrthographicCamera(-1, 1, 1, -1, -1, 1);
    this.scene = new THREE.Scene();
    this.lines = new THREE.BufferGeometry();
    this.fills = new THREE.BufferGeometry();
    const line = new THREE.LineBasicMaterial({ vertexColors: true, transparent: true, depthTest: false });
    const fill = new THREE.MeshBasicMaterial({
      vertexColors: true, transparent: true, depthTest: false, opacity: FILL, side: THREE.DoubleSide,
    });
    for (const drawn of [new THREE.Mesh(this.fills, fill), new THREE.LineSegments(this.lines, line)]) {
      drawn.frustumCulled = false; // what is out of view was not sent
      this.scene.add(drawn);
    }
    this.capacity = 0;
  }

  resize(width, height, ratio) {
    if (this.renderer) {
      this.renderer.setPixelRatio(ratio);
      this.renderer.setSize(width, height, false);
    } else {
      this.canvas.width = width * ratio;
      this.canvas.height = height * ratio;
      this.ratio = ratio;
    }
  }

  /** Take the polygons of a frame; `colours` are [r, g, b] (0 to 255) by label, the last one for what is stale. */
  take(frame, colours) {
    this.frame = frame;
    this.colours = colours;
    if (!this.renderer) return;
    const vertices = frame.polygons * frame.corners;
    if (vertices > this.capacity || frame.corners !== this.corners) this.allocate(vertices, frame.corners);
    this.position.array.set(frame.outline);
    this.position.needsUpdate = true;
    this.paint(frame, colours);
    this.colour.needsUpdate = true;
    this.lines.setDrawRange(0, 2 * vertices);
  }

  allocate(vertices, corners) {
    const polygons = Math.max(64, Math.ceil((1.5 * vertices) / corners));
    this.capacity = polygons * corners;
    this.corners = corners;
    this.position = new THREE.BufferAttribute(new Float32Array(2 * this.capacity), 2).setUsage(THREE.DynamicDrawUsage);
    this.colour = new THREE.BufferAttribute(new Uint8Array(4 * this.capacity), 4, true).setUsage(THREE.DynamicDrawUsage);
    const edges = new Uint32Array(2 * this.capacity);
    for (let i = 0; i < this.capacity; i++) {
      edges[2 * i] = i;
      edges[2 * i + 1] = (i + 1) % corners ? i + 1 : i + 1 - corners;
    }
    this.triangles = new THREE.BufferAttribute(new Uint32Array(3 * polygons * Math.max(1, corners - 2)), 1);
    this.triangles.setUsage(THREE.DynamicDrawUsage);
    for (const geometry of [this.lines, this.fills]) {
      geometry.dispose();
      // Corners have no third coordinate, of which three.js would make one of a sphere around them.
      geometry.boundingSphere = new THREE.Sphere(new THREE.Vector3(), Infinity);
      geometry.setAttribute("position", this.position);
      geometry.setAttribute("color", this.colour);
    }
    this.lines.setIndex(new THREE.BufferAttribute(edges, 1));
    this.fills.setIndex(this.triangles);
  }

  paint(frame, colours) {
    const bytes = this.colour.array, index = this.triangles.array, K = frame.corners;
    let n = 0;
    for (let p = 0; p < frame.polygons; p++) {
      const code = frame.codes[frame.owners[p]];
      const [r, g, b] = (code >> 8) & STALE ? colours[colours.length - 1] : colours[code & 255];
      const step = frame.steps[p] & 0xffff, steps = frame.steps[p] >>> 16;
      const alpha = 255 * strength(step, steps);
      for (let k = p * K; k < (p + 1) * K; k++) {
        bytes[4 * k] = r;
        bytes[4 * k + 1] = g;
        bytes[4 * k + 2] = b;
        bytes[4 * k + 3] = alpha;
      }
      if (step !== steps) continue;
      for (let k = 1; k < K - 1; k++) {
        index[n++] = p * K;
        index[n++] = p * K + k;
        index[n++] = p * K + k + 1;
      }
    }
    this.triangles.needsUpdate = true;
    this.fills.setDrawRange(0, n);
  }

  draw(view) {
    if (!this.frame) return;
    if (!this.renderer) return this.drawPlain(view);
    // In metres from the frame's origin, so that single precision suffices wherever the fleet is.
    const [left, bottom, right, top] = view.bounds(), [x, y] = this.frame.origin;
    Object.assign(this.camera, { left: left - x, right: right - x, bottom: bottom - y, top: top - y });
    this.camera.updateProjectionMatrix();
    if (this.frame.polygons) this.renderer.render(this.scene, this.camera);
    else this.renderer.clear();
  }

  drawPlain(view) {
    const { context, frame, colours } = this, K = frame.corners;
    context.setTransform(this.ratio, 0, 0, this.ratio, 0, 0);
    context.clearRect(0, 0, view.width, view.height);
    for (let p = 0; p < frame.polygons; p++) {
      const code = frame.codes[frame.owners[p]];
      const rgb = ((code >> 8) & STALE ? colours[colours.length - 1] : colours[code & 255]).join(",");
      const step = frame.steps[p] & 0xffff, steps = frame.steps[p] >>> 16;
      context.beginPath();
      for (let k = p * K; k < (p + 1) * K; k++) {
        const [x, y] = view.toScreen(frame.origin[0] + frame.outline[2 * k], frame.origin[1] + frame.outline[2 * k + 1]);
        context.lineTo(x, y);
      }
      context.closePath();
      context.strokeStyle = `rgba(${rgb},${strength(step, steps)})`;
      context.stroke();
      if (step !== steps) continue;
      context.fillStyle = `rgba(${rgb},${FILL * strength(step, steps)})`;
      context.fill();
    }
  }

  dispose() {
    this.renderer?.dispose();
  }
}
