/* Bodies one by one: their frames, what is told of the one that is chosen, following it, and the whole screen.
   report/drawing/bodies.py says what their tracks are. */

const AXES = [["x", "#d55e00"], ["y", "#009e73"], ["z", "#0072b2"]];
const AXIS = 0.1; // length of the axes of frames, of the drawing's size

/* A value of a track at a pose: it may be one number for all, an array, or a column of the drawing's vertices. */
function valueAt(track, pose) {
  if (track === null || typeof track === "number") return track ?? NaN;
  return track.array ? track.array[track.start + pose * track.step] : track[pose];
}
const tracked = (tracks, pose) => tracks.map((track) => valueAt(track, pose));
const originOf = (body, pose) => tracked(body.place, pose);

/* A vector turned by a unit quaternion (w, x, y, z). */
function rotated([w, ...r], a) {
  const twice = times(cross(r, a), 2);
  return plus(plus(a, twice, w), cross(r, twice));
}

/* The axes of the frames of all bodies, as they are seen. */
function axesOf(view) {
  return view.drawing.bodies.flatMap((body) => {
    const origin = originOf(body, view.pose), attitude = tracked(body.attitude, view.pose), foot = view.seen(origin);
    return AXES.flatMap(([letter, colour], k) => {
      const tip = view.seen(plus(origin, rotated(attitude, [0, 1, 2].map((n) => (n === k ? 1 : 0))), AXIS * view.drawing.size));
      return isPlace(foot) && isPlace(tip) && Math.hypot(tip[0] - foot[0], tip[1] - foot[1]) > 3 ? [{ letter, colour: inked(colour), ends: [foot, tip] }] : [];
    });
  });
}

class Bodies {
  constructor(player) {
    Object.assign(this, { player, chosen: null, select: player.find(".body"), box: player.find(".follow"), told: player.find(".told-body") });
    this.stored = { times: player.view.drawing.times, bodies: player.view.drawing.bodies };
    this.select?.addEventListener("change", () => this.choose(this.select.value === "" ? null : Number(this.select.value)));
    this.box?.addEventListener("change", () => {
      player.view.follow(this.box.checked ? this.chosen : null);
      if (!this.box.checked) { player.view.shift = [0, 0, 0]; player.view.changed(); }
      player.draw();
    });
    const full = player.find(".full");
    if (!full || !document.fullscreenEnabled) return;
    full.hidden = false;
    full.addEventListener("click", () => (document.fullscreenElement ? document.exitFullscreen() : player.figure.requestFullscreen()));
    document.addEventListener("fullscreenchange", () => {
      full.textContent = document.fullscreenElement === player.figure ? "leave full screen" : "full screen";
      player.resize();
    });
  }
  get all() { return this.player.view.drawing.bodies; }

  /* Another motion is shown: what is stored of bodies is not of it. */
  replaced() {
    const { drawing } = this.player.view, own = drawing.times === this.stored.times;
    drawing.bodies = own ? this.stored.bodies : [];
    if (this.select) this.select.disabled = !own;
    if (!own) this.choose(null);
  }
  choose(k) {
    this.chosen = k === null ? null : this.all[k];
    if (this.select) this.select.value = k === null ? "" : k;
    if (this.box) {
      this.box.disabled = k === null;
      if (k === null) this.box.checked = false;
    }
    const { view } = this.player;
    if (this.box?.checked) view.follow(this.chosen);
    else if (view.followed) { view.follow(null); view.shift = [0, 0, 0]; view.changed(); }
    this.player.shown.body = this.chosen ? this.chosen.name : null;
    this.tell();
    this.player.draw();
  }
  next(step) {
    if (!this.all.length) return;
    const count = this.all.length + 1, now = this.chosen ? this.all.indexOf(this.chosen) + 1 : 0, to = (now + step + count) % count;
    this.choose(to === 0 ? null : to - 1);
  }
  /* Choose the body at a place of the window, if there is one. */
  at(x, y) {
    const name = document.elementsFromPoint(x, y).map((node) => node.dataset?.body).find(Boolean), k = this.all.findIndex((body) => body.name === name);
    if (k >= 0) this.choose(k);
  }

  /* Say what the chosen body is and does at the time that is shown. */
  tell() {
    const { chosen, told, player } = this;
    if (!told) return;
    told.hidden = !chosen;
    if (!chosen) return;
    const rows = this.rows(chosen, player.view.pose);
    told.replaceChildren(named("strong", chosen.name), named("span", ` at t = ${clock(player.view.time, player.times)} s`));
    const table = document.createElement("table"), body = document.createElement("tbody");
    for (const [name, value] of rows) {
      const row = document.createElement("tr");
      row.append(named("th", name, { scope: "row" }), named("td", value));
      body.append(row);
    }
    table.append(body);
    told.append(table, named("small", "In the world's axes, four digits; the errors that these are to be read with stand below."));
  }
  rows(body, pose) {
    const place = originOf(body, pose), attitude = tracked(body.attitude, pose), [speed, spin] = tracked(body.speeds, pose);
    const vector = (a, unit) => `(${a.map((x) => text(x)).join(", ")}) ${unit}`, size = (a) => Math.hypot(...a), rows = [];
    rows.push(["mass", body.mass === null ? "not given" : `${text(body.mass, 6)} kg`], ["origin of its frame", vector(place, "m")]);
    if (body.centre) rows.push(["centre of mass", vector(plus(place, rotated(attitude, body.centre)), "m")]);
    rows.push(["turned", this.turned(attitude)]);
    if (Number.isFinite(speed)) rows.push([body.centre ? "speed of its centre of mass" : "speed of its origin", `${text(speed)} m/s`], ["turns with", `${text(spin)} rad/s`]);
    if (body.torque) rows.push([`actuator of ${body.joint}`, `${text(body.torque.values[pose])} ${body.torque.unit}`]);
    for (const arrow of this.player.view.drawing.arrows) {
      if (!body.loads.includes(arrow.name)) continue;
      const force = this.player.view.row(arrow.force, 0, 1, pose);
      rows.push([`${arrow.reaction ? "force in" : "force of"} ${arrow.name}`, `${text(size(force))} N: ${vector(force, "N")}`]);
    }
    return rows;
  }
  /* An attitude as an angle about an axis. */
  turned([w, ...r]) {
    const sine = Math.hypot(...r), angle = 2 * Math.atan2(sine, Math.abs(w));
    if (!Number.isFinite(angle)) return "–";
    if (angle < 1e-9) return "not at all";
    return `${text(180 * angle / Math.PI)}° about (${r.map((x) => text(x / sine * Math.sign(w || 1), 3)).join(", ")})`;
  }
}
