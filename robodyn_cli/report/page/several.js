/* Several results on one page: a list that filters, differences of figures to those of a chosen one, and signals over
   one another (report/page/several.py). */

const WINDOW = 0.04; // room above and below lines, of their range

class Several {
  constructor(data, arrays) {
    Object.assign(this, { data, arrays, list: document.querySelector("nav.results"), box: document.querySelector(".compare") });
    this.shown = new Set(data.labels.keys()); // results that the filter leaves
    this.cells = [...this.box.querySelectorAll("td[data-row]")];
    for (const cell of this.cells) cell.dataset.text = cell.textContent;
    this.list.querySelectorAll("svg.swatch").forEach((svg, k) => {
      const look = data.looks[k];
      made("path", { d: "M1 6H29", fill: "none", stroke: inked(look.colour), "stroke-width": 2, "stroke-dasharray": look.dashes.map((x) => round(1.25 * x)).join(" ") || "none" }, svg);
    });
    this.boxes = [...this.list.querySelectorAll("[data-line]")];
    this.to = this.box.querySelector(".to");
    this.signal = this.box.querySelector(".signal");
    this.filter = this.list.querySelector(".filter");
    this.filter.addEventListener("input", () => this.filtered());
    this.to.addEventListener("change", () => { this.differences(); this.draw(); });
    this.box.querySelector(".differing").addEventListener("change", (event) => this.box.classList.toggle("few", event.target.checked));
    this.signal?.addEventListener("change", () => this.draw());
    for (const box of this.boxes) box.addEventListener("change", () => this.draw());
    for (const button of this.list.querySelectorAll("[data-all]")) {
      button.addEventListener("click", () => {
        for (const k of this.shown) this.boxes[k].checked = button.dataset.all === "yes";
        this.draw();
      });
    }
    for (const button of this.box.querySelectorAll("[data-sort]")) button.addEventListener("click", () => this.sort(button));
    this.draw();
  }

  get chosen() { return this.to.value === "" ? null : Number(this.to.value); }

  // -- the list ---------------------------------------------------------------------------------------------------
  /* Keep the results whose words hold all those that are asked for. */
  filtered() {
    const words = this.filter.value.toLowerCase().split(/\s+/).filter(Boolean), items = [...this.list.querySelectorAll("li")];
    this.words ||= items.map((item, k) => `${item.textContent} ${this.given(k)}`.toLowerCase());
    this.shown = new Set(this.words.flatMap((own, k) => (words.every((word) => own.includes(word)) ? [k] : [])));
    const hide = (node) => node.classList.toggle("left-out", !this.shown.has(Number(node.dataset.of)));
    for (const node of document.querySelectorAll("[data-of]")) hide(node);
    document.querySelectorAll("[data-result]").forEach((section, k) => section.classList.toggle("left-out", !this.shown.has(k)));
    const all = this.data.labels.length;
    this.list.querySelector(".count").textContent = this.shown.size === all ? `${all} results` : `${this.shown.size} of ${all} results`;
    this.draw();
  }
  /* What the table says of a result, for the filter: keys of the scene with their values. */
  given(k) {
    return this.cells.filter((cell) => Number(cell.dataset.of) === k && cell.dataset.v === undefined).map((cell) => cell.dataset.text).join(" ");
  }

  // -- the table --------------------------------------------------------------------------------------------------
  /* Write figures less those of the chosen result, with the sum of both errors. */
  differences() {
    const { chosen } = this, own = new Map();
    for (const cell of this.cells) if (Number(cell.dataset.of) === chosen) own.set(cell.dataset.row, cell);
    for (const cell of this.cells) {
      const other = own.get(cell.dataset.row), both = other && cell !== other && [cell, other].every((one) => one.dataset.v !== undefined);
      cell.classList.toggle("reference", cell === other);
      cell.classList.remove("beyond", "inside");
      cell.textContent = cell.dataset.text;
      if (!both || (cell.dataset.u || "") !== (other.dataset.u || "")) continue;
      const off = Number(cell.dataset.v) - Number(other.dataset.v), error = Number(cell.dataset.e) + Number(other.dataset.e);
      const known = [cell, other].every((one) => one.dataset.known === "yes"), words = stated(off, known ? error : NaN, cell.dataset.u || "");
      cell.textContent = off > 0 && !words.startsWith("0 ") ? `+${words}` : words;
      if (known) cell.classList.add(Math.abs(off) > error ? "beyond" : "inside");
    }
  }

  /* Put rows in the order of a figure, rising and then falling; those without it last. */
  sort(button) {
    const row = button.dataset.sort, falls = button.closest("th").getAttribute("aria-sort") === "ascending";
    for (const head of this.box.querySelectorAll("[aria-sort]")) head.removeAttribute("aria-sort");
    button.closest("th").setAttribute("aria-sort", falls ? "descending" : "ascending");
    const body = this.box.querySelector(".sided tbody"), key = (line) => {
      const cell = line.querySelector(`td[data-row="${row}"]`), { v } = cell.dataset, words = cell.dataset.text.replace("−", "-");
      return v !== undefined ? Number(v) : Number.isFinite(Number(words)) && words !== "" ? Number(words) : words;
    };
    const lines = [...body.rows].map((line) => [key(line), line]);
    const after = (a, b) => (a === "" || b === "" ? (a === "") - (b === "") : (falls ? -1 : 1) * (typeof a === "number" && typeof b === "number" ? a - b : String(a).localeCompare(String(b))));
    body.append(...lines.sort((a, b) => after(a[0], b[0])).map(([, line]) => line));
  }

  // -- signals ----------------------------------------------------------------------------------------------------
  draw() {
    if (!this.signal) return;
    const signal = this.data.signals[Number(this.signal.value)], { chosen } = this;
    const wanted = signal.lines.filter((line) => this.shown.has(line.of) && this.boxes[line.of].checked);
    const reference = chosen === null ? null : signal.lines.find((line) => line.of === chosen);
    const found = wanted.map((line) => (reference ? this.less(line, reference) : this.own(line))), drawn = found.filter((line) => line.x.length > 1);
    const place = this.box.querySelector(".drawn");
    place.replaceChildren();
    this.tell(signal, wanted, reference, found, drawn);
    this.cursor = null;
    if (!drawn.length) return;
    place.append(named("div", "", { className: "chart" }));
    const range = drawn.flatMap((line) => [...line.y].filter(Number.isFinite)), low = Math.min(...extremes(range)), high = Math.max(...extremes(range));
    const room = WINDOW * (high - low) || 0.05 * Math.abs(high) || 1, ends = drawn.flatMap((line) => [line.x[0], line.x[line.x.length - 1]]);
    const look = (line) => ({ ...this.data.looks[line.of], ...(line.dotted ? { width: 0, dashes: [], marker: "." } : {}) });
    const lines = drawn.map((line, k) => ({ ...look(line), x: line.x, y: line.y, spans: [false, false], entry: k }));
    const errors = drawn.flatMap((line) => (line.error > 1e-3 * (high - low) ? [this.band(line, look(line).colour)] : []));
    const less = reference ? ` less that of ${this.data.labels[chosen]}` : "";
    const panel = { title: null, less, label: signal.label.replace(/( \[[^\]]*\])?$/, (unit) => less + unit), unit: signal.unit, log: false, x: [Math.min(...ends), Math.max(...ends)], y: [low - room, high + room],
      lines, errors, bands: this.lost(drawn, ends), notes: [] };
    const legend = drawn.map((line) => ({ ...look(line), text: this.data.labels[line.of], band: false }));
    this.cursor = new Cursor();
    new Chart(place, { name: signal.name + less, legend, panels: [panel] }, this.cursor).draw();
  }
  own(line) { return { ...line, x: this.arrays[line.x], y: this.arrays[line.y] }; }
  /* A line less another, at the samples that both have; none where one is thinned. */
  less(line, other) {
    const none = { ...line, x: [], y: [] };
    if (line === other || line.thinned || other.thinned) return none;
    const [a, b] = [this.own(line), this.own(other)], x = [], y = [];
    for (let k = 0, n = 0; k < a.x.length && n < b.x.length;) {
      const near = Math.abs(a.x[k] - b.x[n]) <= 4e-16 * Math.abs(a.x[k]);
      if (near) { x.push(a.x[k]); y.push(a.y[k] - b.y[n]); }
      if (near || a.x[k] < b.x[n]) k += 1;
      if (near || a.x[k] > b.x[n]) n += 1;
    }
    const error = line.error === null || other.error === null ? null : line.error + other.error;
    return { ...line, x, y, error };
  }
  band(line, colour) {
    const x = [...line.x], y = [...line.y];
    return { colour, alpha: 0.22, x: [...x, ...x.slice().reverse()], y: [...y.map((v) => v + line.error), ...y.map((v) => v - line.error).reverse()] };
  }
  /* What is hatched: from where the first motion is lost in its error. */
  lost(drawn, ends) {
    const until = Math.min(...drawn.map((line) => this.data.until[line.of] ?? Infinity)), end = Math.max(...ends);
    return until < end ? [{ left: until, right: end, low: NaN, high: NaN, colour: "#7f7f7f", alpha: 0.55, hatched: true }] : [];
  }
  /* Say what is drawn with which errors, and what is not. */
  tell(signal, wanted, reference, found, drawn) {
    const parts = [], some = (lines) => `${lines.slice(0, 4).map((line) => this.data.labels[line.of]).join(", ")}${lines.length > 4 ? ` and ${lines.length - 4} more` : ""}`;
    const known = drawn.filter((line) => line.error !== null), open = drawn.filter((line) => line.error === null);
    if (known.length) parts.push(`Largest error${reference ? " of a difference, both errors added" : ""}: ${text(roundedUp(Math.max(...known.map((line) => line.error)), 2), 2)} ${signal.unit}.`);
    if (open.length && this.chosen !== null && !reference) parts.push(`${this.data.labels[this.chosen]} has no such signal: the lines are no differences.`);
    if (open.length) parts.push(`No error is stated for this of ${some(open)}.`);
    const missing = this.boxes.flatMap((box, k) => (box.checked && this.shown.has(k) && !signal.lines.some((line) => line.of === k) ? [{ of: k }] : []));
    if (missing.length) parts.push(`Without such a signal: ${some(missing)}.`);
    const apart = found.filter((line) => line.x.length < 2 && (!reference || line.of !== reference.of));
    if (apart.length) parts.push(`Not drawn, as samples are at other times or thinned, and nothing says how far off a line between samples is: ${some(apart)}.`);
    if (drawn.some((line) => line.dotted)) parts.push("Dots: samples are too far apart to show the motion.");
    if (wanted.some((line) => line.thinned)) parts.push("Lines are thinned to their smallest and largest samples.");
    if (!wanted.length) parts.push("No result is chosen that has this signal.");
    this.box.querySelector(".told").textContent = parts.join(" ");
  }
}

/* Smallest and largest of numbers, of which there may be very many. */
function extremes(values) {
  let low = Infinity, high = -Infinity;
  for (const value of values) { if (value < low) low = value; if (value > high) high = value; }
  return Number.isFinite(low) ? [low, high] : [0, 0];
}
