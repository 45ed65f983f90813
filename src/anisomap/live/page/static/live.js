// The page of a live session: shows what the server sends, and posts what the user does.
// Text from the session is set as text content only, never as HTML.

import { COLOURS, Raster, drawCurves } from "./charts.js";
import { MapView } from "./map_view.js";

const $ = (id) => document.getElementById(id);
const view = new MapView($("map"));
const raster = new Raster($("raster"));
let map = null, status = null, showsChecked = false;

// The view and the selection survive a reload.
const KEPT = ["turn", "tilt", "zoom", "named", "layout", "wanted"];
try {
  const kept = JSON.parse(sessionStorage.getItem("view") || "{}");
  showsChecked = Boolean(kept.showsChecked);
  for (const key of KEPT) if (key in kept) view[key] = kept[key];
} catch { /* a stored view of another version */ }
window.addEventListener("pagehide", () => {
  const kept = Object.fromEntries(KEPT.map((key) => [key, view[key]]));
  sessionStorage.setItem("view", JSON.stringify({ ...kept, showsChecked }));
});

function decoded(text, Type) {
  const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  return new Type(bytes.buffer);
}

function showMap() {
  if (!map) return;
  const checked = map.checked && (showsChecked || map.final);
  view.update(checked
    ? { ...map, positions: map.checked, halo: map.checked_halo, dimensions: map.checked_dimensions } : map);
  const kind = map.reason || (checked
    ? `${map.final ? "final" : "checked"} map, by the full method`
    : `quick map of ${map.frames} frames`);
  const waiting = view.countUnplaced();
  $("which").textContent = kind + (waiting ? `; ${waiting} sensor${waiting > 1 ? "s" : ""} unplaced` : "");
  $("show").lastChild.textContent = showsChecked ? " show quick map" : " show checked map";
  $("show").disabled = !map.checked || map.final;
  $("layout").disabled = !view.stated;
  $("names").ariaPressed = view.named;
  $("layout").ariaPressed = view.layout;
  $("layout-key").hidden = !view.stated || !view.layout;
}

function showStatus() {
  $("verdict").dataset.level = status.level;
  $("level").textContent = status.told;
  $("error").textContent = status.error;
  $("reason").textContent = status.reason;
  $("checked").textContent = status.checked_frames
    ? `map of ${status.checked_frames} frames${status.examining ? "; the next is being made" : ""}` : "";
  $("source").textContent = status.recording
    ? `${status.source}, recorded in ${status.recording}` : status.source;
  $("rate").textContent = status.rate_hz ? `${status.rate_hz.toFixed(status.rate_hz < 10 ? 1 : 0)} Hz` : "–";
  $("touched").textContent = map ? `${Math.round(100 * status.share_touched)}% of ${status.sensors}` : "–";
  $("age").textContent = map ? `${status.map_age.toFixed(1)} s${status.lags ? ": lags, all is recorded" : ""}` : "–";
  $("age").className = status.lags ? "alert" : "";
  $("state").textContent = status.state;
  $("frames").textContent = status.frames;
  $("seconds").textContent = `${status.seconds.toFixed(1)} s`;
  document.body.dataset.state = status.state;
  $("coach").textContent = status.advice;
  $("coach").className = status.enough ? "enough" : "";
  $("faulty").textContent = status.faulty.length
    ? `faulty: ${status.faulty.map((s) => `${s.name} (${s.status})`).join(", ")}` : "no faulty sensor";
  $("dropped").textContent = status.dropped.length ? `left out: ${status.dropped.join(", ")}` : "";
  $("pause").lastChild.textContent = status.state === "paused" ? " go on" : " pause";
  $("key-truth").hidden = !status.has_truth;
  view.faulty = new Set(status.faulty.map((sensor) => sensor.name));
  $("notices").replaceChildren(...status.notices.slice(-30).reverse().map(([seconds, text]) => {
    const item = document.createElement("li");
    item.textContent = `${seconds} s: ${text}`;
    return item;
  }));
  raster.gaps = status.gaps;
  const points = (column) => status.curve.map((row) => [row[0], row[column]]);
  const end = status.seconds;
  drawCurves($("errors"), [{ points: points(1) }, { points: points(2), dashed: true }], { rule: status.spacing, end });
  $("unit").textContent = status.unit;
  drawCurves($("shares"), [{ points: status.touched }], { top: 1, unit: "%", end });
  showSelected();
}

function showSelected() {
  const i = view.selected;
  $("trace").hidden = !map || i < 0;
  if (!map || i < 0) {
    $("selected").textContent = "no sensor selected: click one, or press ← →";
    return;
  }
  const fault = status && status.faulty.find((sensor) => sensor.name === map.names[i]);
  $("selected").textContent = `selected: ${map.names[i]}, ${map.contacts[i]} contacts`
    + (fault ? `, ${fault.status}: ${fault.reason}` : "");
}

function takeMap(data) {
  map = data;
  map.pairs = decoded(map.pairs, Uint32Array);
  for (const key of ["positions", "checked", "stated", "halo", "checked_halo"]) {
    map[key] = map[key] && decoded(map[key], Float32Array);
  }
  showMap();
  showSelected();
}

// The page that is written at the end holds its data, and needs no session.
function showEnd(shown) {
  if (shown.map) takeMap(shown.map);
  status = shown.status;
  showStatus();
  listFiles(shown.files);
}

function connect() {
  navigator.serviceWorker?.register("/keep.js").catch(() => {});
  const events = new EventSource("/events");
  events.addEventListener("map", (event) => takeMap(JSON.parse(event.data)));
  events.addEventListener("readings", (event) => {
    const { frames, seconds, levels } = JSON.parse(event.data);
    view.levels = decoded(levels, Uint8Array);
    raster.add(seconds, view.levels);
    $("frames").textContent = frames;
    $("seconds").textContent = `${seconds.toFixed(1)} s`;
  });
  events.addEventListener("status", (event) => {
    status = JSON.parse(event.data);
    showStatus();
  });
  events.addEventListener("end", keep);
  events.addEventListener("open", () => { $("disconnected").hidden = true; });
  events.addEventListener("error", () => {
    $("state").textContent = "closed";
    document.body.dataset.state = "ended";
    $("disconnected").hidden = false;
    $("files").replaceChildren(); // the links need the session
    $("disconnected").textContent = status?.page
      ? `The session is over. Its page is ${status.page}.` : "The session cannot be reached.";
  });
}

// What `keep.js` shows after the session. Browsers refuse it on other computers than this one.
async function keep() {
  const page = await (await fetch("/end")).text();
  const kept = await self.caches?.open("end");
  await kept?.put("/end", new Response(page, { headers: { "Content-Type": "text/html; charset=utf-8" } }));
}

async function act(request) {
  $("answer").className = "";
  $("answer").textContent = "…";
  let done;
  try {
    const answer = await fetch("/act", {
      method: "POST",
      headers: { "Content-Type": "application/json", "X-Anisomap": "1" },
      body: JSON.stringify(request),
    });
    done = answer.ok ? await answer.json() : { ok: false, text: await answer.text() };
  } catch {
    done = { ok: false, text: "the session does not answer" };
  }
  $("answer").className = done.ok ? "" : "failed";
  $("answer").textContent = done.text;
  listFiles(done.files || []);
}

function listFiles(files) {
  for (const file of files) {
    const item = document.createElement("li"), link = document.createElement("a");
    link.href = file.url;
    if (file.url.startsWith("/")) link.download = file.name;
    link.textContent = file.name;
    item.append(link);
    $("files").append(item);
  }
}

function dropSelected() {
  if (view.selected < 0 || !map) {
    $("answer").textContent = "select a sensor first";
    return;
  }
  const name = map.names[view.selected], dropped = new Set(status.dropped);
  if (!dropped.delete(name)) dropped.add(name);
  act({ do: "drop", sensors: [...dropped] });
}

const BUTTONS = {
  p: ["pause", () => act({ do: "pause", on: status?.state !== "paused" })],
  r: ["restart", () => confirm("Begin a new recording and a new map? The recording so far is kept.") && act({ do: "restart" })],
  d: ["drop", dropSelected],
  n: ["names", () => { view.named = !view.named; showMap(); }],
  l: ["layout", () => { view.layout = !view.layout; showMap(); }],
  m: ["show", () => { showsChecked = !showsChecked; showMap(); }],
  s: ["save", () => act({ do: "save" })],
  q: ["end", () => confirm("End the session and make the final map?") && act({ do: "end" })],
};
for (const [id, run] of Object.values(BUTTONS)) $(id).addEventListener("click", run);
$("map").addEventListener("selected", showSelected);

function step(direction) {
  const count = map ? map.names.length : 0;
  for (let i = 1; i <= count; i++) {
    const next = (view.selected + direction * i + 2 * count) % count;
    if (!view.leftOut.has(next)) return view.select(next);
  }
}

const TURNS = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, -0.1], ArrowDown: [0, 0.1] };
document.addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
  if (event.shiftKey && TURNS[key]) view.turnBy(...TURNS[key]);
  else if (key === "ArrowLeft" || key === "ArrowRight") step(key === "ArrowLeft" ? -1 : 1);
  else if (key === "+" || key === "=") view.zoomBy(1.2);
  else if (key === "-") view.zoomBy(1 / 1.2);
  else if (key === "0") view.reset();
  else if (BUTTONS[key] && $(BUTTONS[key][0]).offsetParent) BUTTONS[key][1]();
  else return;
  event.preventDefault();
});

const ramp = $("ramp").getContext("2d");
COLOURS.forEach((colour, level) => {
  ramp.fillStyle = colour;
  ramp.fillRect(level * 120 / 256, 0, 1, 12);
});

let drawnAt = performance.now(), rasterAt = 0;
function draw(now) {
  view.move(now - drawnAt);
  view.draw();
  if (now - rasterAt > 100) {
    raster.draw();
    if (view.selected >= 0) raster.drawTrace($("trace"), view.selected);
    rasterAt = now;
  }
  drawnAt = now;
  requestAnimationFrame(draw);
}
const atEnd = $("end-of-session");
if (atEnd) showEnd(JSON.parse(atEnd.textContent));
else connect();
requestAnimationFrame(draw);
