// The map: sensors, neighbours, halos and the places to touch, in 2D or turned in 3D.

import { COLOURS, MARK, disc, lines, sized, texts } from "./charts.js";

const LINE = "#b4bfca", OUTLINE = "#1c2733", HALO = "rgba(77, 91, 105, 0.2)";
const EASE_MS = 250;
const MARGIN = 0.1, SHELF = 96, ABOVE = 84;
const SHELF_ROWS = 3, SHELF_STEP = 26;
const calm = window.matchMedia("(prefers-reduced-motion: reduce)");

export class MapView {
  constructor(canvas) {
    this.canvas = canvas;
    this.names = [];
    this.shown = null;
    this.levels = new Uint8Array(0);
    this.selected = -1;
    this.faulty = new Set();
    this.hovered = -1;
    this.named = false;
    this.layout = false;
    this.reset();
    this._listen();
  }

  reset() {
    this.turn = 0.5;
    this.tilt = 0.35;
    this.zoom = 1;
  }

  // data: {names, dimensions, positions, pairs, halo, untouched, left_out, places}; halo from 0 to 1
  update(data) {
    const before = this.names;
    const { names, dimensions, positions: target, pairs, halo, places, untouched } = data;
    Object.assign(this, { names, dimensions, target, pairs, halo, places, untouched });
    this.leftOut = new Set(data.left_out);
    this.stated = data.stated && data.stated.length === this.target.length ? data.stated : null;
    if (before.length !== this.names.length) this.selected = this.names.indexOf(this.wanted);
    if (!this.shown || this.shown.length !== this.target.length) this.shown = this.target.slice();
  }

  // Return the number of sensors without a place on the map that is shown.
  countUnplaced() {
    return this.names.filter((_, i) => !this.leftOut.has(i) && !Number.isFinite(this.target[i * this.dimensions])).length;
  }

  move(elapsed) {
    if (!this.target) return;
    const share = calm.matches ? 1 : 1 - Math.exp(-elapsed / EASE_MS);
    for (let i = 0; i < this.target.length; i++) {
      const goal = this.target[i];
      this.shown[i] = Number.isFinite(this.shown[i]) ? this.shown[i] + share * (goal - this.shown[i]) : goal;
    }
  }

  // Return a place as seen: to the right, upwards and towards the viewer.
  _turned(places, i) {
    const k = this.dimensions, x = places[i * k], y = places[i * k + 1], z = k > 2 ? places[i * k + 2] : 0;
    if (k < 3) return [x, y, 0];
    const a = Math.cos(this.turn) * x - Math.sin(this.turn) * y, b = Math.sin(this.turn) * x + Math.cos(this.turn) * y;
    return [a, Math.cos(this.tilt) * z + Math.sin(this.tilt) * b, Math.sin(this.tilt) * z - Math.cos(this.tilt) * b];
  }

  // Return [x, y, depth] of each sensor in pixels; sensors without a place stand on a shelf.
  project() {
    const width = this.canvas.clientWidth, height = this.canvas.clientHeight - SHELF - ABOVE;
    const count = this.names.length, found = new Array(count);
    let reach = 1e-9, low = [Infinity, Infinity], high = [-Infinity, -Infinity];
    const flat = [];
    for (let i = 0; i < count; i++) {
      const [u, v, w] = this._turned(this.shown, i);
      if (!Number.isFinite(u)) continue;
      flat.push([i, u, v, w]);
      reach = Math.max(reach, Math.hypot(u, v, w));
      low = [Math.min(low[0], u), Math.min(low[1], v)];
      high = [Math.max(high[0], u), Math.max(high[1], v)];
    }
    const middle = flat.length ? [(low[0] + high[0]) / 2, (low[1] + high[1]) / 2] : [0, 0];
    const spanX = Math.max(1e-9, (high[0] - low[0]) / 2), spanY = Math.max(1e-9, (high[1] - low[1]) / 2);
    const room = 1 - 2 * MARGIN;
    const goal = this.zoom * Math.min(width * room / 2 / spanX, height * room / 2 / spanY);
    // The view follows the map with a delay, so that it does not jump.
    const share = this.scale && !calm.matches ? 0.2 : 1;
    this.scale = (this.scale || goal) + share * (goal - (this.scale || goal));
    this.middle = (this.middle || middle).map((at, axis) => at + share * (middle[axis] - at));
    const pixel = ([u, v, w]) => [
      width / 2 + (u - this.middle[0]) * this.scale, ABOVE + height / 2 - (v - this.middle[1]) * this.scale, w / reach];
    for (const [i, ...seen] of flat) found[i] = pixel(seen);
    this.squares = this.stated && this.layout ? found.map((_, i) => pixel(this._turned(this.stated, i))) : [];
    // Many sensors stand in several rows of smaller marks.
    const waiting = this.names.map((_, i) => i).filter((i) => !found[i] && !this.leftOut.has(i));
    const rows = Math.min(SHELF_ROWS, Math.ceil(waiting.length * SHELF_STEP / (width - 40)));
    const columns = Math.ceil(waiting.length / Math.max(rows, 1)), step = Math.min(SHELF_STEP, (width - 40) / Math.max(1, columns));
    waiting.forEach((i, n) => {
      const row = Math.floor(n / columns);
      found[i] = [16 + step * (n % columns + 0.5), ABOVE + height + 4 + Math.min(step, 12) * row, 1];
    });
    this.waiting = new Set(waiting);
    this.waitingRadius = Math.max(1.5, 0.42 * Math.min(step, rows > 1 ? 12 : step));
    return found;
  }

  draw() {
    const context = sized(this.canvas);
    if (!this.target) return;
    const points = this.points = this.project();
    const area = this.canvas.clientWidth * (this.canvas.clientHeight - SHELF - ABOVE);
    const radius = Math.max(2.5, Math.min(14, 0.16 * Math.sqrt(Math.max(area, 1) / this.names.length)));
    context.strokeStyle = LINE;
    context.lineWidth = 1;
    const ends = [];
    for (let p = 0; p < this.pairs.length; p += 2) {
      const [a, b] = [this.pairs[p], this.pairs[p + 1]];
      if (points[a] && points[b] && !this.waiting.has(a) && !this.waiting.has(b)) ends.push([...points[a].slice(0, 2), ...points[b]]);
    }
    lines(context, ends);
    const untouched = new Set(this.untouched);
    const order = points.map((_, i) => i).filter((i) => points[i] && !this.leftOut.has(i));
    if (this.dimensions > 2) order.sort((i, j) => points[i][2] - points[j][2]);
    // One path for all: halos that overlap are no darker than others.
    context.fillStyle = HALO;
    context.beginPath();
    for (const i of order) {
      if (untouched.has(i) || this.waiting.has(i)) continue;
      const reach = radius * (1 + 2.5 * this.halo[i]);
      context.moveTo(points[i][0] + reach, points[i][1]);
      context.arc(points[i][0], points[i][1], reach, 0, 2 * Math.PI);
    }
    context.fill();
    for (const i of order) {
      const size = this.waiting.has(i) ? Math.min(radius, this.waitingRadius) : radius;
      this._sensor(context, i, points[i], size, untouched.has(i));
    }
    this._layout(context, radius);
    this._names(context, points, order, radius);
    this._marks(context, points, radius);
  }

  _sensor(context, i, [x, y, depth], radius, hollow) {
    const size = this.dimensions > 2 ? radius * (0.85 + 0.2 * depth) : radius;
    disc(context, x, y, size);
    context.lineWidth = i === this.selected ? 4 : size > 4 ? 1.2 : 0.8;
    context.strokeStyle = i === this.selected ? MARK : OUTLINE;
    if (hollow && size > 5) context.setLineDash([3, 3]);
    context.fillStyle = hollow ? "#ffffff" : COLOURS[this.levels[i] || 0];
    context.fill();
    context.stroke();
    context.setLineDash([]);
    if (this.faulty.has(this.names[i])) {
      context.lineWidth = 2;
      context.strokeStyle = OUTLINE;
      lines(context, [[x - size, y - size, x + size, y + size], [x - size, y + size, x + size, y - size]]);
    }
  }

  // The stated layout: a square at every stated place, joined to its sensor.
  _layout(context, radius) {
    context.strokeStyle = MARK;
    context.lineWidth = 1;
    context.beginPath();
    this.squares.forEach(([x, y], i) => {
      if (!Number.isFinite(x) || this.waiting.has(i) || this.leftOut.has(i)) return;
      const half = 0.8 * radius;
      context.rect(x - half, y - half, 2 * half, 2 * half);
      context.moveTo(x, y);
      context.lineTo(this.points[i][0], this.points[i][1]);
    });
    context.stroke();
  }

  // Names of all sensors where they do not overlap; always of the one below the pointer and the selected one.
  _names(context, points, order, radius) {
    texts(context, "12px", OUTLINE);
    context.lineWidth = 3;
    context.strokeStyle = "#ffffff";
    const taken = [], first = [this.hovered, this.selected].filter((i) => i >= 0 && points[i]);
    for (const i of [...first, ...(this.named ? order.slice().reverse() : [])]) {
      const name = this.names[i].length > 24 ? `${this.names[i].slice(0, 23)}…` : this.names[i];
      const half = context.measureText(name).width / 2 + 2, y = points[i][1] - radius - 5;
      const x = Math.max(half, Math.min(points[i][0], this.canvas.clientWidth - half));
      if (taken.some(([a, b, h]) => Math.abs(a - x) < h + half && Math.abs(b - y) < 13)) continue;
      taken.push([x, y, half]);
      context.strokeText(name, x, y);
      context.fillText(name, x, y);
    }
  }

  _marks(context, points, radius) {
    this.places.forEach((place, n) => {
      const inside = place.map((i) => points[i]).filter(Boolean);
      if (!inside.length) return;
      const x = inside.reduce((sum, p) => sum + p[0], 0) / inside.length;
      const y = inside.reduce((sum, p) => sum + p[1], 0) / inside.length;
      const reach = Math.max(...inside.map((p) => Math.hypot(p[0] - x, p[1] - y))) + 1.8 * radius;
      context.setLineDash([7, 5]);
      context.strokeStyle = MARK;
      context.lineWidth = n ? 2 : 4;
      disc(context, x, y, reach);
      context.stroke();
      context.setLineDash([]);
      context.fillStyle = MARK;
      disc(context, x, y - reach, 11);
      context.fill();
      texts(context, "600 15px", "#ffffff");
      context.fillText(String(n + 1), x, y - reach + 5);
    });
  }

  // Return the sensor at a point of the canvas, or -1.
  at(x, y) {
    let best = -1, nearest = 22;
    (this.points || []).forEach((point, i) => {
      const distance = point ? Math.hypot(point[0] - x, point[1] - y) : Infinity;
      if (distance < nearest) [best, nearest] = [i, distance];
    });
    return best;
  }

  _listen() {
    let held = null, moved = 0;
    const under = (event) => {
      const frame = this.canvas.getBoundingClientRect();
      return this.at(event.clientX - frame.left, event.clientY - frame.top);
    };
    this.canvas.addEventListener("pointerdown", (event) => {
      held = [event.clientX, event.clientY];
      moved = 0;
      this.canvas.setPointerCapture(event.pointerId);
    });
    this.canvas.addEventListener("pointerleave", () => { this.hovered = -1; });
    this.canvas.addEventListener("pointermove", (event) => {
      this.hovered = under(event);
      if (!held) return;
      const [dx, dy] = [event.clientX - held[0], event.clientY - held[1]];
      moved += Math.abs(dx) + Math.abs(dy);
      held = [event.clientX, event.clientY];
      this.turnBy(0.008 * dx, 0.008 * dy);
    });
    this.canvas.addEventListener("pointerup", (event) => {
      if (held && moved < 6) this.select(under(event));
      held = null;
    });
    this.canvas.addEventListener("pointercancel", () => { held = null; });
    this.canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.zoomBy(event.deltaY < 0 ? 1.1 : 1 / 1.1);
    }, { passive: false });
  }

  turnBy(across, up) {
    this.turn += across;
    this.tilt = Math.max(-1.5, Math.min(1.5, this.tilt + up));
  }

  zoomBy(factor) {
    this.zoom = Math.max(0.3, Math.min(12, this.zoom * factor));
  }

  select(sensor) {
    this.selected = sensor;
    this.wanted = this.names[sensor];
    this.canvas.dispatchEvent(new CustomEvent("selected"));
  }
}
