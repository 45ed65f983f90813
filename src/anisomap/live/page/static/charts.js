// Curves and the raster. All colours differ in lightness, so that they can be told apart without hue.

const INK = "#1c2733", QUIET = "#4d5b69", GRID = "#dde3e9", BLUE = "#0b5394";
export const MARK = "#b35000";
const RASTER_SECONDS = 10;
const FAMILY = "system-ui, 'DejaVu Sans', sans-serif";

// From light grey at rest to dark blue: lightness falls steadily.
const STOPS = [[236, 240, 244], [189, 215, 231], [107, 174, 214], [33, 113, 181], [8, 48, 107]];
export const RAMP = Array.from({ length: 256 }, (_, level) => {
  const at = level / 255 * (STOPS.length - 1), i = Math.min(Math.floor(at), STOPS.length - 2);
  return STOPS[i].map((low, c) => Math.round(low + (at - i) * (STOPS[i + 1][c] - low)));
});
export const COLOURS = RAMP.map(([r, g, b]) => `rgb(${r},${g},${b})`);

export function sized(canvas) {
  const ratio = Math.min(window.devicePixelRatio || 1, 2);
  const width = Math.max(1, Math.round(canvas.clientWidth * ratio));
  const height = Math.max(1, Math.round(canvas.clientHeight * ratio));
  if (canvas.width !== width || canvas.height !== height) {
    canvas.width = width;
    canvas.height = height;
  }
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, canvas.clientWidth, canvas.clientHeight);
  return context;
}

// Draw separate lines: each is [x, y, x, y].
export function lines(context, ends) {
  context.beginPath();
  for (const [ax, ay, bx, by] of ends) {
    context.moveTo(ax, ay);
    context.lineTo(bx, by);
  }
  context.stroke();
}

// Prepare texts: a font such as "600 15px", a colour, and how they are aligned.
export function texts(context, font, colour, align = "center") {
  context.font = `${font} ${FAMILY}`;
  context.fillStyle = colour;
  context.textAlign = align;
}

export function disc(context, x, y, radius) {
  context.beginPath();
  context.arc(x, y, radius, 0, 2 * Math.PI);
}

function niceStep(range, count) {
  const rough = range / count, power = 10 ** Math.floor(Math.log10(rough));
  return [1, 2, 5, 10].map((m) => m * power).find((step) => step >= rough);
}

// Draw curves: each is {points: [[x, y]], dashed}. Points with a null y are left out.
export function drawCurves(canvas, curves, { top, unit, rule, end: last }) {
  const context = sized(canvas), width = canvas.clientWidth, height = canvas.clientHeight;
  const left = 42, bottom = height - 16, right = width - 8, above = 6;
  const all = curves.flatMap((curve) => curve.points.filter(([, y]) => y !== null));
  const end = Math.max(10, last);
  const highest = top ?? Math.max(1.2 * rule, ...all.map(([, y]) => Math.min(y, 10 * rule))) * 1.1;
  const x = (value) => left + value / end * (right - left);
  const y = (value) => bottom - Math.min(value, highest) / highest * (bottom - above);
  texts(context, "11px", QUIET, "right");
  context.strokeStyle = GRID;
  context.lineWidth = 1;
  const step = niceStep(highest, 3);
  for (let value = 0; value <= highest; value += step) {
    lines(context, [[left, y(value), right, y(value)]]);
    context.fillText(unit === "%" ? `${Math.round(100 * value)}%` : String(+value.toFixed(2)), left - 4, y(value) + 4);
  }
  context.textAlign = "center";
  const across = niceStep(end, 4);
  for (let value = 0; value <= end; value += across) {
    context.fillText(`${value} s`, Math.min(x(value) + (value ? 0 : 8), right - 10), height - 3);
  }
  if (rule) {
    context.setLineDash([2, 3]);
    context.strokeStyle = QUIET;
    lines(context, [[left, y(rule), right, y(rule)]]);
    context.setLineDash([]);
  }
  for (const curve of curves) {
    const points = curve.points.filter(([, value]) => value !== null);
    context.strokeStyle = curve.dashed ? INK : BLUE;
    context.fillStyle = context.strokeStyle;
    context.lineWidth = 2;
    context.setLineDash(curve.dashed ? [5, 4] : []);
    curveThrough(context, points.map(([px, py]) => [x(px), y(py)]));
    context.setLineDash([]);
    for (const [px, py] of points.slice(-1)) {
      disc(context, x(px), y(py), 3);
      context.fill();
    }
  }
}

function curveThrough(context, points) {
  context.beginPath();
  points.forEach(([x, y], i) => (i ? context.lineTo(x, y) : context.moveTo(x, y)));
  context.stroke();
}

// The readings of the last seconds as an image: time to the right, one row per sensor.
export class Raster {
  constructor(canvas) {
    this.canvas = canvas;
    this.columns = [];
    this.gaps = [];
  }

  add(seconds, levels) {
    this.now = seconds;
    if (!levels.length) return;
    if (this.columns.length && this.columns[0].levels.length !== levels.length) this.columns = [];
    this.columns.push({ seconds, levels });
    while (this.columns.length && this.columns[0].seconds < seconds - RASTER_SECONDS) this.columns.shift();
  }

  // Return the place of a time on a width.
  at(seconds, width) {
    return (1 - (this.now - seconds) / RASTER_SECONDS) * width;
  }

  // Draw the readings of one sensor as a curve.
  drawTrace(canvas, sensor) {
    if (!this.columns.length || sensor >= this.columns[0].levels.length) return;
    const context = sized(canvas), width = canvas.clientWidth, height = canvas.clientHeight;
    context.strokeStyle = BLUE;
    context.lineWidth = 1.5;
    curveThrough(context, this.columns.map(({ seconds, levels }) => [
      this.at(seconds, width), height - 3 - levels[sensor] / 255 * (height - 6)]));
  }

  draw() {
    if (!this.columns.length) return;
    const context = sized(this.canvas), width = this.canvas.clientWidth, height = this.canvas.clientHeight - 14;
    const now = this.now, count = this.columns[0].levels.length;
    const rows = Math.max(1, Math.min(count, Math.floor(height))), pixels = new ImageData(RASTER_SECONDS * 20, rows);
    for (let i = 0; i < pixels.width * rows; i++) pixels.data.set([...RAMP[0], 255], 4 * i);
    for (const { seconds, levels } of this.columns) {
      const column = Math.floor((seconds - now + RASTER_SECONDS) * 20 - 1e-9);
      if (column < 0 || column >= pixels.width) continue;
      const strongest = new Uint8Array(rows);
      for (let i = 0; i < count; i++) {
        const row = Math.floor(i * rows / count);
        strongest[row] = Math.max(strongest[row], levels[i]);
      }
      for (let row = 0; row < rows; row++) {
        const at = 4 * (row * pixels.width + column);
        pixels.data.set(RAMP[strongest[row]], at);
        if (column + 1 < pixels.width) pixels.data.set(RAMP[strongest[row]], at + 4);
      }
    }
    const image = document.createElement("canvas");
    image.width = pixels.width;
    image.height = rows;
    image.getContext("2d").putImageData(pixels, 0, 0);
    context.imageSmoothingEnabled = false;
    context.drawImage(image, 0, 0, width, height);
    context.strokeStyle = MARK;
    context.lineWidth = 2;
    const gaps = this.gaps.filter((seconds) => seconds > now - RASTER_SECONDS && seconds <= now);
    lines(context, gaps.map((seconds) => [this.at(seconds, width), 0, this.at(seconds, width), height]));
    texts(context, "11px", QUIET, "left");
    context.fillText(`−${RASTER_SECONDS} s`, 2, height + 12);
    context.textAlign = "right";
    context.fillText("now", width - 2, height + 12);
  }
}
