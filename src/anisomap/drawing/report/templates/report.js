"use strict";

(function sortableTable() {
  const table = document.getElementById("sensors");
  if (!table) return; // objects, of which nothing is known but their positions
  const headings = [...table.tHead.rows[0].cells];
  const body = table.tBodies[0];
  const original = [...body.rows];
  const key = (row, column) => {
    const cell = row.cells[column];
    return "key" in cell.dataset ? Number.parseFloat(cell.dataset.key) : cell.textContent;
  };
  const compare = (a, b) =>
    typeof a === "number" ? a - b : a.localeCompare(b, "en", { numeric: true });
  // Unknown values stay at the end whichever way the column is sorted.
  const unknown = (value) => (typeof value === "number" ? Number.isNaN(value) : value === "");

  headings.forEach((heading, column) => {
    heading.querySelector("button").addEventListener("click", () => {
      const before = heading.getAttribute("aria-sort");
      headings.forEach((other) => other.removeAttribute("aria-sort"));
      if (before === "descending") {
        body.append(...original);
        return;
      }
      const sign = before === "ascending" ? -1 : 1;
      heading.setAttribute("aria-sort", sign === 1 ? "ascending" : "descending");
      const rows = original.map((row) => [key(row, column), row]);
      rows.sort(([a], [b]) => unknown(a) - unknown(b) || sign * compare(a, b) || 0);
      body.append(...rows.map(([, row]) => row));
    });
  });
})();

(function interactiveMap() {
  const source = document.getElementById("scene");
  if (!source) return;
  const components = JSON.parse(source.textContent);
  const canvas = document.getElementById("view");
  const pen = canvas.getContext("2d");
  const form = document.getElementById("controls");
  const [tip, legend] = ["tip", "legend"].map((id) => document.getElementById(id));
  const LAYERS = 8; // from back to front
  const CIVIDIS = [[0, 32, 77], [65, 77, 107], [124, 123, 120], [187, 174, 109], [255, 234, 70]];
  const INK = "#22262b", LACKING = "#c0392b";
  let shown, colours, camera, scale, seen, focus, held;

  const on = (name) => Boolean(form.elements[name] && form.elements[name].checked);
  const dot = (p, q) => p.reduce((sum, value, i) => sum + value * q[i], 0);
  const brief = (value) => String(Number(value.toPrecision(3)));

  function axes() { // to the right, up, and towards the viewer
    if (!shown.view) return [[1, 0, 0], [0, 1, 0], [0, 0, 1]];
    const [e, a] = camera.angles.map((degrees) => (degrees * Math.PI) / 180);
    const { sin, cos } = Math;
    return [
      [-sin(a), cos(a), 0],
      [-sin(e) * cos(a), -sin(e) * sin(a), cos(e)],
      [cos(e) * cos(a), cos(e) * sin(a), sin(e)],
    ];
  }

  function reset() {
    camera = { angles: shown.view && [...shown.view], zoom: 1, shift: [0, 0] };
  }

  function colour(i) {
    if (colours.each) return colours.each[i];
    if (colours.classes) return colours.classes[colours.of[i]][1];
    if (colours.ramp[i] === null) return "#b8b8b8";
    const [low, high] = colours.range;
    const at = ((colours.ramp[i] - low) / (high - low || 1)) * (CIVIDIS.length - 1);
    const k = Math.min(Math.floor(at), CIVIDIS.length - 2);
    return `rgb(${CIVIDIS[k].map((c, j) => c + (at - k) * (CIVIDIS[k + 1][j] - c)).join(" ")})`;
  }

  // Everything within this distance of the middle is visible from all sides: in 2D, of each axis.
  function reaches() {
    const far = [...shown.points, ...(shown.truth || [])].map((p) => p.map((v, i) => v - shown.middle[i]));
    const wide = on("ellipses") && shown.ellipses
      ? Math.sqrt(Math.max(...shown.ellipses.flatMap((c) => (c[0][0] === null ? [] : c.map((row, i) => row[i]))), 0)) : 0;
    if (!shown.view) return [0, 1].map((i) => far.reduce((most, p) => Math.max(most, Math.abs(p[i])), 1e-12) + wide);
    const most = Math.sqrt(far.reduce((sum, p) => Math.max(sum, dot(p, p)), 1e-24)) + wide;
    return [most, most];
  }

  function line(points, style, width, dashes = []) {
    Object.assign(pen, { strokeStyle: style, lineWidth: width });
    pen.setLineDash(dashes);
    pen.beginPath();
    for (const [a, b] of points) { pen.moveTo(a[0], a[1]); pen.lineTo(b[0], b[1]); }
    pen.stroke();
    pen.setLineDash([]);
  }

  function ring(at, size, style, width) {
    Object.assign(pen, { strokeStyle: style, lineWidth: width });
    pen.beginPath();
    pen.arc(at[0], at[1], size, 0, 2 * Math.PI);
    pen.stroke();
  }

  function write(text, at, size = 12, weight = 400, style = INK) {
    Object.assign(pen, { font: `${weight} ${size}px system-ui, sans-serif`, strokeStyle: "#fff", lineWidth: 3, fillStyle: style });
    const x = Math.max(4, Math.min(at[0], canvas.clientWidth - pen.measureText(text).width - 4));
    pen.strokeText(text, x, at[1]);
    pen.fillText(text, x, at[1]);
  }

  function draw() {
    const ratio = Math.max(window.devicePixelRatio, 2);
    const { clientWidth: width, clientHeight: height } = canvas;
    Object.assign(canvas, { width: width * ratio, height: height * ratio });
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    const [right, up, towards] = axes();
    const [across, along] = reaches();
    scale = camera.zoom * Math.min((width / 2 - 24) / across, (height / 2 - 44) / along);
    const place = (p) => {
      const q = p.map((value, i) => value - shown.middle[i]);
      return [width / 2 + camera.shift[0] + scale * dot(q, right), height / 2 - 14 + camera.shift[1] - scale * dot(q, up), dot(q, towards)];
    };
    seen = shown.points.map(place);
    const truth = on("truth") ? (shown.truth || []).map(place) : [];
    const depths = seen.map((p) => p[2]).sort((a, b) => a - b);
    const [back, front] = [depths[0], depths[depths.length - 1]];
    const layer = (i) => (shown.view && front > back ? Math.min(LAYERS - 1, Math.floor((LAYERS * (seen[i][2] - back)) / (front - back))) : LAYERS - 1);
    const size = Math.min(Math.max(0.7 * Math.sqrt((width * height) / (80 * seen.length)), 1.5), 7) * Math.min(camera.zoom, 2) ** 0.5;
    const layers = Array.from({ length: LAYERS }, () => ({ dots: [], pairs: [] }));
    seen.forEach((_, i) => layers[layer(i)].dots.push(i));
    if (on("neighbours")) for (const pair of shown.pairs) layers[Math.min(...pair.map(layer))].pairs.push(pair);
    if (on("ellipses")) drawEllipses(right, up);
    layers.forEach(({ dots, pairs }, k) => {
      pen.globalAlpha = 0.3 + (0.7 * (k + 1)) / LAYERS;
      line(pairs.map((pair) => pair.map((i) => seen[i])), "#737a82", seen.length > 800 ? 0.7 : 1.3);
      for (const i of dots) drawDot(i, size);
    });
    pen.globalAlpha = 1;
    if (truth.length) line(truth.map((p, i) => [p, seen[i]]), "#d55e00", 1.4);
    for (const p of truth) ring(p, size, "#0072b2", 1.4);
    if (colours.apart) line(colours.apart.map((pair) => pair.map((i) => seen[i])), LACKING, 2, [5, 3]);
    (colours.places || []).forEach((sensors, rank) => {
      const centre = [0, 1].map((axis) => sensors.reduce((sum, i) => sum + seen[i][axis], 0) / sensors.length);
      if (sensors.length) write(String(rank + 1), [centre[0] - 6, centre[1] + 6], 20, 700, LACKING);
    });
    for (const i of on("names") ? seen.keys() : shown.labels) write(shown.names[i], [seen[i][0] + size + 2, seen[i][1] - size]);
    if (focus >= 0) {
      line(shown.pairs.filter((pair) => pair.includes(focus)).map((pair) => pair.map((i) => seen[i])), INK, 2.5);
      ring(seen[focus], size + 3, INK, 2);
      write(shown.names[focus], [seen[focus][0] + size + 5, seen[focus][1] - size - 3], 14, 700);
    }
    drawScale(width, height, right, up);
  }

  function drawDot(i, size) {
    const [x, y] = seen[i];
    Object.assign(pen, { fillStyle: colour(i), strokeStyle: INK, lineWidth: 0.6 });
    pen.beginPath();
    if (shown.uncompared.has(i)) pen.rect(x - size, y - size, 2 * size, 2 * size);
    else pen.arc(x, y, size, 0, 2 * Math.PI);
    pen.fill();
    if (size > 2.5) pen.stroke();
    const arm = size + 3;
    if (shown.faulty.has(i)) line([[[x - arm, y - arm], [x + arm, y + arm]], [[x - arm, y + arm], [x + arm, y - arm]]], "#000", 2);
  }

  function drawEllipses(right, up) {
    const part = (c, p, q) => dot(c.map((row) => dot(row, q)), p);
    (shown.ellipses || []).forEach((c, i) => {
      if (c[0][0] === null) return;
      const [xx, xy, yy] = [part(c, right, right), part(c, right, up), part(c, up, up)];
      const [middle, apart] = [(xx + yy) / 2, Math.hypot((xx - yy) / 2, xy)];
      const [long, short] = [middle + apart, middle - apart].map((square) => scale * Math.sqrt(Math.max(square, 0)));
      Object.assign(pen, { strokeStyle: "#8a6d3b", lineWidth: 0.8 });
      pen.beginPath();
      pen.ellipse(seen[i][0], seen[i][1], long, short, -Math.atan2(2 * xy, xx - yy) / 2, 0, 2 * Math.PI);
      pen.stroke();
    });
  }

  function drawScale(width, height, right, up) {
    const power = 10 ** Math.floor(Math.log10((0.3 * width) / scale));
    const length = power * [5, 2, 1].find((step) => step * power * scale <= 0.3 * width);
    line([[[width - 16 - length * scale, height - 12], [width - 16, height - 12]]], INK, 2);
    write(`${brief(length)} ${shown.units}`, [width - 16 - length * scale, height - 18]);
    ["x", "y", "z"].slice(0, shown.middle.length).forEach((name, i) => {
      const end = [40 + 24 * right[i], height - 40 - 24 * up[i]];
      line([[[40, height - 40], end]], "#737a82", 1.2);
      write(name, [end[0] + 2, end[1]], 11);
    });
  }

  function describe(i) {
    const units = shown.units, { health, error, contacts } = shown.colours;
    const told = [shown.names[i], `position ${shown.points[i].map(brief).join(", ")} ${units}`];
    if (health) told.push(`health: ${health.classes[health.of[i]][0]}`);
    if (contacts) told.push(`contacts: ${contacts.values[i]}`);
    if (error) told.push(error.ramp[i] === null ? "not compared with the truth" : `error: ${error.ramp[i]} ${units}`);
    const near = shown.pairs.filter((pair) => pair.includes(i)).map(([a, b]) => shown.names[a === i ? b : a]);
    if (near.length) told.push(`neighbours: ${near.join(", ")}`);
    return told.join("\n");
  }

  function look(i) {
    focus = i;
    tip.textContent = i < 0 ? "" : describe(i);
    draw();
  }

  function nearest(x, y) {
    let best = -1, least = 14 ** 2;
    seen.forEach((p, i) => {
      const square = (p[0] - x) ** 2 + (p[1] - y) ** 2;
      if (square < least) [best, least] = [i, square];
    });
    return best;
  }

  function move(x, y, pan) {
    if (shown.view && !pan) {
      camera.angles[0] = Math.max(-90, Math.min(90, camera.angles[0] + y / 2));
      camera.angles[1] -= x / 2;
    } else camera.shift = [camera.shift[0] + x, camera.shift[1] + y];
    draw();
  }

  function zoom(factor) {
    camera.zoom = Math.max(0.3, Math.min(30, camera.zoom * factor));
    camera.shift = camera.shift.map((value) => value * factor);
    draw();
  }

  function choose() {
    const number = form.elements.component ? Number(form.elements.component.value) : 0;
    if (shown !== components[number]) {
      [shown, focus] = [components[number], -1];
      for (const name of ["faulty", "uncompared"]) shown[name] = new Set(shown[name]);
      reset();
    }
    for (const name of ["truth", "ellipses"]) if (form.elements[name]) form.elements[name].disabled = !shown[name];
    colours = shown.colours[form.elements.colour.value] || shown.colours.position;
    legend.replaceChildren();
    const entry = (text, background) => {
      const [item, swatch] = [document.createElement("li"), document.createElement("span")];
      Object.assign(swatch, { className: "swatch" }).style.background = background;
      item.append(...(background ? [swatch] : []), text);
      legend.append(item);
    };
    for (const [name, background] of colours.classes || []) entry(name, background);
    if (colours.ramp) {
      const known = colours.ramp.filter((value) => value !== null);
      colours.range = known.reduce(([low, high], v) => [Math.min(low, v), Math.max(high, v)], [Infinity, -Infinity]);
      const units = colours.title === "error" ? ` ${shown.units}` : "";
      [["low", CIVIDIS[0]], ["high", CIVIDIS[4]]].forEach(([, rgb], end) => entry(`${colours.title} ${brief(colours.range[end])}${units}`, `rgb(${rgb})`));
    }
    if (colours.each) entry("Colours encode the position in the initial view: light is up, yellow is right, blue is left.");
    if (colours.apart) entry("Dashed red lines join neighbours that were never touched together; numbers mark the places to touch next.");
    draw();
  }

  const KEYS = {
    ArrowLeft: () => move(-20, 0), ArrowRight: () => move(20, 0), ArrowUp: () => move(0, -20), ArrowDown: () => move(0, 20),
    "+": () => zoom(1.25), "-": () => zoom(0.8), 0: () => { reset(); draw(); },
    n: () => look((focus + 1) % seen.length), p: () => look((focus > 0 ? focus : seen.length) - 1),
  };
  canvas.addEventListener("keydown", (event) => {
    const act = KEYS[event.key];
    if (!act || event.ctrlKey || event.metaKey || event.altKey) return;
    act();
    event.preventDefault();
  });
  canvas.addEventListener("pointerdown", (event) => {
    held = [event.offsetX, event.offsetY];
    canvas.setPointerCapture(event.pointerId);
  });
  canvas.addEventListener("pointermove", (event) => {
    const { offsetX: x, offsetY: y } = event;
    if (held) {
      move(x - held[0], y - held[1], event.shiftKey);
      held = [x, y];
    } else {
      const found = nearest(x, y);
      if (found !== focus) look(found);
    }
  });
  for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, () => { held = null; });
  canvas.addEventListener("click", (event) => look(nearest(event.offsetX, event.offsetY)));
  canvas.addEventListener("wheel", (event) => {
    if (document.activeElement !== canvas) return; // scroll the page
    zoom(event.deltaY < 0 ? 1.15 : 1 / 1.15);
    event.preventDefault();
  });
  form.addEventListener("click", (event) => {
    if (event.target.dataset.key) KEYS[event.target.dataset.key]();
  });
  form.addEventListener("change", choose);
  form.addEventListener("submit", (event) => event.preventDefault());
  for (const moment of ["resize", "beforeprint", "afterprint"]) window.addEventListener(moment, draw);
  document.getElementById("viewer").hidden = false;
  choose();
})();
