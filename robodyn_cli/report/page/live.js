/* A scene that runs in the page: sliders and fields for its keys; drawing, plots and figures of what they give. */

const PASSED = 12; // events whose times are shown
const GROUPS = [["q", "positions", ""], ["v", "rates", "/s"]];

async function unzipped(text) {
  const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

class Live {
  /* box : where it stands on the page. cursor : of the charts of its result, and the drawing where there is one. */
  constructor(box, data, runner, cursor) {
    const { player } = cursor;
    Object.assign(this, { box, data, runner, cursor, player, beside: null, waiting: false });
    this.values = data.keys.map((key) => key.value);
    this.groups = data.groups || GROUPS;
    this.stored = player && { ...player.view.drawing };
    this.fields();
    this.parts = new Background();
    this.sweep = new Sweep(this, this.find(".sweep"));
    this.charts = this.groups.map(([group, title, per]) => this.chart(group, title, per));
    box.hidden = false;
    this.update();
  }
  find(name) { return this.box.querySelector(name); }

  // -- values of the keys ----------------------------------------------------------------------------
  fields() {
    this.rows = this.data.keys.map((key, k) => {
      const id = `${this.box.id}-${k}`, label = named("label", key.name.replace(/^robot\./, ""), { htmlFor: id });
      const range = { min: key.low, max: key.high, step: "any" };
      const slider = Object.assign(document.createElement("input"), { type: "range", id, ...range });
      const field = Object.assign(document.createElement("input"), { type: "number", ...range });
      field.setAttribute("aria-label", `${key.name} [${key.unit || "1"}]`);
      slider.addEventListener("input", () => this.slide(k, Number(slider.value)));
      // arrows go a hundredth of the range
      slider.addEventListener("keydown", (event) => {
        const steps = { ArrowLeft: -1, ArrowDown: -1, ArrowRight: 1, ArrowUp: 1, PageDown: -10, PageUp: 10 }[event.key];
        if (!steps) return;
        event.preventDefault();
        this.take(k, Math.min(key.high, Math.max(key.low, this.values[k] + steps * (key.high - key.low) / 100)));
      });
      field.addEventListener("change", () => this.take(k, field.value === "" ? this.values[k] : Number(field.value))); // what is no number leaves the value
      const both = named("div", "", { className: "slider" });
      both.append(slider);
      const strip = made("svg", { class: "parts", viewBox: "0 0 100 4", preserveAspectRatio: "none", role: "img", "aria-label": "" }, both);
      this.find(".keys").append(label, both, field, named("span", key.unit || ""));
      return { slider, field, strip };
    });
    this.find(".again").addEventListener("click", () => this.set(this.data.keys.map((key) => key.value)));
    this.find(".keep").addEventListener("click", () => {
      this.beside = this.beside || !this.result ? null : this.result;
      this.find(".keep").setAttribute("aria-pressed", String(Boolean(this.beside)));
      if (this.result) this.plot();
    });
    this.find(".copy").addEventListener("click", () => this.copy());
  }
  /* A value of a slider: of as many digits as a thousandth of the range asks for. */
  slide(k, value) {
    const { low, high } = this.data.keys[k], step = 10 ** Math.floor(Math.log10((high - low) / 500));
    this.take(k, Math.min(high, Math.max(low, Number((Math.round(value / step) * step).toPrecision(12)))));
  }
  take(k, value) {
    this.values[k] = value;
    this.update(k);
  }
  set(values) {
    this.values = values;
    this.update(null);
  }
  /* Look for the parts of each range that are left to the command, beside the values that are seen. */
  look(changed) {
    const { runner, rows } = this, values = this.values.slice();
    this.parts.start((function* () {
      for (const [k, { strip }] of rows.entries()) {
        if (k !== changed || !strip.dataset.looked) yield* scanned(runner, values, k, PARTS, (points) => showParts(strip, runner.data.keys[k], points), SHARPER);
        strip.dataset.looked = "yes";
      }
    })());
  }
  /* What the command is given for what is seen. */
  get settings() {
    return this.data.keys.map((key, k) => [key, this.values[k]]).filter(([key, x]) => x !== key.value).map(([key, x]) => `--set ${key.name}=${x}`).join(" ");
  }
  async copy() {
    const words = this.settings, output = this.find(".settings");
    output.textContent = words || "as in the scene";
    try {
      await navigator.clipboard.writeText(words);
    } catch {
      getSelection().selectAllChildren(output); // where the browser does not let a page copy
    }
  }

  // -- what they give --------------------------------------------------------------------------------
  update(changed = null) {
    this.sweep.moved(changed);
    this.look(changed);
    this.rows.forEach(({ slider, field }, k) => {
      slider.value = this.values[k];
      slider.setAttribute("aria-valuetext", `${text(this.values[k], 6)} ${this.data.keys[k].unit || ""}`);
      field.value = Number(this.values[k].toPrecision(12));
    });
    if (this.waiting) return;
    this.waiting = true;
    // once before the browser paints next, however fast the slider moves
    requestAnimationFrame(() => {
      this.waiting = false;
      const begun = performance.now(), result = this.made();
      if (result) {
        this.result = result;
        this.draw();
        this.figures();
        // plots take longer than all else: they follow the drawing
        clearTimeout(this.later);
        this.later = setTimeout(() => this.plot());
      }
      this.sweep.cursor();
      this.box.dataset.milliseconds = performance.now() - begun;
      this.box.dataset.runs = Number(this.box.dataset.runs || 0) + 1;
    });
  }
  made() {
    const result = this.runner.run(this.values), refused = result.refused;
    this.find(".refused").textContent = refused ? `This page leaves these values to the command: ${refused}.` : "";
    this.left = Boolean(refused);
    this.box.classList.toggle("left", this.left);
    return refused ? null : result;
  }

  get figureNames() {
    const { data } = this;
    if (data.figures) return data.figures.map((figure) => figure.name);
    const end = data.locks ? "at the lock" : "at the end";
    const of = ([group]) => data[group].names.map((name) => `${group === "q" ? "" : "rate of "}${name} ${end}`);
    return [...(data.locks ? ["time of the lock"] : []), ...GROUPS.flatMap(of)];
  }
  /* The figures of a run, in the order of their names. */
  figuresOf(result) {
    const { data } = this;
    if (data.figures) return data.figures.map(({ unit }, k) => ({ ...result.figures[k], unit }));
    const units = (group, per, unit) => unit + (group === "v" && !unit.includes("/s") ? per : "");
    const of = ([group, , per]) => data[group].units.map((unit, k) => ({ value: result[group][k], error: result[`${group}_error`][k], unit: units(group, per, unit) }));
    return [...(data.locks ? [{ value: result.time, error: result.time_error, unit: "s" }] : []), ...GROUPS.flatMap(of)];
  }
  figures() {
    const { result } = this, found = this.figuresOf(result);
    const rows = this.figureNames.map((name, k) => [name, stated(found[k].value, found[k].error, found[k].unit)]);
    const shown = result.passed.slice(0, PASSED);
    rows.push(...shown.map(({ name, kink, time, error }) => [`${kink ? "kink" : "event"} of ${name.replace(/[._]/g, " ")}`, stated(time, error, "s")]));
    if (result.passed.length > PASSED) rows.push(["more events", `${result.passed.length - PASSED}`]);
    if (result.steps) rows.push(["steps of two integrations", `${result.steps} and ${result.second_steps}`]);
    this.find("tbody").replaceChildren(...rows.map(([name, value]) => {
      const row = document.createElement("tr");
      row.append(named("th", name, { scope: "row" }), named("td", value));
      return row;
    }));
  }

  /* Put the run in the place of the stored one in the drawing; with the values of the scene the stored one stays. */
  draw() {
    if (!this.player || !this.data.outputs.picture) return;
    const { data, result, runner, player, stored } = this, sizes = data.outputs.picture, moments = player.find(".moments");
    const own = this.values.every((x, k) => x === data.keys[k].value);
    if (moments) moments.hidden = !own; // those of the stored run
    if (own) {
      if (player.view.drawing.times !== stored.times) player.replace(stored);
      return;
    }
    const count = result.times.length, places = runner.along("picture", result.columns);
    for (const name in places) places[name].shape = [count, sizes[name] / 3, 3];
    const names = data.points;
    const path = (trail) => {
      const k = names.indexOf(trail.name), points = new Float32Array(3 * count);
      for (let n = 0; n < count; n++) points.set(places.points.subarray((n * names.length + k) * 3, (n * names.length + k + 1) * 3), 3 * n);
      return { ...trail, times: Float64Array.from(result.times), points: Object.assign(points, { shape: [count, 1, 3] }) };
    };
    const lock = data.locks ? [[result.time, null]] : [];
    player.replace({
      times: Float64Array.from(result.times), vertices: places.vertices, axes: places.axes, arrows: [],
      trails: stored.trails.filter((trail) => names.includes(trail.name)).map(path),
      latches: stored.latches.map((latch) => ({ ...latch, closed: lock })),
    });
  }

  // -- plots -----------------------------------------------------------------------------------------
  chart(group, title, per) {
    const figure = document.createElement("figure"), units = [...new Set(this.data[group].units)];
    figure.className = "plot";
    figure.append(named("h3", `Live: ${title}`), named("div", "", { className: "chart" }));
    this.find(".plots").append(figure);
    const legend = this.data[group].names.map((name, k) => ({ ...this.line(k, this.data[group].names.length), text: name, band: false }));
    const panels = units.map((unit) => ({ title: null, label: `${title} [${unit}${group === "v" && !unit.includes("/s") ? per : ""}]`, unit, log: false, x: [0, 1], y: [0, 1], lines: [], bands: [], errors: [], notes: [] }));
    return new Chart(figure, { name: `${title} of the run in this page`, legend, panels, group }, this.cursor);
  }
  /* The look of one of so many lines, as in the plots of the stored result. */
  line(k, count) {
    const { looks } = this.data;
    return { ...(looks[count] || looks[Math.max(...Object.keys(looks))])[k], spans: [false, false] };
  }

  plot() {
    for (const chart of this.charts) {
      const { group } = chart.data, own = this.data[group], look = (k) => this.line(k, own.names.length);
      for (const panel of chart.data.panels) {
        const members = own.names.map((_, k) => k).filter((k) => own.units[k] === panel.unit);
        panel.lines = members.flatMap((k) => [
          ...(this.beside ? [{ ...look(k), entry: k, beside: true, width: 0.9, alpha: 0.5, x: this.beside.times, y: this.beside.columns[own.places[k]] }] : []),
          { ...look(k), entry: k, x: this.result.times, y: this.result.columns[own.places[k]] },
        ]);
        const values = panel.lines.flatMap((line) => Array.from(line.y)), low = Math.min(...values), high = Math.max(...values);
        const room = 0.05 * (high - low) || 0.05 * Math.abs(high) || 1;
        panel.x = [0, Math.max(...panel.lines.map((line) => line.x[line.x.length - 1]))];
        panel.y = [low - room, high + room];
      }
      if (chart.seen) chart.draw();
    }
  }
}

/* Let the scenes of the page run; without WebAssembly it stays as it is. */
async function startLive(lives, cursors) {
  if (!lives.length || typeof WebAssembly !== "object" || typeof DecompressionStream !== "function") return;
  for (const box of document.querySelectorAll("[data-live]")) {
    const data = lives[Number(box.dataset.live)];
    Object.assign(data, JSON.parse(new TextDecoder().decode(await unzipped(data.data))));
    const runner = await Runner.of(data, await unzipped(data.code.text));
    box.live = new Live(box, data, runner, cursors.get(box.closest("[data-result]")));
  }
  document.documentElement.dataset.running = "yes";
}
