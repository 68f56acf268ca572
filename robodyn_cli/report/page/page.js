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
  return found;
}

function chartOf(data, arrays) {
  const drawn = (items) => items.map((item) => withArrays(item, arrays, ["x", "y"]));
  const panels = data.panels.map((panel) => ({ ...panel, lines: drawn(panel.lines), errors: drawn(panel.errors) }));
  return { ...data, panels };
}

function start() {
  const { arrays: packed, figures, live } = JSON.parse(document.getElementById("data").textContent);
  const arrays = packed.map(unpacked), charts = [], players = new Map();
  for (const section of document.querySelectorAll("[data-result]")) {
    let player = null;
    for (const figure of section.querySelectorAll("[data-figure]")) {
      const data = figures[Number(figure.dataset.figure)];
      if (data.panels) charts.push(new Chart(figure, chartOf(data, arrays), player));
      else player = new Player(figure, drawingOf(data, arrays));
    }
    players.set(section, player);
  }
  if (live) startLive(live, players);
  // on paper all plots are there, and the scene
  let folded = [];
  window.addEventListener("beforeprint", () => {
    for (const chart of charts) if (!chart.seen) chart.draw();
    folded = [...document.querySelectorAll(".scene-text:not([open])")];
    for (const one of folded) one.open = true;
  });
  window.addEventListener("afterprint", () => { for (const one of folded) one.open = false; });
  document.documentElement.dataset.ready = "yes";
}

start();
