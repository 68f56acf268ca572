/* What is seen of a plot as a file: its points as CSV, and a picture as SVG or PNG, black on white, with its legend. */

const FONT = "system-ui, -apple-system, 'Segoe UI', Roboto, 'DejaVu Sans', sans-serif";
const HEADING = 26, ENTRY = 18, LETTER = 6.8, SWATCH = 40, SHARP = 2; // pixels, and pixels of a PNG for each

/* A cell of a table: text that a spreadsheet takes for a formula begins with an apostrophe. */
function cell(word) {
  const safe = /^[=+\-@\t\r]/.test(word) ? `'${word}` : word;
  return /[",\n\r]/.test(safe) ? `"${safe.replace(/"/g, '""')}"` : safe;
}
/* A number with the digits that its array has. */
const digitsOf = (values, k) => (!Number.isFinite(values[k]) ? "" : values instanceof Float32Array ? String(Number(values[k].toPrecision(8))) : String(values[k]));

/* The points of what is seen of a chart as a table: a row for each time that a line has a point at. */
function tableOf(chart) {
  const columns = [], rows = new Map(), across = chart.data.panels[0].across || "time [s]";
  for (const own of chart.panels) {
    const unit = (/\[[^\]]*\]$/.exec(own.panel.label) || [""])[0];
    for (const line of own.lines) {
      if (line.spans[0] || line.spans[1] || (line.marker === "." && !Number.isInteger(line.entry))) continue; // dots are of lines
      const entry = chart.data.legend[line.of ?? line.entry], name = entry ? `${entry.text}${own.panel.less || ""} ${unit}` : own.panel.label;
      const title = [chart.data.panels.length > 1 && own.panel.title, name, line.beside && "(kept)", Number.isInteger(line.entry) || !entry ? null : line.width ? "(beside)" : "(marks)"].filter(Boolean).join(" ").trim();
      for (let k = 0; k < line.x.length; k++) {
        const time = line.x[k];
        if (!(time >= own.span[0] && time <= own.span[1])) continue;
        if (!rows.has(time)) rows.set(time, []);
        const row = rows.get(time), isGap = Number.isNaN(line.y[k]) && row[columns.length] !== undefined;
        if (!isGap) row[columns.length] = digitsOf(line.y, k);
      }
      columns.push(title);
    }
  }
  const times = [...rows.keys()].sort((a, b) => a - b), line = (time) => [time, ...columns.map((_, k) => rows.get(time)[k] ?? "")].join(",");
  return [[across, ...columns].map(cell).join(","), ...times.map(line), ""].join("\r\n");
}

/* Colours of the light page for those that its theme names. */
function plain(value) {
  const root = [...document.styleSheets[0].cssRules].find((rule) => rule.selectorText === ":root").style;
  return value.replace(/^color-mix\(in srgb, (#\w+), .*$/, "$1").replace(/var\((--[\w-]+)\)/g, (_, name) => root.getPropertyValue(name).trim());
}

/* What is seen of a chart as an SVG of its own. */
function pictureOf(chart) {
  const shown = chart.data.legend.flatMap((entry, k) => (chart.hidden.has(k) ? [] : [entry]));
  const place = shown.reduce((all, { text: word }) => {
    const wide = SWATCH + LETTER * word.length + 16, last = all[all.length - 1];
    const fits = last && last.x + last.wide + wide <= chart.width;
    return [...all, fits ? { x: last.x + last.wide, row: last.row, wide } : { x: 8, row: last ? last.row + 1 : 0, wide }];
  }, []);
  const below = HEADING + chart.height, height = below + (shown.length ? (place[place.length - 1].row + 1) * ENTRY + 8 : 0);
  const svg = made("svg", { xmlns: SVG, viewBox: `0 0 ${chart.width} ${height}`, width: chart.width, height, "font-family": FONT, "font-size": 12 });
  made("rect", { width: chart.width, height, fill: PAPER }, svg);
  made("text", { x: 8, y: 18, fill: INK, "font-size": 14 }, svg).textContent = chart.title;
  const drawn = made("g", { transform: `translate(0 ${HEADING})` }, svg);
  drawn.append(...[...chart.svg.childNodes].map((node) => node.cloneNode(true)));
  shown.forEach((entry, k) => {
    const { x, row } = place[k], item = made("g", { transform: `translate(${x} ${below + row * ENTRY})` }, svg);
    chart.swatch(entry, item);
    made("text", { x: 36, y: 10, fill: INK }, item).textContent = entry.text;
  });
  for (const node of svg.querySelectorAll("*")) {
    for (const name of ["fill", "stroke"]) if (node.hasAttribute(name)) node.setAttribute(name, plain(node.getAttribute(name)));
  }
  return { svg: new XMLSerializer().serializeToString(svg), width: chart.width, height };
}

function save(blob, name) {
  const link = Object.assign(document.createElement("a"), { href: URL.createObjectURL(blob), download: name });
  document.body.append(link);
  link.click();
  link.remove();
  setTimeout(() => URL.revokeObjectURL(link.href), 10000);
}

async function savePicture({ svg, width, height }, name) {
  const image = new Image(), canvas = Object.assign(document.createElement("canvas"), { width: SHARP * width, height: SHARP * height });
  image.src = `data:image/svg+xml;charset=utf-8,${encodeURIComponent(svg)}`;
  await image.decode();
  canvas.getContext("2d").drawImage(image, 0, 0, canvas.width, canvas.height);
  canvas.toBlob((blob) => save(blob, name), "image/png");
}

/* The curves of a picture as a table: two columns for each, what it is over and what it is; those that share what they
   are over share its column. */
function tableOfCurves(curves) {
  const [{ x: first, across: over }] = curves, shared = curves.length > 1 && curves.every(({ x, across }) => x === first && across === over);
  const columns = curves.flatMap(({ name, across, label, x, y }) => (
    shared ? [[`${name}: ${label}`, y]] : [[`${name}: ${across}`, x], [`${name}: ${label}`, y]]));
  if (shared) columns.unshift([over, first]);
  const rows = Array.from({ length: Math.max(...columns.map(([, values]) => values.length)) }, (_, k) => (
    columns.map(([, values]) => (k < values.length ? digitsOf(values, k) : "")).join(",")));
  return [columns.map(([head]) => cell(head)).join(","), ...rows, ""].join("\r\n");
}

/* A button with words for those who do not see it. */
function toolOf(word, label, act) {
  const one = Object.assign(document.createElement("button"), { type: "button", textContent: word, title: label });
  one.setAttribute("aria-label", label);
  one.addEventListener("click", act);
  return one;
}
const fileOf = (title, kind) => `${title.replace(/[^\p{L}\p{N}]+/gu, "_").slice(0, 80)}.${kind}`;

/* The row below a picture, with a file of its numbers. */
function saveable(figure, { curves, name }) {
  const row = Object.assign(document.createElement("p"), { className: "tools" }), heading = figure.closest("section")?.querySelector("h1, h2");
  const title = [heading?.textContent, name].filter(Boolean).join(": ");
  row.append(toolOf("CSV", `Save ${name} as CSV`, () => save(new Blob([tableOfCurves(curves)], { type: "text/csv" }), fileOf(title, "csv"))));
  figure.append(row);
}

/* The row below a chart: which span is seen, the way back to all of it, and files of what is seen. */
class Tools {
  constructor(chart) {
    this.chart = chart;
    const row = document.createElement("p");
    row.className = "tools";
    this.span = Object.assign(document.createElement("span"), { className: "span" });
    this.span.setAttribute("role", "status");
    this.back = toolOf("all of it", "See all of it", () => chart.cursor.look(null));
    this.back.hidden = true;
    const file = (kind) => fileOf(chart.title, kind), name = chart.data.name;
    row.append(this.span, this.back,
      toolOf("CSV", `Save ${name} as CSV`, () => this.made(() => save(new Blob([tableOf(chart)], { type: "text/csv" }), file("csv")))),
      toolOf("SVG", `Save ${name} as SVG`, () => this.made(() => save(new Blob([pictureOf(chart).svg], { type: "image/svg+xml" }), file("svg")))),
      toolOf("PNG", `Save ${name} as PNG`, () => this.made(() => savePicture(pictureOf(chart), file("png")))));
    chart.box.after(row);
    this.tell();
  }
  made(act) {
    if (!this.chart.seen) this.chart.draw();
    act();
  }
  tell() {
    const { span } = this.chart.cursor, { label, factor } = span ? scaled("time [s]", ...span) : {};
    const digits = span && Math.min(12, Math.max(3, 2 - Math.floor(Math.log10((span[1] - span[0]) / Math.max(Math.abs(span[0]), Math.abs(span[1]))))));
    this.span.textContent = span ? `${text(span[0] * factor, digits)} to ${text(span[1] * factor, digits)} ${/\[(.*)\]/.exec(label)[1]}` : "";
    this.back.hidden = !span;
  }
}
