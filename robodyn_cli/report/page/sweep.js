/* Runs over the range of a key, made while the page has time: parts that are left to the command, and a curve of a
   figure with its error. */

const SLICE = 8, PARTS = 24, SHARPER = 7; // ms of work at a time, stretches of a range, halvings at an edge

/* Works off a generator in slices, so that the page stays awake; a new one takes the place of the last. */
class Background {
  start(work) {
    const own = this.own = {};
    const go = () => {
      if (this.own !== own) return;
      const until = performance.now() + SLICE;
      while (performance.now() < until) if (work.next().done) return;
      setTimeout(go);
    };
    setTimeout(go, 100); // what is seen comes first
  }
}

/* Values between two ends, both there. */
const spread = (low, high, count) => Array.from({ length: count + 1 }, (_, k) => (k === count ? high : low + (high - low) * k / count));

/* The parts [from, to] of a range in which runs are refused, with reasons; points : {x, refused}, in their order. */
function refusedParts(points) {
  const parts = [];
  points.forEach(({ x, refused }, k) => {
    if (!refused) return;
    const before = points[k - 1], after = points[k + 1];
    const from = before ? (before.refused ? before.x : 0.5 * (before.x + x)) : x, to = after && !after.refused ? 0.5 * (after.x + x) : x;
    const last = parts[parts.length - 1];
    if (last && before && before.refused) {
      last.to = to;
      last.reasons.add(refused);
    } else parts.push({ from, to, reasons: new Set([refused]) });
  });
  return parts;
}

/* Yield while runs are made at values of one key beside others; the edges of refused parts are looked for by halving. */
function* scanned(runner, values, k, count, take, sharper = 0) {
  const { low, high } = runner.data.keys[k], points = [];
  const at = (x) => {
    const result = runner.run(values.map((own, i) => (i === k ? x : own)));
    return { x, refused: result.refused ? result.reason : "", words: (result.refused || "").replace(/,? at t = .* s$/, ""), result };
  };
  for (const x of spread(low, high, count)) {
    points.push(at(x));
    yield;
  }
  for (let n = points.length - 1; n > 0; n--) {
    let [left, right] = [points[n - 1], points[n]];
    if (Boolean(left.refused) === Boolean(right.refused)) continue;
    for (let round = 0; round < sharper; round++) {
      const middle = at(0.5 * (left.x + right.x));
      if (Boolean(middle.refused) === Boolean(left.refused)) left = middle; else right = middle;
      yield;
    }
    points.splice(n, 0, ...[left, right].filter((point) => !points.includes(point)));
  }
  take(points);
}

/* A strip below a slider, hatched where values are left to the command. */
function showParts(strip, key, points) {
  const parts = refusedParts(points), at = (x) => 100 * (x - key.low) / (key.high - key.low);
  strip.replaceChildren();
  for (const { from, to } of parts) made("rect", { x: round(at(from)), width: round(Math.max(0.4, at(to) - at(from))), y: 0, height: 4 }, strip);
  strip.classList.toggle("some", parts.length > 0);
  const words = parts.map(({ from, to }) => `${text(from, 5)} to ${text(to, 5)}`).join(", ");
  strip.setAttribute("aria-label", parts.length ? `left to the command: ${words} ${key.unit || ""}` : "");
}

/* A curve over a key; at the cursor stands the figure of the run that is seen, not one between points. */
class SweepChart extends Chart {
  value() { return this.data.seen(); }
}

/* The curve of one figure over one key. */
class Sweep {
  constructor(live, box) {
    Object.assign(this, { live, box, background: new Background(), chart: null, points: [] });
    const { data } = live, options = (select, words) => words.forEach((word, k) => select.append(named("option", word, { value: k })));
    [this.key, this.figure, this.count] = box.querySelectorAll("select");
    options(this.key, data.keys.map((key) => key.name.replace(/^robot\./, "")));
    options(this.figure, live.figureNames);
    for (const select of [this.key, this.figure]) select.addEventListener("change", () => this.draw(select === this.key));
    this.count.addEventListener("change", () => this.draw(true));
    this.box.addEventListener("toggle", () => this.draw(true));
  }
  get k() { return Number(this.key.value); }

  /* Other values are seen: the curve is made anew, but where only its own key has moved. */
  moved(changed) {
    if (!this.box.open) return;
    if (changed === this.k) this.cursor(); else this.draw(true);
  }
  draw(anew) {
    if (!this.box.open) return;
    if (!anew) { this.plot(); return; }
    const { runner, values } = this.live;
    this.box.dataset.points = "";
    this.background.start(scanned(runner, values.slice(), this.k, Number(this.count.value), (points) => {
      this.points = points.map(({ x, refused, words, result }) => ({ x, refused, words, figures: refused ? null : this.live.figuresOf(result) }));
      this.plot();
      this.box.dataset.points = points.length;
    }, SHARPER));
  }

  plot() {
    const { data } = this.live, key = data.keys[this.k], n = Number(this.figure.value), good = this.points.filter((point) => point.figures);
    if (!this.points.length) return;
    const figure = document.createElement("figure"), name = this.live.figureNames[n];
    const line = { ...this.live.line(0, 1), text: name, band: false, entry: 0 }, errors = [], lines = [];
    for (const run of this.stretches()) {
      const x = run.map((point) => point.x), y = run.map((point) => point.figures[n].value), off = run.map((point) => point.figures[n].error || 0);
      lines.push({ ...line, x, y, marker: run.length === 1 ? "o" : null });
      errors.push({ colour: line.colour, alpha: 0.3, x: [...x, ...x.slice().reverse()], y: [...y.map((v, i) => v + off[i]), ...y.map((v, i) => v - off[i]).reverse()] });
    }
    const values = lines.flatMap((own) => own.y), low = Math.min(...values), high = Math.max(...values);
    const largest = Math.max(0, ...good.map((point) => point.figures[n].error || 0)), room = 0.06 * (high - low) || 0.05 * Math.abs(high) || 1;
    const bands = refusedParts(this.points).map(({ from, to }) => ({ left: from, right: to, low: NaN, high: NaN, colour: "#7f7f7f", alpha: 0.55, hatched: true }));
    const unit = good.length ? good[0].figures[n].unit : "";
    const panel = { title: null, label: `${name} [${unit}]`, unit, log: false, across: `${key.name.replace(/^robot\./, "")} [${key.unit || "1"}]`,
      x: [key.low, key.high], y: good.length ? [low - room, high + room] : [0, 1], lines, errors, bands, notes: [] };
    figure.append(named("div", "", { className: "chart" }));
    const reasons = [...new Set(this.points.filter((point) => point.refused).map((point) => point.words))];
    const left = reasons.length ? ` Hatched parts are left to the command: ${reasons[0]}${reasons.length > 1 ? "; and other reasons" : ""}.` : "";
    figure.append(named("p", good.length ? `The largest error is ${text(largest, 2)} ${unit}.${left}` : left, { className: "note" }));
    this.box.querySelector("figure")?.remove();
    this.box.append(figure);
    // the cursor is the value that is seen; dragging moves it
    const owner = Object.assign(new Cursor(), { time: this.live.values[this.k], drags: true, goTo: (x) => this.live.slide(this.k, x) });
    const seen = () => (this.live.left ? NaN : this.live.figuresOf(this.live.result)[n].value);
    this.chart = new SweepChart(figure, { name, over: key.name, legend: [line], panels: [panel], seen }, owner);
    this.chart.draw();
  }
  cursor() { if (this.chart) this.chart.show(this.live.values[this.k]); }

  /* Points that follow one another without a refused one in between. */
  stretches() {
    const runs = [];
    this.points.forEach((point, k) => {
      if (!point.figures) return;
      if (k && this.points[k - 1].figures) runs[runs.length - 1].push(point); else runs.push([point]);
    });
    return runs;
  }
}
