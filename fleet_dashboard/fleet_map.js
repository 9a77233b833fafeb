// The live map: takes frames from a socket of its own and draws them. What they mean is decided in Python.
import { Camera, SetLayer, drawOverlay, listen, readFrame } from "fleet-map";

const RETRY_MS = 1000;
// Without a frame for so long the page itself is what is stale.
const SILENT_MS = 3000;

// Pixels to a metre at least, where one vehicle is followed.
const CLOSE = 60;

export default {
  template: `
    <div class="fleet-map" tabindex="0">
      <canvas ref="sets"></canvas><canvas ref="overlay"></canvas>
      <div ref="notice" class="fleet-notice" hidden></div><div ref="card" class="fleet-card" hidden></div>
    </div>`,

  props: { view: String, palette: Object, labels: Array, marks: Object, info: Boolean, names: Boolean, target: String },

  mounted() {
    this.camera = new Camera();
    this.layer = new SetLayer(this.$refs.sets);
    this.overlay = this.$refs.overlay.getContext("2d");
    Object.assign(this, { ids: [], regions: [], active: new Set(), frame: null, hovered: null, fitted: false });
    Object.assign(this, { followed: this.target || null, lastFrame: performance.now() });
    this.stats = { frames: 0, drawn: 0, since: performance.now() };
    window.fleetMap = this; // for tests, and for a look at its stats
    this.sizes = new ResizeObserver(() => this.resize());
    this.sizes.observe(this.$el);
    listen(this.$el, this);
    this.$nextTick(() => this.connect()); // the page, which knows its path behind a proxy, is mounted after this
    this.silence = setInterval(() => this.tellSilence(), 500);
  },

  unmounted() {
    this.gone = true;
    clearInterval(this.silence);
    this.sizes.disconnect();
    this.socket?.close();
    this.layer.dispose();
  },

  watch: {
    info() { this.redraw(); },
    names() { this.redraw(); },
  },

  methods: {
    // The socket

    connect() {
      const scheme = location.protocol === "https:" ? "wss:" : "ws:";
      this.socket = new WebSocket(`${scheme}//${location.host}${window.path_prefix ?? ""}/live/${this.view}`);
      this.socket.binaryType = "arraybuffer";
      this.socket.onopen = () => {
        this.ids = [];
        this.tellView();
      };
      this.socket.onmessage = ({ data }) => (typeof data === "string" ? this.hear(JSON.parse(data)) : this.take(data));
      this.socket.onclose = () => this.gone || setTimeout(() => this.connect(), RETRY_MS);
    },

    hear(said) {
      if (said.ids) this.ids.splice(said.first, said.ids.length, ...said.ids);
      if (said.regions) {
        this.regions = said.regions;
        if (!this.moved) this.fit();
      }
      if (said.active) this.active = new Set(said.active.map((pair) => pair.join("/")));
    },

    take(buffer) {
      const frame = readFrame(buffer);
      if (!frame) return this.tell("This page is of another version than its server: reload it.");
      this.lastFrame = performance.now();
      this.stats.frames++;
      this.frame = frame;
      if (!this.fitted && (frame.count || this.regions.length)) this.fitNow();
      this.layer.take(frame, this.colours());
      this.followOn();
      this.redraw();
    },

    tellView() {
      if (this.socket?.readyState !== WebSocket.OPEN) return;
      const view = this.fitted ? this.camera.bounds() : null;
      this.socket.send(JSON.stringify({ view, pixels: this.camera.scale }));
    },

    tellSilence() {
      const silent = performance.now() - this.lastFrame;
      this.tell(silent > SILENT_MS ? `Not connected: what is shown is ${Math.round(silent / 1000)} s old` : "");
    },

    tell(text) {
      this.$refs.notice.textContent = text;
      this.$refs.notice.hidden = !text;
      this.$el.classList.toggle("fleet-silent", !!text);
    },

    // The view

    resize() {
      const { clientWidth: width, clientHeight: height } = this.$el;
      if (!width || !height) return;
      this.ratio = Math.min(2, window.devicePixelRatio || 1);
      Object.assign(this.camera, { width, height });
      Object.assign(this.$refs.overlay, { width: width * this.ratio, height: height * this.ratio });
      this.layer.resize(width, height, this.ratio);
      this.draw(); // at once: a canvas of another size is blank
      this.changed();
    },

    /** See everything; the server is asked for all vehicles first. */
    fit() {
      this.fitted = this.moved = false;
      this.tellView();
    },

    fitNow() {
      const { frame } = this, points = [];
      for (let i = 0; i < frame.count; i++) points.push(this.place(i));
      // Regions without an end are drawn as far as a raster reaches: they do not make the view larger than the vehicles' surroundings.
      if (points.length < 200) for (const { segments: s } of this.regions) points.push([s[0], s[1]], [s.at(-2), s.at(-1)]);
      this.camera.fit(points);
      if (this.followed) this.camera.scale = Math.max(this.camera.scale, CLOSE);
      this.fitted = true;
      this.changed();
    },

    changed() {
      this.redraw();
      // A wheel turns faster than a server needs to know.
      if (this.telling) return;
      this.telling = setTimeout(() => {
        this.telling = null;
        this.tellView();
      }, 60);
    },

    follow(id) {
      this.followed = id;
      if (id) this.camera.scale = Math.max(this.camera.scale, CLOSE);
      this.followOn();
      this.changed();
    },

    followOn() {
      const i = this.followed ? this.find(this.followed) : -1;
      if (i < 0) return;
      const [x, y] = this.place(i);
      if (Math.hypot(x - this.camera.x, y - this.camera.y) * this.camera.scale < 1) return;
      Object.assign(this.camera, { x, y });
      this.fitted = this.moved = true;
      this.changed();
    },

    find(id) {
      const row = this.ids.indexOf(id);
      return this.frame && row >= 0 ? this.frame.rows.indexOf(row) : -1;
    },

    place(i) {
      const { origin, poses } = this.frame;
      return [origin[0] + poses[3 * i], origin[1] + poses[3 * i + 1]];
    },

    /** Where a point of the plane is on the screen, in pixels of the page. */
    onScreen(x, y) {
      const { left, top } = this.$el.getBoundingClientRect(), [px, py] = this.camera.toScreen(x, y);
      return [left + px, top + py];
    },

    // Drawing: only when something changed, and not oftener than the screen

    theme() {
      return this.palette[document.body.classList.contains("body--dark") ? "dark" : "light"];
    },

    colours() {
      return this.theme().colours;
    },

    redraw() {
      this.pending ??= requestAnimationFrame(() => this.draw());
    },

    draw() {
      this.pending = null;
      if (this.gone || !this.ratio) return;
      this.layer.draw(this.camera);
      const shown = { frame: this.frame, ids: this.ids, active: this.active, followed: this.followed };
      Object.assign(shown, { hovered: this.hovered, colours: this.colours(), theme: this.theme(), names: this.names });
      drawOverlay(this.overlay, this.camera, this.ratio, { ...shown, regions: this.info ? this.regions : [] });
      this.showCard();
      this.stats.drawn++;
    },

    // Pointer and keys: map/pointer.js calls these

    zoom(factor, px, py) {
      this.moved = true;
      this.camera.zoom(factor, px, py);
      this.changed();
    },

    drag(dx, dy) {
      this.moved = true;
      if (this.followed) this.pick(null);
      this.followed = null;
      this.camera.pan(dx, dy);
      this.changed();
    },

    hover(id) {
      this.hovered = id;
      this.redraw();
    },

    pick(id) {
      this.$emit("pick", { id });
    },

    nearest(x, y) {
      let [least, found] = [20, null];
      for (let i = 0; this.frame && i < this.frame.count; i++) {
        const [px, py] = this.camera.toScreen(...this.place(i)), away = Math.hypot(px - x, py - y);
        if (away < least) [least, found] = [away, this.ids[this.frame.rows[i]] ?? null];
      }
      return found;
    },

    showCard() {
      const { card } = this.$refs, i = this.hovered ? this.find(this.hovered) : -1;
      card.hidden = i < 0;
      if (i < 0) return;
      const [age, area, free, coverage] = this.frame.figures.subarray(4 * i, 4 * i + 4);
      const code = this.frame.codes[i], number = (value, unit) => (isFinite(value) ? `${+value.toPrecision(3)}${unit}` : "–");
      const lines = [this.hovered, this.labels[code & 255], `age ${number(age, " s")}`, `area ${number(area, " m²")}`];
      if (free > 0) lines.push(`uncut ${number(free, " m²")}, cut away ${number(100 * (1 - area / free), " %")}`);
      lines.push(`coverage ${number(100 * coverage, " %")}`);
      for (const [bit, words] of Object.entries(this.marks)) if ((code >> 8) & bit) lines.push(words);
      // Text only: ids and words come from outside.
      card.replaceChildren(...lines.map((line) => Object.assign(document.createElement("div"), { textContent: line })));
      const [x, y] = this.camera.toScreen(...this.place(i));
      card.style.left = `${Math.min(x + 16, this.camera.width - card.offsetWidth - 4)}px`;
      card.style.top = `${Math.max(4, Math.min(y + 12, this.camera.height - card.offsetHeight - 4))}px`;
    },
  },
};
