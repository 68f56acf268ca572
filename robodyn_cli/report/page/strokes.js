"use strict";
/* A mechanism as strokes, seen by a camera: what report/drawing/strokes.py and pins.py do for paper, here for SVG.
   Places in space are [x, y, z] in metres; places on the screen are [x, y, depth]: pixels, y downwards, and metres. */

const PT = 1.25; // pixels of a printer's point of the drawings on paper

// -- vectors --------------------------------------------------------------------------------------------------
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const plus = (a, b, factor = 1) => [a[0] + factor * b[0], a[1] + factor * b[1], a[2] + factor * b[2]];
const times = (a, factor) => [a[0] * factor, a[1] * factor, a[2] * factor];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const unit = (a) => times(a, 1 / Math.hypot(...a));
/* Turn a vector about a unit axis by an angle (Rodrigues). */
function turned(a, axis, angle) {
  const c = Math.cos(angle), s = Math.sin(angle);
  return plus(plus(times(a, c), cross(axis, a), s), axis, dot(axis, a) * (1 - c));
}
const isPlace = (p) => Number.isFinite(p[0]) && Number.isFinite(p[1]);

// -- the plane ------------------------------------------------------------------------------------------------
const ahead = (a, b) => {
  const length = Math.hypot(b[0] - a[0], b[1] - a[1]);
  return length > 1e-9 ? [(b[0] - a[0]) / length, (b[1] - a[1]) / length] : null;
};
const along = (a, d, length, e = [0, 0], more = 0) => [a[0] + length * d[0] + more * e[0], a[1] + length * d[1] + more * e[1]];
const leftOf = (d) => [-d[1], d[0]];

/* Corners of the convex hull (Andrew's monotone chain, 1979). */
function hull(points) {
  const rows = points.slice().sort((p, q) => p[0] - q[0] || p[1] - q[1]);
  if (rows.length <= 2) return rows;
  const side = (a, b, p) => (b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0]);
  const chain = (order) => {
    const found = [];
    for (const p of order) {
      while (found.length >= 2 && side(found[found.length - 2], found[found.length - 1], p) <= 0) found.pop();
      found.push(p);
    }
    return found.slice(0, -1);
  };
  return [...chain(rows), ...chain(rows.slice().reverse())];
}

/* Corners of a link: of its hull, or both ends where that is thinner than a pixel. */
function outline(points) {
  const corners = hull(points);
  if (corners.length <= 2) return corners;
  let ends = [corners[0], corners[0]], longest = 0;
  for (const a of corners) {
    for (const b of corners) {
      const length = Math.hypot(b[0] - a[0], b[1] - a[1]);
      if (length > longest) [ends, longest] = [[a, b], length];
    }
  }
  const d = ahead(...ends);
  if (d === null) return [corners[0]];
  const off = corners.map((p) => (p[0] - ends[0][0]) * -d[1] + (p[1] - ends[0][1]) * d[0]);
  return Math.max(...off) - Math.min(...off) > 1.3 ? corners : ends;
}

const circle = ([x, y], r) => `M${round(x - r)} ${round(y)}a${round(r)} ${round(r)} 0 1 0 ${round(2 * r)} 0a${round(r)} ${round(r)} 0 1 0 ${round(-2 * r)} 0Z`;
const round = (x) => Math.round(x * 20) / 20;

/* The path through points; one that is no place begins a new piece. */
function path(points, closed = false) {
  let text = "", pen = "M";
  for (const p of points) {
    if (isPlace(p)) {
      text += `${pen}${round(p[0])} ${round(p[1])}`;
      pen = "L";
    } else pen = "M";
  }
  return closed && text ? text + "Z" : text;
}

/* Numbers of the points that a line needs to stay within a tolerance of all (Douglas and Peucker, 1973). */
function needed(points, tolerance) {
  const keep = points.map((p, k) => k === 0 || k === points.length - 1 || !isPlace(p));
  const open = [[0, points.length - 1]];
  while (open.length) {
    const [first, last] = open.pop(), a = points[first], d = ahead(a, points[last]);
    let worst = 0, at = -1;
    for (let k = first + 1; k < last; k++) {
      const x = points[k][0] - a[0], y = points[k][1] - a[1];
      const off = isPlace(points[k]) ? (d ? Math.abs(x * d[1] - y * d[0]) : Math.hypot(x, y)) : Infinity;
      if (off > worst || (Number.isNaN(off) && at < 0)) [worst, at] = [off, k];
    }
    if (at < 0 || worst <= tolerance) continue;
    keep[at] = true;
    open.push([first, at], [at, last]);
  }
  return keep.flatMap((wanted, k) => (wanted ? [k] : []));
}

function block(centre, d, length, width) {
  const n = leftOf(d), a = length / 2, b = width / 2;
  return [along(centre, d, -a, n, -b), along(centre, d, a, n, -b), along(centre, d, a, n, b), along(centre, d, -a, n, b)];
}

function zigzag(a, b, width, teeth = 14) {
  const d = ahead(a, b);
  if (d === null) return [a, b];
  const length = Math.hypot(b[0] - a[0], b[1] - a[1]), n = leftOf(d), found = [a, along(a, d, 0.12 * length)];
  for (let k = 0; k < teeth; k++) {
    found.push(along(a, d, (0.12 + 0.76 * (k + 0.5) / teeth) * length, n, (k % 2 ? -0.5 : 0.5) * width));
  }
  return [...found, along(a, d, 0.88 * length), b];
}

function dashpot(a, b, width) {
  const d = ahead(a, b);
  if (d === null) return path([a, b]);
  const L = Math.hypot(b[0] - a[0], b[1] - a[1]), n = leftOf(d), w = width / 2;
  const at = (part, off) => along(a, d, part * L, n, off);
  return path([a, at(0.35, 0)]) + path([at(0.65, w), at(0.35, w), at(0.35, -w), at(0.65, -w)])
    + path([at(0.5, 0.7 * w), at(0.5, -0.7 * w)]) + path([at(0.5, 0), b]);
}

function coil(centre, radius) {
  const found = [];
  for (let k = 0; k < 60; k++) {
    const angle = 5 * Math.PI * k / 59, r = radius * (0.35 + 0.65 * k / 59);
    found.push([centre[0] + r * Math.cos(angle), centre[1] - r * Math.sin(angle)]);
  }
  return path(found);
}

function rotaryDashpot(centre, radius) {
  const arc = (part, first, last) => Array.from({ length: 9 }, (_, k) => {
    const angle = Math.PI / 180 * (first + (last - first) * k / 8);
    return [centre[0] + part * radius * Math.cos(angle), centre[1] - part * radius * Math.sin(angle)];
  });
  const middle = [centre[0], centre[1]];
  return path([middle, ...arc(0.8, 175, 110)]) + path([...arc(1, 68, 110), ...arc(0.6, 110, 68)])
    + path([arc(0.94, 88, 88)[0], arc(0.66, 88, 88)[0]]) + path([...arc(0.8, 88, 5), middle]);
}

const about = (kind, centre, radius, beside) => kind === "spring" ? coil(centre, (beside ? 0.62 : 1) * radius)
  : rotaryDashpot(centre, (beside ? 1.25 : 1) * radius);

function hatching(a, b, down, size) {
  const d = ahead(a, b);
  if (d === null) return path([a, b]);
  const length = Math.hypot(b[0] - a[0], b[1] - a[1]);
  const count = Math.min(60, Math.max(1, Math.floor(length / (0.34 * size))));
  let text = path([a, b]);
  for (let k = 0; k < count; k++) {
    const foot = along(a, d, (k + 0.7) / count * length);
    text += path([foot, along(foot, down, 0.226 * size, d, -0.226 * size)]);
  }
  return text;
}

// -- strokes --------------------------------------------------------------------------------------------------
const GHOSTS = 7; // positions of a link that are seen at once
const CHOSEN = "var(--alarm)"; // the rim of the body that is told of
const BODIES = ["link", "solid", "shape"]; // kinds of parts that are bodies, and not what joins them
const LAYERS = { grid: 0, shadow: 1, ground: 2, trail: 3, body: 4, onTop: 5, latch: 6, load: 7 };
const INK = "var(--ink)", PAPER = "var(--paper)", ALARM = "var(--alarm)", REACTION = "#cc79a7";
/* A colour with a part of another one in it; the theme says what ink and paper are. */
const mixed = (colour, other, part) => `color-mix(in srgb, ${colour} ${Math.round(100 * (1 - part))}%, ${other})`;
const FAINT = mixed(INK, PAPER, 0.84), GRID_LINES = mixed(INK, PAPER, 0.88), GREY = mixed(INK, PAPER, 0.45);
/* Colours of the palette that are weak on a dark page are named by the theme. */
const NAMED = { "#000000": INK, "#0072b2": "var(--blue)", "#5f5f5f": "var(--grey)", "#7f7f7f": "var(--grey)", "#d55e00": ALARM };
const inked = (colour) => NAMED[colour.toLowerCase()] || (isDark(colour) ? `color-mix(in srgb, ${colour}, #ffffff var(--lift))` : colour);
/* Tell whether a colour #rrggbb is dark (its luma by Rec. 601). */
function isDark(colour) {
  const [r, g, b] = [1, 3, 5].map((k) => parseInt(colour.slice(k, k + 2), 16));
  return 0.299 * r + 0.587 * g + 0.114 * b < 110;
}

class Strokes {
  /* view : a View of player.js at its present pose. shown : which layers are wanted. */
  constructor(view, shown) {
    this.view = view;
    this.drawing = view.drawing;
    this.shown = shown;
    this.found = [];
    const width = this.drawing.length ? 0.11 * this.drawing.length * view.scale / PT : 6;
    this.width = PT * Math.min(9, Math.max(1, width)); // of links, in pixels
    this.finer = Math.min(1, this.width / (2.2 * PT)); // factor of marks and their lines, so that they do not hide links
    this.radius = PT * this.finer * Math.min(4, 0.36 * Math.max(this.width / PT, 2.2) + 0.9); // of joints
    this.colours = new Map(this.drawing.parts.filter((p) => p.kind === "link").flatMap((p) => p.vertices.map((v) => [v, inked(p.colour)])));
  }

  /* body : the link that a stroke is of, for those who click on it. */
  add(d, layer, depth, look, part = "") {
    if (d) this.found.push({ d, layer: LAYERS[layer], depth, width: 1, fill: "none", colour: INK, dash: "", body: this.owner || "", ...look, part });
  }

  all() {
    this.grid();
    if (!this.view.flat) this.shadows();
    if (this.shown.trails) this.trails();
    if (this.shown.ghosts) this.ghosts();
    this.drawing.parts.forEach((part, place) => {
      this.owner = BODIES.includes(part.kind) ? part.name : "";
      this.part(part, place);
    });
    this.owner = "";
    if (this.shown.masses) this.masses();
    this.bobs();
    for (const pin of this.drawing.pins) this.pin(pin);
    for (const latch of this.drawing.latches) this.latch(latch);
    this.arrows();
    if (this.shown.frames) this.frames();
    this.found.sort((a, b) => a.layer - b.layer || a.depth - b.depth);
    return this.found;
  }

  grid() {
    const lines = this.view.gridLines().map((line) => path(line)).join("");
    this.add(lines, "grid", 0, { colour: GRID_LINES });
  }

  shadows() {
    for (const part of this.drawing.parts) {
      if (!["link", "solid", "payload", "shape", "bar"].includes(part.kind) || part.vertices.length < 2) continue;
      const places = part.surface ? placesOf(part, this.view) : part.vertices.map((v) => this.view.place(v));
      const points = places.map((p) => this.view.seen(this.view.onGround(p)));
      if (!points.every(isPlace)) continue;
      const corners = outline(points), closed = corners.length > 2;
      this.add(path(corners, closed), "shadow", 0, { colour: FAINT, fill: closed ? FAINT : "none", width: 3 });
    }
  }

  trails() {
    for (const trail of this.drawing.trails) {
      const { points, kept, d, ends } = this.view.trail(trail), colour = inked(trail.colour);
      const passed = countUpTo(trail.times, this.view.time), whole = countUpTo(kept, passed - 1);
      this.add(d, "trail", 0, { colour: mixed(colour, PAPER, 0.65), width: 1.2 });
      if (passed < 2) continue;
      const [x, y] = points[passed - 1], end = isPlace([x, y]) ? `L${round(x)} ${round(y)}` : "";
      this.add(d.slice(0, ends[whole - 1]) + end, "trail", 1, { colour, width: 1.8 });
    }
  }

  /* Links where they are at some other times, pale: the same until the camera moves. */
  ghosts() {
    const found = this.view.once("ghosts", () => {
      const last = this.drawing.times.length - 1, poses = Array.from({ length: GHOSTS }, (_, k) => Math.round(last * k / (GHOSTS - 1)));
      return this.drawing.parts.filter((part) => ["link", "solid"].includes(part.kind) && part.vertices.length > 1).flatMap((part) => poses.map((pose) => {
        const points = part.vertices.map((v) => this.view.seen(this.view.place(v, pose)));
        return { d: points.every(isPlace) ? path(outline(points), points.length > 2) : "", colour: mixed(inked(part.colour), PAPER, 0.7) };
      }));
    });
    for (const { d, colour } of found) this.add(d, "trail", -1, { colour, width: Math.max(1.5, 0.35 * this.width) });
  }

  /* The axes of the links' frames, with their letters in player.js. */
  frames() {
    for (const axis of axesOf(this.view)) this.add(path(axis.ends), "load", 1, { colour: axis.colour, width: 2 });
  }

  part(part, place) {
    const corners = part.vertices.map((v) => this.view.at(v));
    if (!corners.length || !corners.every(isPlace)) return;
    const depth = this.view.flat ? 1e-3 * place : corners.reduce((sum, p) => sum + p[2], 0) / corners.length;
    if (["link", "ground"].includes(part.kind) && this.drawing.shaped.has(part.name)) return;
    const name = `${part.kind} ${part.name}`, colour = inked(part.colour);
    if (part.kind === "link") {
      if (corners.length > 1) this.body(outline(corners), colour, this.width, depth, name);
    } else if (part.surface) {
      for (const [d, at, look] of solid(part, this.view, colour, depth)) this.add(d, "body", at, this.isChosen ? { ...look, colour: CHOSEN } : look, name);
    } else if (part.kind === "ground") this.ground(corners, name);
    else this.connector(part, ...corners.slice(0, 2), depth, name);
  }

  get isChosen() { return this.owner !== "" && this.owner === this.shown.body; }

  /* A bar with round ends, or a plate with round corners. */
  body(points, colour, width, depth, name) {
    const dark = this.isChosen ? CHOSEN : mixed(colour, INK, 0.35), light = mixed(colour, PAPER, 0.62), closed = points.length > 2;
    const d = path(points, closed), rim = Math.min(1.3, 0.25 * width);
    this.add(d, "body", depth, { colour: dark, width, fill: closed ? dark : "none" }, name);
    this.add(d, "body", depth, { colour: light, width: width - 2 * rim, fill: closed ? light : "none" });
  }

  ground(corners, name) {
    if (corners.length < 2) return;
    const points = outline(corners), closed = points.length > 2 && !this.view.flat;
    const look = { colour: mixed(INK, PAPER, 0.72), width: 2, fill: closed ? mixed(INK, PAPER, 0.92) : "none" };
    this.add(path(points, closed), "ground", 0, { ...look, dash: this.view.flat ? "5 4" : "" }, name);
  }

  /* What joins two places: a bar, a rail, a rope, a spring, a damper; of two that lie side by side each has its side. */
  connector(part, a, b, depth, name) {
    const d = ahead(a, b);
    if (part.aside && d && !["coil", "rotary_damper"].includes(part.kind)) [a, b] = [a, b].map((p) => along(p, leftOf(d), 6 * PT * part.aside));
    const line = { width: 1.4 };
    if (part.kind === "bar") this.body([a, b], "var(--grey)", 3.6 * PT, depth, name);
    else if (part.kind === "rail") this.add(path([a, b]), "body", depth - 1e-6, { colour: GREY, width: 1.4, dash: "5 4" }, name);
    else if (part.kind === "rope") this.add(path([a, b]), "body", depth, { ...line, dash: "5 4" }, name);
    else if (part.kind === "damper") this.add(dashpot(a, b, 8 * PT), "onTop", depth, line, name);
    else if (part.kind === "coil") this.add(about("spring", b, 8 * PT, part.aside !== 0), "onTop", depth, line, name);
    else if (part.kind === "rotary_damper") this.add(about("damper", b, 8 * PT, part.aside !== 0), "onTop", depth, line, name);
    else if (part.kind === "bushing") {
      const centre = [(a[0] + b[0]) / 2, (a[1] + b[1]) / 2];
      this.add(path(block(centre, [1, 0], 9 * PT, 9 * PT), true), "onTop", depth, { ...line, fill: FAINT }, name);
    } else this.add(path(zigzag(a, b, 9 * PT)), "onTop", depth, line, name);
  }

  /* Discs for bodies without extent; the block of a slider is its body. */
  bobs() {
    const sliders = new Set(this.drawing.pins.filter((p) => ["slide", "sleeve", "table"].includes(p.kind)).map((p) => p.vertex));
    for (const vertex of this.drawing.bobs) {
      const at = this.view.at(vertex), colour = this.colours.get(vertex) || INK;
      if (sliders.has(vertex) || !isPlace(at)) continue;
      const look = { colour: mixed(colour, INK, 0.35), fill: mixed(colour, PAPER, 0.5), width: 1.2 };
      this.add(circle(at, 0.55 * this.width + 2.5 * PT * this.finer), this.front, at[2] + this.bias, look);
    }
  }

  /* In space bodies in front hide a mark; its own body does not. */
  get front() { return this.view.flat ? "onTop" : "body"; }
  get bias() { return this.view.flat || this.drawing.shaped.size ? 0 : 0.02 * this.drawing.size; }

  masses() {
    const r = PT * this.finer * Math.min(3.2, Math.max(1.6, 0.36 * this.width / PT));
    for (const vertex of this.drawing.masses) {
      const [x, y, depth] = this.view.at(vertex);
      if (!isPlace([x, y])) continue;
      this.add(circle([x, y], r), this.front, depth + this.bias, { fill: PAPER, width: 0.8 * this.finer });
      const quarter = (s) => `M${round(x)} ${round(y)}h${round(s * r)}A${round(r)} ${round(r)} 0 0 0 ${round(x)} ${round(y - s * r)}Z`;
      this.add(quarter(1) + quarter(-1), this.front, depth + this.bias, { fill: INK, width: 0 });
    }
  }

  // -- joints ---------------------------------------------------------------------------------------------------
  pin(pin) {
    const at = this.view.at(pin.vertex);
    if (!isPlace(at)) return;
    const r = this.radius, depth = at[2] + this.bias;
    if (pin.grounded && this.view.flat) this.support(pin, at, r);
    const mark = (d, { width = 1.3, ...look }) => this.add(d, this.front, depth, { width: width * this.finer, ...look }, `joint ${pin.name}`);
    const reach = Math.min(3.2 * r, 0.3 * pin.room * this.view.scale); // no room, no symbol
    if (reach >= Math.max(2.5 * r, 4.2 * PT)) for (const kind of pin.about) mark(about(kind, at, reach, pin.about.length > 1), {});
    if (pin.kind === "weld") mark(path(block(at, [1, 0], 2 * r, 2 * r), true), { fill: INK });
    else if (pin.kind === "table") mark(path(block(at, [1, 0], 4 * r, 4 * r), true), { fill: PAPER });
    else if (pin.kind === "slide" || pin.kind === "sleeve") {
      const d = this.direction(pin, 0);
      mark(path(block(at, d || [1, 0], d ? 4.8 * r : 3 * r, 3 * r), true), { fill: mixed(inked(pin.colour), PAPER, 0.6) });
      if (pin.kind === "sleeve") mark(circle(at, 0.7 * r), { fill: PAPER });
    } else if (pin.kind === "hinge" && !this.view.flat && pin.axes.length) this.cylinder(pin, r, mark);
    else {
      mark(circle(at, pin.kind === "ball" ? 1.15 * r : r), { fill: pin.kind === "ball" ? mixed(INK, PAPER, 0.75) : PAPER, width: 1.4 });
      if (pin.kind === "cross") {
        for (let k = 0; k < pin.axes.length; k++) {
          const d = this.direction(pin, k);
          if (d) mark(path([along(at, d, -1.5 * r), along(at, d, 1.5 * r)]), {});
        }
      }
    }
  }

  /* A short cylinder along the axis of a hinge, with the rim that looks to the eye. */
  cylinder(pin, r, mark) {
    const axis = this.view.axis(pin.axes[0]), place = this.view.place(pin.vertex);
    if (!isPlace(axis)) return;
    const helper = [0, 0, 0];
    helper[axis.map(Math.abs).indexOf(Math.min(...axis.map(Math.abs)))] = 1;
    const u = unit(cross(axis, helper)), v = cross(axis, u), metres = r / this.view.scale;
    const rim = (side) => Array.from({ length: 20 }, (_, k) => {
      const angle = 2 * Math.PI * k / 20;
      const around = plus(times(u, 1.15 * metres * Math.cos(angle)), v, 1.15 * metres * Math.sin(angle));
      return this.view.seen(plus(plus(place, axis, 1.9 * side * metres), around));
    });
    const rims = [rim(1), rim(-1)], depths = rims.map((points) => points.reduce((sum, p) => sum + p[2], 0));
    mark(path(hull(rims.flat()), true), { fill: mixed(INK, PAPER, 0.78) });
    mark(path(depths[0] > depths[1] ? rims[0] : rims[1], true), { fill: PAPER, width: 0.9 });
  }

  /* Direction of an axis on the screen, null where it points to the eye. */
  direction(pin, number) {
    if (number >= pin.axes.length) return null;
    const place = this.view.place(pin.vertex), reach = 1e-3 * this.drawing.size;
    const [a, b] = [place, plus(place, this.view.axis(pin.axes[number]), reach)].map((p) => this.view.seen(p));
    return Math.hypot(b[0] - a[0], b[1] - a[1]) > 0.2 * reach * this.view.scale ? ahead(a, b) : null;
  }

  /* What a joint on the ground stands on: a triangle, or below a slide the line that it slides along. */
  support(pin, at, r) {
    const size = 11 * PT * Math.min(1, r / (3 * PT)), hatched = { colour: GREY, width: 1.2 * this.finer };
    if (pin.kind === "slide" || pin.kind === "sleeve") {
      const d = this.direction(pin, 0);
      if (!d) return;
      const down = d[0] >= 0 ? leftOf(d) : times([...leftOf(d), 0], -1);
      const [low, high] = this.view.reach(pin.vertex, at, d);
      this.add(hatching(along(at, d, low - 4 * r, down, 1.6 * r), along(at, d, high + 4 * r, down, 1.6 * r), down, size), "ground", 0, hatched);
    } else if (["hinge", "ball", "cross"].includes(pin.kind)) {
      const down = this.view.down(), across = leftOf(down), foot = along(at, down, size);
      const [left, right] = [along(foot, across, 0.62 * size), along(foot, across, -0.62 * size)];
      this.add(path([at, left, right], true), "ground", 0, { width: 1.3 * this.finer, fill: mixed(INK, PAPER, 0.86) });
      this.add(hatching(along(left, across, 0.3 * size), along(right, across, -0.3 * size), down, size), "ground", 0, hatched);
    }
  }

  // -- latch and loads --------------------------------------------------------------------------------------------
  /* A hook on the latch's first link, and while it is closed a plate across the joint. */
  latch(latch) {
    const [a, joint, b] = latch.vertices.map((v) => this.view.at(v));
    if (![a, joint, b].every(isPlace)) return;
    const time = this.view.time, closed = latch.closed.some(([start, end]) => time >= start * (1 - 1e-12) && (end === null || time < end));
    const reach = 2 * this.width + 4 * PT * this.finer, colour = closed ? ALARM : mixed(INK, PAPER, 0.3);
    const arms = [ahead(joint, a), ahead(joint, b)].filter((d) => d).map((d) => along(joint, d, reach));
    for (const arm of closed ? arms : arms.slice(0, 1)) {
      this.add(path([joint, arm]), "latch", 0, { colour, width: Math.max(0.45 * this.width, 2.6 * this.finer) }, closed ? "latch closed" : "latch open");
      this.add(circle(arm, 0.3 * this.width), "latch", 1, { colour, fill: PAPER });
    }
    if (closed) this.add(circle(joint, 1.3 * this.width), "latch", 2, { colour: ALARM, width: 1.9 * this.finer });
  }

  arrows() {
    for (const arrow of this.drawing.arrows) {
      if (!this.shown[arrow.reaction ? "reactions" : "arrows"]) continue;
      const place = this.view.place(arrow.vertex), force = this.view.row(arrow.force, 0, 1);
      const [tail, tip] = [place, plus(place, force, this.drawing.arrow)].map((p) => this.view.seen(p));
      const length = Math.hypot(tip[0] - tail[0], tip[1] - tail[1]);
      if (!(length > 3)) continue;
      const d = ahead(tail, tip), colour = arrow.reaction ? REACTION : ALARM, head = Math.min(9, length / 2);
      const neck = along(tip, d, -head), n = leftOf(d);
      this.add(path([tail, neck]), "load", 0, { colour, width: 2 }, `force ${arrow.name}`);
      this.add(path([tip, along(neck, n, 0.4 * head), along(neck, n, -0.4 * head)], true), "load", 0, { colour, fill: colour, width: 0.8 });
    }
  }
}
