/* Plots over time: panels as report/page/charts.py read them off the figures, with a cursor at the time that is shown. */

const LEFT = 58, RIGHT = 12, TOP = 32, BOTTOM = 22, LAST = 40; // rooms around a panel [pixels]
const PAPER_WIDTH = 690, PAPER_HEIGHT = 300; // of a plot on paper: two go on a page
const READ = 6; // digits at the cursor; arrays have seven
const DOT = 1.2; // of samples that no line joins
/* Corners of marks, over their size; other marks are circles. */
const MARKERS = {
  s: [[-1, -1], [1, -1], [1, 1], [-1, 1]], D: [[0, -1.3], [1.3, 0], [0, 1.3], [-1.3, 0]],
  "^": [[0, -1.2], [1.2, 1], [-1.2, 1]], v: [[0, 1.2], [1.2, -1], [-1.2, -1]],
};
/* Looks as attributes, so that a plot that is saved has them too. */
const RULE = { stroke: "var(--rule)", "stroke-width": 0.7 }, FRAME = { fill: "none", stroke: "var(--grey)", "stroke-width": 0.9 };
const END = { "text-anchor": "end", fill: INK }, MIDDLE = { "text-anchor": "middle", fill: INK }, LABEL = { "font-size": 12.5, fill: INK };

let panelsMade = 0; // the names of their clips are unique on the page

class Chart {
  /* figure : its element. cursor : what it shares with other charts of its result. */
  constructor(figure, data, cursor) {
    Object.assign(this, { figure, data, cursor, time: cursor.time, box: figure.querySelector(".chart") });
    this.hovered = null; // panel whose values the legend shows
    this.hidden = new Set(); // entries of the legend whose lines are not drawn
    this.seen = false;
    this.legend();
    this.box.tabIndex = 0;
    this.box.setAttribute("role", "img");
    this.box.setAttribute("aria-label", `${data.name} over ${data.over || "time"}. ${data.over ? "" : KEYS}`);
    this.tools = new Tools(this);
    new Pointing(this);
    // plots far down the page are drawn when they come near
    new IntersectionObserver((entries) => {
      if (entries.some((entry) => entry.isIntersecting)) this.draw();
    }, { rootMargin: "600px" }).observe(this.box);
    new ResizeObserver(() => { if (this.seen && !this.paper && this.box.clientWidth !== this.width) this.draw(); }).observe(this.box);
    cursor.charts.push(this);
  }

  legend() {
    this.values = [];
    this.entries = [];
    if (!this.data.legend.length) return;
    const list = document.createElement("ul");
    list.className = "legend";
    this.data.legend.forEach((entry, k) => {
      const item = document.createElement("li"), button = document.createElement("button"), value = document.createElement("span");
      this.swatch(entry, made("svg", { viewBox: "0 0 30 12", "aria-hidden": "true" }, button));
      button.append(document.createTextNode(` ${entry.text}`));
      Object.assign(button, { type: "button", title: "Show or hide; with shift: this one alone" });
      button.setAttribute("aria-pressed", "true");
      button.addEventListener("click", (event) => this.toggle(k, event.shiftKey));
      item.append(button, " ", value);
      list.append(item);
      this.values.push(value);
      this.entries.push(button);
    });
    this.box.before(list);
  }
  /* Hide the lines of an entry of the legend, or show them again; alone : hide all others, or show all again. */
  toggle(k, alone) {
    const { hidden } = this, others = this.entries.map((_, n) => n).filter((n) => n !== k);
    if (alone) {
      const already = !hidden.has(k) && others.every((n) => hidden.has(n));
      this.hidden = new Set(already ? [] : others);
    } else if (!hidden.delete(k)) hidden.add(k);
    this.entries.forEach((button, n) => button.setAttribute("aria-pressed", String(!this.hidden.has(n))));
    this.changed();
  }
  /* What a file is called by. */
  get title() {
    const heading = this.figure.closest("section")?.querySelector("h1, h2");
    return [heading?.textContent, this.data.name].filter(Boolean).join(": ");
  }
  isShown(line) { return !this.hidden.has(line.of ?? line.entry); }
  /* Tell whether the band of an error is seen: the line that it is of has its colour. */
  isErrorShown(error) {
    const owners = this.data.legend.flatMap((entry, k) => (entry.colour === error.colour ? [k] : []));
    return !owners.length || owners.some((k) => !this.hidden.has(k));
  }
  swatch(entry, svg) {
    if (entry.band) made("rect", { width: 30, height: 12, fill: inked(entry.colour), opacity: 0.3 }, svg);
    else if (entry.width) this.stroke(entry, "M1 6H29", svg);
    if (entry.marker) made("path", { d: this.marker(entry.marker, 15, 6), ...this.filled(entry) }, svg);
  }

  // -- drawing --------------------------------------------------------------------------------------------------
  /* Draw anew what another span or other lines are seen of. */
  changed() {
    this.tools.tell();
    if (this.seen) this.draw();
  }
  draw() {
    this.seen = true;
    const { panels } = this.data;
    this.width = this.paper ? PAPER_WIDTH : Math.max(260, this.box.clientWidth);
    const across = panels.length > 3 && this.width > 620 ? 2 : 1, wide = this.width / across, rows = Math.ceil(panels.length / across);
    const usual = rows === 1 ? 230 : rows === 2 ? 170 : 140, most = PAPER_HEIGHT / rows - TOP - BOTTOM;
    const high = this.paper ? Math.max(70, Math.min(usual, most)) : usual, seen = panels.map((panel) => this.part(panel, high));
    const longest = Math.max(0, ...seen.flatMap((part) => part.upright.map(([, word]) => word.length)));
    this.left = Math.max(LEFT, 12 + 7 * longest);
    this.svg?.remove();
    this.over?.remove();
    this.height = rows * (high + TOP + BOTTOM) + LAST - BOTTOM;
    const size = { viewBox: `0 0 ${this.width} ${this.height}`, "aria-hidden": "true" };
    this.svg = made("svg", size, this.box);
    // what moves lies above on a layer of its own, so that the lines are painted once
    this.over = made("svg", { ...size, class: "over" }, this.box);
    this.panels = panels.map((panel, k) => {
      const row = Math.floor(k / across), box = {
        left: (k % across) * wide + this.left, right: (k % across + 1) * wide - RIGHT,
        top: row * (high + TOP + BOTTOM) + TOP, bottom: row * (high + TOP + BOTTOM) + TOP + high,
      };
      return this.panel(panel, seen[k], box, k + across >= panels.length);
    });
    if (this.time !== null) this.show(this.time);
  }

  /* What is seen of a panel: its times and values, its lines, and how its axes are written. */
  part(panel, high) {
    const lines = panel.lines.filter((line) => this.isShown(line)), span = overlap(panel.x, this.cursor.span);
    const whole = span[0] === panel.x[0] && span[1] === panel.x[1] && lines.length === panel.lines.length;
    const ends = uprightEnds(panel, lines, span, whole), { label, factor } = scaled(panel.label, ...ends, panel.log);
    const across = scaled(panel.across || "time [s]", ...span), most = Math.max(3, Math.floor(high / 32));
    const upright = panel.numbered === false ? [] : ruled(...ends, panel.log, most, factor);
    return { lines, span, ends, label, factor, across, upright };
  }

  panel(panel, part, box, last) {
    const [x0, x1] = part.span, [y0, y1] = panel.log ? part.ends.map(Math.log10) : part.ends;
    const x = (t) => box.left + (t - x0) / (x1 - x0) * (box.right - box.left);
    const y = (v) => {
      const value = panel.log ? (v > 0 ? Math.log10(v) : NaN) : v;
      return box.bottom - (value - y0) / (y1 - y0) * (box.bottom - box.top);
    };
    const clip = `clip-${panelsMade += 1}`, size = { x: box.left, y: box.top, width: box.right - box.left, height: box.bottom - box.top };
    made("rect", size, made("clipPath", { id: clip }, this.svg));
    this.scales(panel, part, box, x, y, last);
    const inside = made("g", { "clip-path": `url(#${clip})` }, this.svg);
    for (const error of panel.errors) {
      if (!this.isErrorShown(error)) continue;
      const corners = Array.from(error.x, (t, k) => [x(t), y(error.y[k])]);
      made("path", { d: path(corners), fill: inked(error.colour), opacity: error.alpha }, inside);
    }
    for (const band of panel.bands) this.band(band, box, x, y, inside, clip);
    const outside = made("g", {}, this.svg);
    for (const line of part.lines) this.line(line, box, x, y, inside, outside);
    for (const note of panel.notes) {
      if (note.x < x0 || note.x > x1) continue;
      made("text", { x: round(x(note.x)) - 6, y: round(y(note.y)) - 8, ...END, fill: inked(note.colour) }, this.svg).textContent = note.text;
    }
    const cursor = made("line", { class: "cursor", y1: box.top, y2: box.bottom, visibility: "hidden" }, this.over);
    const readout = made("text", { x: box.right, y: box.top - 14, class: "value", "text-anchor": "end" }, this.over);
    return { panel, ...part, box, x, y, cursor, readout, from: (px) => x0 + (px - box.left) / (box.right - box.left) * (x1 - x0) };
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
  scales(panel, part, box, x, y, last) {
    for (const [value, word] of part.upright) {
      if (!Number.isFinite(y(value))) continue;
      made("line", { ...RULE, x1: box.left, x2: box.right, y1: round(y(value)), y2: round(y(value)) }, this.svg);
      made("text", { ...END, class: "end", x: box.left - 6, y: round(y(value)) + 4 }, this.svg).textContent = word;
    }
    for (const [value, word] of ruled(...part.span, false, Math.max(3, Math.floor((box.right - box.left) / 62)), part.across.factor)) {
      made("line", { ...RULE, x1: round(x(value)), x2: round(x(value)), y1: box.top, y2: box.bottom }, this.svg);
      const middle = Math.min(x(value), this.width - 3.6 * word.length);
      made("text", { ...MIDDLE, x: round(middle), y: box.bottom + 16 }, this.svg).textContent = word;
    }
    made("path", { ...FRAME, class: "frame", d: `M${box.left} ${box.top}V${box.bottom}H${box.right}` }, this.svg);
    const label = [panel.title, part.label].filter((word) => word).join(": ");
    made("text", { ...LABEL, x: box.left - this.left + 4, y: box.top - 14 }, this.svg).textContent = label;
    if (last) made("text", { ...MIDDLE, x: (box.left + box.right) / 2, y: box.bottom + 33 }, this.svg).textContent = part.across.label;
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
    return kind in MARKERS ? path(MARKERS[kind].map(([a, b]) => [x + a * r, y + b * r]), true) : circle([x, y], kind === "." ? DOT : r);
  }

  // -- the cursor -----------------------------------------------------------------------------------------------
  show(time) {
    this.time = time;
    if (!this.seen) return;
    for (const panel of this.panels) {
      const inside = time >= panel.span[0] && time <= panel.span[1], px = round(panel.x(time));
      panel.cursor.setAttribute("visibility", inside ? "visible" : "hidden");
      panel.cursor.setAttribute("x1", px);
      panel.cursor.setAttribute("x2", px);
    }
    this.read();
  }

  /* Write the values at the cursor beside the names in the legend, or above a panel without one. */
  read() {
    const told = this.values.map(() => []), order = this.hovered === null ? this.panels : [this.panels[this.hovered], ...this.panels];
    for (const own of order) {
      for (const line of this.curves(own)) {
        if (!Number.isInteger(line.entry)) continue;
        const value = text(this.value(line) * own.factor, READ), of = told[line.entry];
        // a curve in several panels has a value in each; one that is pointed at is read alone
        if (this.hovered === null ? !of.includes(value) : !of.length) of.push(value);
      }
    }
    this.values.forEach((output, k) => { output.textContent = told[k].join("; "); });
    if (this.values.length) return;
    for (const own of this.panels) own.readout.textContent = this.curves(own).slice(-1).map((line) => text(this.value(line) * own.factor, READ)).join("");
  }
  /* The lines of a panel that are read at the cursor. */
  curves(own) { return own.lines.filter((line) => line.width && !line.spans[0] && !line.spans[1] && line.x.length > 1 && !line.beside); }
  value(line) { return between(line, this.time); }
}
