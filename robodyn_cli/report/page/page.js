/* The page: its data are read, and each figure gets what draws it. */

const TYPES = { f4: Float32Array, f8: Float64Array };

function unpacked({ type, shape, data }) {
  const raw = atob(data), bytes = Uint8Array.from(raw, (c) => c.charCodeAt(0));
  return Object.assign(new TYPES[type](bytes.buffer), { shape });
}

/* Put arrays in the place of their numbers, which stand under these names. */
function withArrays(item, arrays, names) {
  const found = { ...item };
  for (const name of names) found[name] = arrays[item[name]];
  return found;
}

function drawingOf(data, arrays) {
  const found = withArrays(data, arrays, ["times", "vertices", "axes"]);
  found.arrows = data.arrows.map((arrow) => withArrays(arrow, arrays, ["force"]));
  found.parts = data.parts.map((part) => (part.surface ? { ...part, surface: withArrays(part.surface, arrays, ["points"]) } : part));
  found.shaped = new Set(data.parts.filter((part) => part.kind === "shape").map((part) => part.name));
  found.trails = data.trails.map((trail) => withArrays(trail, arrays, ["times", "points"]));
  const tracks = (list) => list && list.map((track) => (Array.isArray(track) ? arrays[track[0]] : track)), { vertices } = found;
  found.bodies = data.bodies.map((body) => ({
    ...body,
    torque: body.torque && { ...body.torque, values: arrays[body.torque.values[0]] },
    place: tracks(body.place) || [0, 1, 2].map((k) => ({ array: vertices, start: 3 * body.vertex + k, step: 3 * vertices.shape[1] })),
    attitude: tracks(body.attitude),
    speeds: tracks(body.speeds),
  }));
  return found;
}

function chartOf(data, arrays) {
  const drawn = (items) => items.map((item) => withArrays(item, arrays, ["x", "y"]));
  const panels = data.panels.map((panel) => ({ ...panel, lines: drawn(panel.lines), errors: drawn(panel.errors) }));
  return { ...data, panels };
}

/* Do something once, when what is folded is opened. */
function whenOpened(details, act) {
  details.addEventListener("toggle", act, { once: true });
}

function start() {
  const { arrays: packed, figures, live, several } = JSON.parse(document.getElementById("data").textContent);
  const arrays = packed.map(unpacked), cursors = new Map();
  for (const section of document.querySelectorAll("[data-result]")) {
    let cursor = new Cursor();
    for (const figure of section.querySelectorAll("[data-figure]")) {
      const data = figures[Number(figure.dataset.figure)];
      if (data.curves) saveable(figure, { ...data, curves: data.curves.map((curve) => withArrays(curve, arrays, ["x", "y"])) });
      else if (data.panels) new Chart(figure, chartOf(data, arrays), cursor);
      else if (figure.closest("details.drawing")) whenOpened(figure.parentNode, () => new Player(figure, drawingOf(data, arrays)));
      else cursor = new Cursor(new Player(figure, drawingOf(data, arrays)));
    }
    for (const svg of section.querySelectorAll("figure > .wide > svg.picture")) new Enlarged(svg.closest("figure"), svg.parentNode);
    cursors.set(section, cursor);
  }
  if (live) startLive(live, cursors);
  const beside = several ? new Several(several, arrays) : null;
  // on paper all plots are there, two on a page, and what is folded
  const printed = () => [...cursors.values(), beside?.cursor].filter(Boolean).flatMap((cursor) => cursor.charts);
  let folded = [];
  window.addEventListener("beforeprint", () => {
    for (const chart of printed()) {
      chart.paper = true;
      chart.draw();
    }
    folded = [...document.querySelectorAll("details:not([open]):not(.sweep, .drawing)")];
    for (const one of folded) one.open = true;
  });
  window.addEventListener("afterprint", () => {
    for (const one of folded) one.open = false;
    for (const chart of printed()) {
      chart.paper = false;
      chart.draw();
    }
  });
  document.documentElement.dataset.ready = "yes";
}

start();
