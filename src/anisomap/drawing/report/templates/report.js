"use strict";

(function sortableTable() {
  const table = document.getElementById("sensors");
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
  const pieces = JSON.parse(source.textContent);
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

  function traces(piece, wanted) {
    const map = { ...piece.traces.map };
    map.marker = { ...map.marker, ...piece.colours[wanted.colour] };
    if (wanted.names) Object.assign(map, { mode: "markers+text", text: piece.names });
    const drawn = [];
    if (wanted.neighbours) drawn.push(piece.traces.neighbours);
    if (wanted.truth && wanted.neighbours) drawn.push(piece.traces["true-neighbours"]);
    if (wanted.errors) drawn.push(piece.traces.errors);
    if (wanted.truth) drawn.push(piece.traces.truth);
    return [...drawn, map, piece.traces.ailing].filter(Boolean);
  }

  function draw() {
    const form = controls.elements;
    const on = (name) => Boolean(form[name] && form[name].checked);
    const piece = pieces[Number(form.piece.value)];
    for (const name of ["truth", "errors"]) if (form[name]) form[name].disabled = !piece.traces[name];
    const colour = form.colour.value in piece.colours ? form.colour.value : "place";
    const wanted = { colour, neighbours: on("neighbours"), names: on("names"), truth: on("truth"), errors: on("errors") };
    document.getElementById("legend-place").hidden = colour !== "place";
    document.getElementById("legend-health").hidden = colour !== "health";
    // plotly offers to upload charts to its makers unless it is told not to.
    const config = { responsive: true, displaylogo: false, scrollZoom: true, showSendToCloud: false, plotlyServerURL: "" };
    return Plotly.react(view, traces(piece, wanted), piece.layout, config);
  }

  if (pieces.some((piece) => piece.layout.scene) && !hasWebGL()) {
    giveUp();
    return;
  }
  controls.addEventListener("change", draw);
  controls.addEventListener("submit", (event) => event.preventDefault());
  draw().catch(giveUp);
})();
