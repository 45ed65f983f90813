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

(function interactiveView() {
  const source = document.getElementById("scene");
  if (!source) return;
  const components = JSON.parse(source.textContent);
  const view = document.getElementById("view");
  const controls = document.getElementById("controls");

  function giveUp() {
    document.getElementById("viewer").hidden = true;
    document.getElementById("no-view").hidden = false;
  }

  function hasWebGL() {
    const canvas = document.createElement("canvas");
    return Boolean(canvas.getContext("webgl2") || canvas.getContext("webgl"));
  }

  function traces(component, wanted) {
    const map = { ...component.traces.map };
    map.marker = { ...map.marker, ...component.colours[wanted.colour] };
    if (wanted.names) Object.assign(map, { mode: "markers+text", text: component.names });
    const drawn = [];
    if (wanted.neighbours) drawn.push(component.traces.neighbours);
    if (wanted.truth && wanted.neighbours) drawn.push(component.traces["true-neighbours"]);
    if (wanted.ellipses) drawn.push(component.traces.ellipses);
    if (wanted.errors) drawn.push(component.traces.errors);
    if (wanted.truth) drawn.push(component.traces.truth);
    return [...drawn, map, component.traces.faulty].filter(Boolean);
  }

  function draw() {
    const form = controls.elements;
    const on = (name) => Boolean(form[name] && form[name].checked);
    const component = components[Number(form.component.value)];
    for (const name of ["truth", "errors", "ellipses"]) if (form[name]) form[name].disabled = !component.traces[name];
    const colour = form.colour.value in component.colours ? form.colour.value : "place";
    const wanted = { colour, neighbours: on("neighbours"), names: on("names"), ellipses: on("ellipses"), truth: on("truth"), errors: on("errors") };
    document.getElementById("legend-place").hidden = colour !== "place";
    document.getElementById("legend-health").hidden = colour !== "health";
    // Disable the upload of charts that plotly offers by default.
    const config = { responsive: true, displaylogo: false, scrollZoom: true, showSendToCloud: false, plotlyServerURL: "" };
    return Plotly.react(view, traces(component, wanted), component.layout, config);
  }

  if (components.some((component) => component.layout.scene) && !hasWebGL()) {
    giveUp();
    return;
  }
  // The camera is at a distance at which the height of the view shows the whole box.
  const narrow = Math.max(1, view.clientHeight / view.clientWidth);
  for (const { layout } of components) {
    const eye = layout.scene ? layout.scene.camera.eye : {};
    for (const axis of Object.keys(eye)) eye[axis] *= narrow;
  }
  controls.addEventListener("change", draw);
  controls.addEventListener("submit", (event) => event.preventDefault());
  draw().catch(giveUp);
})();
