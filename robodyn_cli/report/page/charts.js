/* Plots over time: panels as report/page/charts.py read them off the figures, with a cursor at the time that is shown. */

const LEFT = 58, RIGHT = 12, TOP = 32, BOTTOM = 22, LAST = 40; // rooms around a panel [pixels]
const READ = 6; // digits at the cursor; arrays have seven
/* Corners of marks, over their size; other marks are circles. */
const MARKERS = {
  s: [[-1, -1], [1, -1], [1, 1], [-1, 1]], D: [[0, -1.3], [1.3, 0], [0, 1.3], [-1.3, 0]],
  "^": [[0, -1.2], [1.2, 1], [-1.2, 1]], v: [[0, 1.2], [1.2, -1], [-1.2, -1]],
};

/* Round numbers between two ends, or powers of ten on a logarithmic axis. */
function ticks(low, high, log, most) {
  if (log) {
    const first = Math.ceil(Math.log10(low) - 1e-9), last = Math.floor(Math.log10(high) + 1e-9);
    const step = Math.max(1, Math.ceil((last - first + 1) / most));
    const powers = [];
    for (let k = first; k <= last; k += step) powers.push(10 ** k);
    return powers.length > 1 ? powers : [low, Math.sqrt(low * high), high].map((x) => Number(x.toPrecision(2)));
  }
  const raw = (high - low) / most, power = 10 ** Math.floor(Math.log10(raw));
  const step = power * [1, 2, 5, 10].find((s) => s * power >= raw * (1 - 1e-9));
  return marks(low - 1e-9 * step, high + 1e-9 * step, step).map((x) => Number(x.toPrecision(12)));
}

/* Ticks with their numbers, of as many digits as tell them apart. */
function numbered(low, high, log, most) {
  const values = ticks(low, high, log, most), place = (x) => Math.floor(Math.log10(Math.abs(x)) + 1e-9);
  const digits = log || values.length < 2 ? 4 : 1 + place(Math.max(...values.map(Math.abs))) - place(values[1] - values[0]);
  return values.map((value) => [value, text(value, Math.min(12, Math.max(4, digits))).replace(/^1·/, "")]);
}
const upright = (panel, high) => numbered(...panel.y, panel.log, Math.max(3, Math.floor(high / 32)));

let panelsMade = 0; // the names of their clips are unique on the page

class Chart {
  constructor(figure, data, player) {
    this.figure = figure;
    this.data = data;
    this.player = player;
    this.box = figure.querySelector(".chart");
    this.time = null;
    this.hovered = null; // panel whose values the legend shows
    this.legend();
    this.seen = false;
    // plots far down the page are drawn when they come near
    new IntersectionObserver((entries) => {
      if (entries.some((entry) => entry.isIntersecting)) this.draw();
    }, { rootMargin: "600px" }).observe(this.box);
    new ResizeObserver(() => { if (this.seen && this.box.clientWidth !== this.width) this.draw(); }).observe(this.box);
    if (player) player.listeners.push((time) => this.show(time));
  }

  legend() {
    this.values = [];
    if (!this.data.legend.length) return;
    const list = document.createElement("ul");
    list.className = "legend";
    this.data.legend.forEach((entry) => {
      const item = document.createElement("li"), swatch = made("svg", { viewBox: "0 0 30 12", "aria-hidden": "true" });
      this.swatch(entry, swatch);
      const value = document.createElement("span");
      item.append(swatch, document.createTextNode(` ${entry.text} `), value);
      list.append(item);
      this.values.push(value);
    });
    this.box.before(list);
  }
  swatch(entry, svg) {
    if (entry.band) made("rect", { width: 30, height: 12, fill: inked(entry.colour), opacity: 0.3 }, svg);
    else if (entry.width) this.stroke(entry, "M1 6H29", svg);
    if (entry.marker) made("path", { d: this.marker(entry.marker, 15, 6), ...this.filled(entry) }, svg);
  }

  // -- drawing --------------------------------------------------------------------------------------------------
  draw() {
    this.seen = true;
    this.width = Math.max(260, this.box.clientWidth);
    const across = this.data.panels.length > 3 && this.width > 620 ? 2 : 1, wide = this.width / across;
    const rows = Math.ceil(this.data.panels.length / across), high = rows === 1 ? 230 : rows === 2 ? 170 : 140;
    const longest = Math.max(0, ...this.data.panels.flatMap((panel) => upright(panel, high).map(([, word]) => word.length)));
    this.left = Math.max(LEFT, 12 + 7 * longest);
    this.svg?.remove();
    this.over?.remove();
    const height = rows * (high + TOP + BOTTOM) + LAST - BOTTOM;
    this.svg = made("svg", { viewBox: `0 0 ${this.width} ${height}`, role: "img", "aria-label": `${this.data.name} over ${this.data.over || "time"}` }, this.box);
    // what moves lies above on a layer of its own, so that the lines are painted once
    this.over = made("svg", { viewBox: `0 0 ${this.width} ${height}`, class: "over", "aria-hidden": "true" }, this.box);
    this.panels = this.data.panels.map((panel, k) => {
      const row = Math.floor(k / across), box = {
        left: (k % across) * wide + this.left, right: (k % across + 1) * wide - RIGHT,
        top: row * (high + TOP + BOTTOM) + TOP, bottom: row * (high + TOP + BOTTOM) + TOP + high,
      };
      return this.panel(panel, box, k + across >= this.data.panels.length);
    });
    this.pointer();
    if (this.player) this.show(this.player.view.time);
  }

  panel(panel, box, last) {
    const [x0, x1] = panel.x, [y0, y1] = panel.log ? panel.y.map(Math.log10) : panel.y;
    const x = (t) => box.left + (t - x0) / (x1 - x0) * (box.right - box.left);
    const y = (v) => {
      const value = panel.log ? (v > 0 ? Math.log10(v) : NaN) : v;
      return box.bottom - (value - y0) / (y1 - y0) * (box.bottom - box.top);
    };
    const clip = `clip-${panelsMade += 1}`, size = { x: box.left, y: box.top, width: box.right - box.left, height: box.bottom - box.top };
    made("rect", size, made("clipPath", { id: clip }, this.svg));
    this.scales(panel, box, x, y, last);
    const inside = made("g", { "clip-path": `url(#${clip})` }, this.svg);
    for (const error of panel.errors) {
      const corners = Array.from(error.x, (t, k) => [x(t), y(error.y[k])]);
      made("path", { d: path(corners), fill: inked(error.colour), opacity: error.alpha }, inside);
    }
    for (const band of panel.bands) this.band(band, box, x, y, inside, clip);
    const outside = made("g", {}, this.svg);
    for (const line of panel.lines) this.line(line, box, x, y, inside, outside);
    for (const note of panel.notes) {
      made("text", { x: round(x(note.x)) - 6, y: round(y(note.y)) - 8, class: "note end", fill: inked(note.colour) }, this.svg).textContent = note.text;
    }
    const cursor = made("line", { class: "cursor", y1: box.top, y2: box.bottom, visibility: "hidden" }, this.over);
    const readout = made("text", { x: box.right, y: box.top - 14, class: "end value" }, this.over);
    return { panel, box, x, y, cursor, readout, from: (px) => x0 + (px - box.left) / (box.right - box.left) * (x1 - x0) };
  }

  /* A band of good values, or the hatched part of a panel that says nothing; edges beyond the panel are clipped. */
  band(band, box, x, y, parent, clip) {
    const [left, right, top, bottom] = [x(band.left), x(band.right), y(band.high), y(band.low)].map((place, k) => (
      Number.isFinite(place) ? place : [box.left, box.right, box.top, box.bottom][k]));
    const size = { x: left, width: Math.max(0, right - left), y: top, height: Math.max(0, bottom - top) };
    if (band.hatched) {
      const across = { id: `${clip}-hatch`, width: 9, height: 9, patternUnits: "userSpaceOnUse", patternTransform: "rotate(45)" };
      made("path", { d: "M0 0V9", stroke: inked(band.colour), "stroke-width": 1.6 }, made("pattern", across, this.svg));
    }
    made("rect", { ...size, fill: band.hatched ? `url(#${clip}-hatch)` : inked(band.colour), opacity: band.alpha }, parent);
  }

  /* Axes with their numbers and units; the label stands above, so that phones have room. */
  scales(panel, box, x, y, last) {
    for (const [value, word] of upright(panel, box.bottom - box.top)) {
      if (!Number.isFinite(y(value))) continue;
      made("line", { class: "rule", x1: box.left, x2: box.right, y1: round(y(value)), y2: round(y(value)) }, this.svg);
      made("text", { class: "end", x: box.left - 6, y: round(y(value)) + 4 }, this.svg).textContent = word;
    }
    for (const [value, word] of numbered(...panel.x, false, Math.max(3, Math.floor((box.right - box.left) / 62)))) {
      made("line", { class: "rule", x1: round(x(value)), x2: round(x(value)), y1: box.top, y2: box.bottom }, this.svg);
      const middle = Math.min(x(value), this.width - 3.6 * word.length);
      made("text", { class: "middle", x: round(middle), y: box.bottom + 16 }, this.svg).textContent = word;
    }
    made("path", { class: "frame", d: `M${box.left} ${box.top}V${box.bottom}H${box.right}` }, this.svg);
    const label = [panel.title, panel.label].filter((word) => word).join(": ");
    made("text", { x: box.left - this.left + 4, y: box.top - 14, class: "label" }, this.svg).textContent = label;
    if (last) made("text", { x: (box.left + box.right) / 2, y: box.bottom + 33, class: "middle" }, this.svg).textContent = panel.across || "time [s]";
  }

  line(line, box, x, y, inside, outside) {
    const px = line.spans[0] ? (u) => box.left + u * (box.right - box.left) : x;
    const py = line.spans[1] ? (u) => box.bottom - u * (box.bottom - box.top) : y;
    const points = Array.from(line.x, (t, k) => [px(t), py(line.y[k])]);
    if (line.width) this.stroke(line, path(points), inside);
    if (!line.marker) return;
    const near = points.filter((p) => isPlace(p) && p[0] >= box.left - 1 && p[0] <= box.right + 1);
    made("path", { d: near.map((p) => this.marker(line.marker, ...p)).join(""), ...this.filled(line) }, outside);
  }
  stroke(look, d, parent) {
    const dash = look.dashes.map((x) => round(x * 1.25)).join(" ") || "none";
    if (d) made("path", { d, fill: "none", stroke: inked(look.colour), "stroke-width": round(Math.max(0.8, look.width)), "stroke-dasharray": dash, opacity: look.alpha ?? 1, "stroke-linejoin": "round" }, parent);
  }
  filled(look) {
    return { fill: look.fill === "#ffffff" ? PAPER : inked(look.fill || look.colour), stroke: inked(look.colour), "stroke-width": 1.2 };
  }
  marker(kind, x, y, r = 3.6) {
    return kind in MARKERS ? path(MARKERS[kind].map(([a, b]) => [x + a * r, y + b * r]), true) : circle([x, y], r);
  }

  // -- the cursor -----------------------------------------------------------------------------------------------
  show(time) {
    this.time = time;
    if (!this.seen) return;
    for (const panel of this.panels) {
      const inside = time >= panel.panel.x[0] && time <= panel.panel.x[1], px = round(panel.x(time));
      panel.cursor.setAttribute("visibility", inside ? "visible" : "hidden");
      panel.cursor.setAttribute("x1", px);
      panel.cursor.setAttribute("x2", px);
    }
    this.read();
  }

  /* Write the values at the cursor beside the names in the legend, or above a panel without one. */
  read() {
    const told = this.values.map(() => "");
    const order = this.hovered === null ? this.panels : [this.panels[this.hovered], ...this.panels];
    for (const { panel } of order) {
      for (const line of this.curves(panel)) {
        if (line.entry !== null && line.entry !== undefined && told[line.entry] === "") told[line.entry] = text(this.value(line), READ);
      }
    }
    this.values.forEach((output, k) => { output.textContent = told[k]; });
    if (this.values.length) return;
    for (const { panel, readout } of this.panels) readout.textContent = this.curves(panel).slice(-1).map((line) => text(this.value(line), READ)).join("");
  }
  curves(panel) { return panel.lines.filter((line) => line.width && !line.spans[0] && !line.spans[1] && line.x.length > 1); }
  /* Value of a line at the cursor, between its points in proportion. */
  value(line) {
    const k = countUpTo(line.x, this.time);
    if (k === 0) return NaN;
    if (k === line.x.length) return this.time <= line.x[k - 1] * (1 + 1e-9) ? line.y[k - 1] : NaN;
    const part = (this.time - line.x[k - 1]) / (line.x[k] - line.x[k - 1]);
    return line.y[k - 1] + part * (line.y[k] - line.y[k - 1]);
  }

  pointer() {
    const go = (event) => {
      const box = this.svg.getBoundingClientRect(), ratio = this.width / box.width;
      const [px, py] = [(event.clientX - box.left) * ratio, (event.clientY - box.top) * ratio];
      const place = this.panels.findIndex(({ box: b }) => px >= b.left - 20 && px <= b.right + 20 && py >= b.top - 10 && py <= b.bottom + 10);
      if (place >= 0) this.hovered = place;
      return place >= 0 ? this.panels[place].from(px) : null;
    };
    const follow = (event) => {
      const time = go(event);
      if (time !== null && this.player) this.player.goTo(time);
    };
    let down = false;
    this.svg.addEventListener("pointerdown", (event) => { down = true; this.svg.setPointerCapture(event.pointerId); follow(event); });
    this.svg.addEventListener("pointermove", (event) => {
      if (down) follow(event);
      else if (go(event) !== null && this.time !== null) this.read();
    });
    for (const name of ["pointerup", "pointercancel"]) this.svg.addEventListener(name, () => { down = false; });
  }
}
