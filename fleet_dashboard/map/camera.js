// Which part of the plane is seen: a center in metres, and pixels to a metre. The second axis points up.

export class Camera {
  constructor() {
    this.x = 0;
    this.y = 0;
    this.scale = 40;
    this.width = 1;
    this.height = 1;
  }

  toScreen(x, y) {
    return [this.width / 2 + (x - this.x) * this.scale, this.height / 2 - (y - this.y) * this.scale];
  }

  toPlane(px, py) {
    return [this.x + (px - this.width / 2) / this.scale, this.y - (py - this.height / 2) / this.scale];
  }

  /** Metres of the view: [left, bottom, right, top]. */
  bounds() {
    const [w, h] = [this.width / 2 / this.scale, this.height / 2 / this.scale];
    return [this.x - w, this.y - h, this.x + w, this.y + h];
  }

  pan(dx, dy) {
    this.x -= dx / this.scale;
    this.y += dy / this.scale;
  }

  /** Zoom so that the point of the plane under a pixel stays there. */
  zoom(factor, px = this.width / 2, py = this.height / 2) {
    const [x, y] = this.toPlane(px, py);
    this.scale = Math.min(5000, Math.max(1e-4, this.scale * factor));
    const [nx, ny] = this.toPlane(px, py);
    this.x += x - nx;
    this.y += y - ny;
  }

  /** See all of some points [[x, y], …]. Of many, a few that are far out do not count. */
  fit(points) {
    if (!points.length) return;
    const range = (axis) => {
      const values = points.map((point) => point[axis]).sort((a, b) => a - b);
      const middle = values[values.length >> 1];
      const near = values.filter((value) => Math.abs(value - middle) < 1e5);
      const cut = near.length > 50 ? Math.floor(near.length / 50) : 0;
      return [near[cut], near[near.length - 1 - cut]];
    };
    const [[left, right], [bottom, top]] = [range(0), range(1)];
    this.x = (left + right) / 2;
    this.y = (bottom + top) / 2;
    const [w, h] = [Math.max(right - left, 1) * 1.25 + 1, Math.max(top - bottom, 1) * 1.25 + 1];
    this.scale = Math.min(this.width / w, this.height / h, 400);
  }
}
