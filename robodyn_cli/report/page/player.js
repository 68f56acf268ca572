/* A drawing that moves: where it is seen from, its time, and what turns, zooms and plays it. */

const SVG = "http://www.w3.org/2000/svg";
const MARGIN = 0.07, ROOM = 38; // around a drawing: of its extent, and for marks at the rim [pixels]
const STILL = 4; // pixels that a click may move
const DISTANCE = 2.6; // of the eye, over the largest extent, once a flat drawing is turned

/* A drawing before a camera, at one of its poses. */
class View {
  constructor(drawing) {
    this.drawing = drawing;
    this.count = drawing.vertices.shape[1];
    this.width = 640;
    this.height = 400;
    this.version = 0; // of the camera: what depends on it alone is kept until it changes
    this.kept = new Map();
    this.pose = 0;
    this.followed = null; // body that stays where it is seen
    this.shift = [0, 0, 0]; // of the camera, which follows it
    this.look(0);
  }

  /* Look from the camera of a number, at everything. */
  look(number) {
    Object.assign(this, this.drawing.cameras[number]);
    // a view along gravity turns about the upright of the page
    this.turnAxis = Math.abs(dot(this.back, this.drawing.up)) > 0.9 ? this.up : this.drawing.up;
    this.fit();
  }

  fit() {
    const [low, high] = this.extent, size = [0, 1].map((k) => (high[k] - low[k]) * (1 + 2 * MARGIN));
    const room = [this.width, this.height].map((length) => Math.max(length - ROOM, 20));
    this.scale = Math.min(room[0] / size[0], room[1] / size[1]);
    this.middle = [(low[0] + high[0]) / 2, (low[1] + high[1]) / 2];
    this.changed();
  }

  changed() {
    this.version += 1;
    this.kept.clear();
    this.points = [];
  }

  get flat() { return this.distance === null; }
  get time() { return this.drawing.times[this.pose]; }

  show(pose) {
    this.pose = pose;
    this.points = [];
    if (this.followed) this.catchUp();
  }
  /* Follow a body from here on, or none. */
  follow(body) {
    this.followed = body && { body, from: plus(originOf(body, this.pose), this.shift, -1) };
  }
  catchUp() {
    const here = originOf(this.followed.body, this.pose);
    if (!here.every(Number.isFinite)) return;
    this.shift = plus(here, this.followed.from, -1);
    this.changed();
  }

  // -- from space to the screen -----------------------------------------------------------------------------------
  seen(p) {
    const d = plus(plus(p, this.target, -1), this.shift, -1), depth = dot(d, this.back);
    const gap = this.flat ? 1 : this.distance - depth;
    const s = this.flat ? 1 : gap > 0.05 * this.distance ? this.distance / gap : NaN;
    return this.onScreen(s * dot(d, this.right), s * dot(d, this.up), depth);
  }
  onScreen(x, y, depth = 0) {
    return [this.width / 2 + (x - this.middle[0]) * this.scale, this.height / 2 - (y - this.middle[1]) * this.scale, depth];
  }

  row(array, column, columns, pose = this.pose) {
    const rows = array.shape[0], start = 3 * (Math.min(pose, rows - 1) * columns + column);
    return [array[start], array[start + 1], array[start + 2]];
  }
  place(vertex, pose) { return this.row(this.drawing.vertices, vertex, this.count, pose); }
  axis(number) { return this.row(this.drawing.axes, number, this.drawing.axes.shape[1]); }
  at(vertex) { return this.points[vertex] || (this.points[vertex] = this.seen(this.place(vertex))); }

  once(key, make) {
    if (!this.kept.has(key)) this.kept.set(key, make());
    return this.kept.get(key);
  }
  /* The places of a trail, the numbers of those that its path needs, the path, and its length up to each of them. */
  trail(trail) {
    return this.once(trail, () => {
      const points = Array.from(trail.times, (_, k) => this.seen(this.row(trail.points, 0, 1, k)));
      const kept = needed(points, 0.3);
      let d = "", pen = "M";
      const ends = kept.map((k) => {
        const there = isPlace(points[k]);
        // a stretch begins with a dot, for those that are one place
        if (there) d += `${pen}${round(points[k][0])} ${round(points[k][1])}${pen === "M" ? "h0" : ""}`;
        pen = there ? "L" : "M";
        return d.length;
      });
      return { points, kept, d, ends };
    });
  }
  /* How far a vertex goes along a direction of the screen, from where it is. */
  reach(vertex, at, d) {
    const [low, high] = this.once(`reach ${vertex}`, () => {
      const found = Array.from(this.drawing.times, (_, k) => this.seen(this.place(vertex, k)));
      const far = found.filter(isPlace).map((p) => p[0] * d[0] + p[1] * d[1]);
      return [Math.min(...far), Math.max(...far)];
    });
    const here = at[0] * d[0] + at[1] * d[1];
    return [low - here, high - here];
  }
  onGround(p) { return plus(p, this.drawing.up, this.drawing.level - dot(p, this.drawing.up)); }
  /* Direction of gravity on the screen; downwards where it has none there. */
  down() {
    const up = this.drawing.up, d = [-dot(up, this.right), dot(up, this.up)], size = Math.hypot(...d);
    return this.drawing.falls && size > 0.5 ? [d[0] / size, d[1] / size] : [0, 1];
  }

  /* Distance of the lines of the grid [m]: a round number, some eight across. */
  get pitch() {
    const span = Math.max(this.width, this.height) / this.scale / 8, power = 10 ** Math.floor(Math.log10(span));
    return power * [1, 2, 5, 10].find((step) => step * power >= span * (1 - 1e-9));
  }
  gridLines() { return this.once("grid", () => (this.flat ? this.paperLines() : this.floorLines())); }
  paperLines() {
    const half = [this.width / 2 / this.scale, this.height / 2 / this.scale], off = [dot(this.shift, this.right), dot(this.shift, this.up)], found = [];
    for (const k of [0, 1]) {
      for (const line of marks(this.middle[k] + off[k] - half[k], this.middle[k] + off[k] + half[k], this.pitch)) {
        const mark = line - off[k], end = (sign) => (k ? [this.middle[0] + sign * half[0], mark] : [mark, this.middle[1] + sign * half[1]]);
        found.push([this.onScreen(...end(-1)), this.onScreen(...end(1))]);
      }
    }
    return found;
  }
  floorLines() {
    if (!this.drawing.floor) return [];
    const [axes, least, most] = this.drawing.floor, pitch = this.pitch, found = [];
    const low = least.map((x) => (Math.floor(x / pitch) - 1) * pitch), high = most.map((x) => (Math.ceil(x / pitch) + 1) * pitch);
    const at = (x, y) => this.seen(plus(plus(times(axes[0], x), axes[1], y), this.drawing.up, this.drawing.level));
    for (const x of marks(low[0], high[0], pitch)) found.push([at(x, low[1]), at(x, high[1])]);
    for (const y of marks(low[1], high[1], pitch)) found.push([at(low[0], y), at(high[0], y)]);
    return found;
  }

  // -- the camera ---------------------------------------------------------------------------------------------------
  /* Turn by angles about the upright axis and about the one to the right; a flat drawing becomes one in space. */
  turn(around, over) {
    if (this.flat) {
      this.target = this.drawing.centre;
      this.middle = [this.middle[0] - dot(this.target, this.right), this.middle[1] - dot(this.target, this.up)];
      this.distance = DISTANCE * this.drawing.size;
    }
    const tilt = Math.acos(Math.min(1, Math.max(-1, dot(this.back, this.turnAxis))));
    const pitch = Math.min(Math.PI - 0.05, Math.max(0.05, tilt + over)) - tilt;
    const across = this.right;
    for (const name of ["right", "up", "back"]) this[name] = turned(turned(this[name], across, pitch), this.turnAxis, around);
    this.changed();
  }
  move(dx, dy) {
    this.middle = [this.middle[0] - dx / this.scale, this.middle[1] + dy / this.scale];
    this.changed();
  }
  zoom(factor, x = this.width / 2, y = this.height / 2) {
    const off = [x - this.width / 2, this.height / 2 - y];
    const scale = this.scale * factor;
    this.middle = this.middle.map((m, k) => m + off[k] / this.scale - off[k] / scale);
    this.scale = scale;
    this.changed();
  }
}

/* Whole multiples of a pitch between two ends, no more than a few hundred. */
function marks(low, high, pitch) {
  const first = Math.ceil(low / pitch), count = Math.min(400, Math.floor(high / pitch) - first + 1);
  return Array.from({ length: Math.max(0, count) }, (_, k) => (first + k) * pitch);
}

function made(name, attributes, parent) {
  const node = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
  if (parent) parent.append(node);
  return node;
}

/* Paints strokes with elements that are used again: only what has changed is written. */
class Painter {
  constructor(svg) {
    this.group = made("g", { "stroke-linecap": "round", "stroke-linejoin": "round" }, svg);
    this.pool = [];
  }
  paint(strokes) {
    strokes.forEach((stroke, k) => {
      const entry = this.pool[k] || (this.pool[k] = { node: made("path", {}, this.group), values: {} });
      const values = {
        d: stroke.d, stroke: stroke.width ? stroke.colour : "none", "stroke-width": round(stroke.width), fill: stroke.fill,
        "stroke-dasharray": stroke.dash || "none", "data-part": stroke.part, "data-body": stroke.body,
      };
      for (const [key, value] of Object.entries(values)) {
        if (entry.values[key] !== value) entry.node.setAttribute(key, value);
      }
      entry.values = values;
    });
    for (const { node } of this.pool.splice(strokes.length)) node.remove();
  }
}

class Player {
  constructor(figure, drawing) {
    this.figure = figure;
    this.svg = figure.querySelector(".scene");
    this.view = new View(drawing);
    this.painter = new Painter(this.svg);
    this.cross = made("g", { class: "cross" }, this.svg);
    this.words = made("g", { class: "words", "aria-hidden": "true" }, this.svg);
    this.shown = { arrows: true, reactions: true, trails: true, masses: true, names: false, frames: false, ghosts: false };
    this.listeners = [];
    this.frame = null; // of the browser, while it plays
    this.waiting = false;
    this.controls();
    this.pointers();
    this.bodies = new Bodies(this);
    new ResizeObserver(() => this.resize()).observe(this.svg.parentElement);
    this.resize();
    this.show(0);
  }

  get times() { return this.view.drawing.times; }
  find(name) { return this.figure.querySelector(name); }

  resize() {
    const [low, high] = this.view.drawing.cameras[0].extent, width = Math.max(200, this.svg.parentElement.clientWidth);
    const most = document.fullscreenElement === this.figure ? 0.72 * window.innerHeight : 560;
    const height = Math.min(Math.max(width * (high[1] - low[1]) / (high[0] - low[0]), 240, 0.4 * width), 0.75 * width, most);
    if (width === this.view.width && Math.abs(height - this.view.height) < 1) return;
    const zoom = width / this.view.width;
    Object.assign(this.view, { width, height });
    this.svg.setAttribute("viewBox", `0 0 ${round(width)} ${round(height)}`);
    if (this.sized) this.view.zoom(zoom);
    else this.view.fit();
    this.sized = true;
    this.draw();
  }

  /* Draw once, before the browser paints next. */
  draw() {
    if (this.waiting) return;
    this.waiting = true;
    requestAnimationFrame(() => this.drawNow());
  }
  drawNow() {
    this.waiting = false;
    this.painter.paint(new Strokes(this.view, this.shown).all());
    this.axes();
    this.write();
    const { scale, middle, pose } = this.view;
    Object.assign(this.svg.dataset, { pose, scale, x: middle[0], y: middle[1], flat: this.view.flat });
    const caption = this.find(".grid-caption");
    caption.textContent = `Grid ${text(this.view.pitch)} m. ${this.view.drawing.caption}`;
  }

  /* Directions of the world's axes, in the lower left corner. */
  axes() {
    const corner = [44, this.view.height - 44];
    this.cross.replaceChildren();
    ["x", "y", "z"].forEach((name, k) => {
      const d = [20 * this.view.right[k], -20 * this.view.up[k]];
      if (Math.hypot(...d) < 4) return;
      const [x, y] = [corner[0] + d[0], corner[1] + d[1]];
      made("path", { d: path([corner, [x, y]]), stroke: INK, "stroke-width": 1.3 }, this.cross);
      made("text", { x: round(corner[0] + 1.5 * d[0]), y: round(corner[1] + 1.5 * d[1] + 4), "text-anchor": "middle" }, this.cross).textContent = name;
    });
  }

  /* Write the names of links, and the letters of axes, where there is room for them. */
  write() {
    this.words.replaceChildren();
    const placed = [], { shown, view } = this;
    const put = (word, [x, y]) => {
      const half = 3.6 * word.length;
      if (!isPlace([x, y]) || placed.some(([a, b, c]) => Math.abs(a - x) < half + c && Math.abs(b - y) < 13)) return;
      placed.push([x, y, half]);
      made("text", { x: round(x), y: round(y) }, this.words).textContent = word;
    };
    if (shown.names) {
      for (const part of view.drawing.parts) {
        if (part.kind !== "link" || !part.vertices.length) continue;
        const corners = part.vertices.map((v) => view.at(v)), mean = (k) => corners.reduce((sum, p) => sum + p[k], 0) / corners.length;
        put(part.name, [mean(0), mean(1) - 9]);
      }
    }
    if (shown.frames) for (const axis of axesOf(view)) put(axis.letter, along(axis.ends[1], ahead(...axis.ends) || [1, 0], 8));
  }

  /* Show another motion of the same things, at the time that is shown. */
  replace(motion) {
    const { time } = this.view;
    Object.assign(this.view.drawing, motion);
    this.view.changed();
    this.bodies.replaced();
    const slider = this.find(".time");
    if (slider) slider.max = this.times.length - 1;
    if (!this.playing) this.showTime(time);
    this.draw();
  }

  // -- time -----------------------------------------------------------------------------------------------------
  show(pose) {
    this.view.show(Math.max(0, Math.min(pose, this.times.length - 1)));
    const slider = this.find(".time");
    if (slider) {
      slider.value = this.view.pose;
      slider.setAttribute("aria-valuetext", `${text(this.view.time, 5)} seconds`);
      this.find(".clock").textContent = `t = ${clock(this.view.time, this.times)} s`;
    }
    for (const listener of this.listeners) listener(this.view.time);
    this.bodies?.tell();
    this.draw();
  }
  /* Show the pose nearest to a time. */
  showTime(time) {
    const right = Math.min(countUpTo(this.times, time), this.times.length - 1), left = Math.max(0, right - 1);
    this.show(time - this.times[left] <= this.times[right] - time ? left : right);
  }
  get playing() { return this.frame !== null; }
  play() {
    if (this.times.length < 2) return;
    if (this.view.pose === this.times.length - 1) this.show(0);
    let now = this.view.time, last = null;
    const step = (at) => {
      now += last === null ? 0 : (at - last) / 1000 * Number(this.find(".speed").value);
      last = at;
      this.showTime(now);
      if (now < this.times[this.times.length - 1]) this.frame = requestAnimationFrame(step);
      else this.pause();
    };
    this.frame = requestAnimationFrame(step);
    this.button(true);
  }
  pause() {
    if (this.playing) cancelAnimationFrame(this.frame);
    this.frame = null;
    this.button(false);
  }
  button(playing) {
    const button = this.find(".play");
    button.textContent = playing ? "❚❚" : "▶";
    button.setAttribute("aria-label", playing ? "Pause" : "Play");
  }
  toggle() { this.playing ? this.pause() : this.play(); }
  /* Go to a time that was asked for outside of the slider. */
  goTo(time) {
    if (this.playing) this.pause();
    this.showTime(time);
  }

  // -- controls -------------------------------------------------------------------------------------------------
  controls() {
    this.find(".play")?.addEventListener("click", () => this.toggle());
    this.find(".time")?.addEventListener("input", (event) => {
      if (this.playing) this.pause();
      this.show(Number(event.target.value));
    });
    this.find(".speed")?.addEventListener("change", () => {
      if (this.playing) { this.pause(); this.play(); }
    });
    const first = () => { this.view.look(Number(this.find(".view")?.value || 0)); this.draw(); };
    this.find(".view")?.addEventListener("change", first);
    this.find(".reset").addEventListener("click", first);
    for (const box of this.figure.querySelectorAll("[data-layer]")) {
      box.addEventListener("change", () => { this.shown[box.dataset.layer] = box.checked; this.draw(); });
    }
    for (const button of this.figure.querySelectorAll("[data-time]")) {
      button.addEventListener("click", () => this.goTo(Number(button.dataset.time)));
    }
    this.svg.addEventListener("keydown", (event) => this.key(event, first));
  }
  key(event, first) {
    const angle = 0.09, keys = {
      ArrowLeft: () => this.view.turn(angle, 0), ArrowRight: () => this.view.turn(-angle, 0),
      ArrowUp: () => this.view.turn(0, angle), ArrowDown: () => this.view.turn(0, -angle),
      "+": () => this.view.zoom(1.2), "=": () => this.view.zoom(1.2), "-": () => this.view.zoom(1 / 1.2), "0": first,
      " ": () => this.find(".play") && this.toggle(),
    };
    const press = (name) => this.find(`[data-layer='${name}']`)?.click(), letters = {
      n: () => press("names"), f: () => press("frames"), g: () => press("ghosts"), b: () => this.bodies.next(event.shiftKey ? -1 : 1),
      c: () => this.bodies.box?.click(), Escape: () => this.svg.blur(),
    };
    const key = keys[event.key] || letters[event.key.length === 1 ? event.key.toLowerCase() : event.key];
    if (!key || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    key();
    this.draw();
  }

  /* Drag turns, with shift it moves; two fingers zoom, turn and move. The wheel zooms with Ctrl, or once the drawing has
     been clicked: a page is scrolled over it. A click chooses a body. */
  pointers() {
    const down = new Map();
    let start = null; // where a finger went down that has not moved since
    const ratio = () => this.view.width / this.svg.getBoundingClientRect().width;
    this.svg.addEventListener("pointerdown", (event) => {
      down.set(event.pointerId, [event.clientX, event.clientY]);
      start = down.size === 1 ? [event.clientX, event.clientY] : null;
      this.svg.setPointerCapture(event.pointerId);
    });
    for (const name of ["pointerup", "pointercancel"]) this.svg.addEventListener(name, (event) => down.delete(event.pointerId));
    this.svg.addEventListener("pointerup", (event) => {
      if (start && Math.hypot(event.clientX - start[0], event.clientY - start[1]) < 3 * STILL) this.bodies.at(event.clientX, event.clientY);
      start = null;
    });
    this.svg.addEventListener("pointermove", (event) => {
      const before = down.get(event.pointerId);
      if (!before) return;
      const now = [event.clientX, event.clientY], [dx, dy] = [now[0] - before[0], now[1] - before[1]];
      const off = start && [0, 1].map((k) => Math.abs(now[k] - start[k]));
      // a finger that goes up or down over a drawing that was not tapped before scrolls the page
      if (off && (Math.max(...off) < STILL || (event.pointerType === "touch" && document.activeElement !== this.svg && off[1] > off[0]))) return;
      start = null;
      down.set(event.pointerId, now);
      const other = [...down].find(([id]) => id !== event.pointerId);
      if (other) {
        const far = (p) => Math.hypot(p[0] - other[1][0], p[1] - other[1][1]) || 1;
        const box = this.svg.getBoundingClientRect(), centre = [(now[0] + other[1][0]) / 2, (now[1] + other[1][1]) / 2];
        this.view.zoom(far(now) / far(before), (centre[0] - box.left) * ratio(), (centre[1] - box.top) * ratio());
        this.view.move(dx / 2 * ratio(), dy / 2 * ratio());
      } else if (event.shiftKey || event.buttons === 4) this.view.move(dx * ratio(), dy * ratio());
      else this.view.turn(-0.008 * dx, -0.008 * dy);
      this.draw();
    });
    this.svg.addEventListener("wheel", (event) => {
      if (!event.ctrlKey && !event.metaKey && document.activeElement !== this.svg) return;
      event.preventDefault();
      const box = this.svg.getBoundingClientRect(), factor = Math.exp(-0.0015 * event.deltaY * (event.deltaMode ? 20 : 1));
      this.view.zoom(factor, (event.clientX - box.left) * ratio(), (event.clientY - box.top) * ratio());
      this.draw();
    }, { passive: false });
  }
}

/* How many entries of an ordered array are at most x. */
function countUpTo(ordered, x) {
  let low = 0, high = ordered.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (ordered[middle] <= x) low = middle + 1;
    else high = middle;
  }
  return low;
}

/* A time with as many digits as tell neighbouring poses apart. */
function clock(time, all) {
  const span = all[all.length - 1] - all[0], step = span / Math.max(1, all.length - 1);
  const digits = span > 0 ? Math.min(9, Math.max(0, Math.ceil(-Math.log10(step)))) : 3;
  return time.toFixed(digits).replace("-", "−");
}
