/* Given motions, along samples: torques (over/live/given.py), where they lead (over/live/moving.py), and how loops close
   along them for other lengths (over/live/follow.py). */

class Given extends Runner {
  constructor(data, module) {
    super(data, module);
    const count = this.count = data.motion.length / data.size, motion = this.motion = Float64Array.from(data.motion, Number);
    this.own = motion.slice(); // the motion with the values of the scene
    this.weights = Float64Array.from(data.weights, Number);
    this.all = Array.from({ length: count }, (_, n) => n);
    this.split();
  }

  /* Take the motion apart, into columns. */
  split() {
    const { data, count, motion } = this;
    this.columns = Array.from({ length: data.size }, (_, k) => Float64Array.from({ length: count }, (__, n) => motion[n * data.size + k]));
  }

  /* Rates (T, n) of joints with an actuator. */
  get rates() {
    const { data, count, motion } = this, n = data.rates.length, out = new Float64Array(count * n);
    for (let row = 0; row < count; row++) data.rates.forEach((place, k) => { out[row * n + k] = motion[row * data.size + place]; });
    return out;
  }

  sizes() {
    const { data } = this;
    return { given: 8 * data.keys.length, x: 8 * (data.size + data.keys.length + data.factors), table: 8 * data.numbers.length, results: 8 * this.largest };
  }
  connect() {}

  /* Put what equations read in place: a sample of the motion, and what each result is multiplied by. */
  at(n, factor) {
    const { data } = this, x = this.view("x", data.size + data.keys.length + data.factors);
    x.set(this.motion.subarray(n * data.size, (n + 1) * data.size));
    if (factor) for (let k = 0; k < data.factors; k++) x[data.size + data.keys.length + k] = factor(k);
  }

  /* Values of equations at some samples, by name of their outputs: rows, one a sample. */
  evaluated(name, samples, factor) {
    const outputs = Object.entries(this.data.outputs[name]), rows = Object.fromEntries(outputs.map(([key, size]) => [key, new Float64Array(samples.length * size)]));
    samples.forEach((n, row) => {
      this.at(n, factor && ((k) => factor(k, row)));
      this.code[name](this.place.x, this.place.table, this.place.results);
      let at = this.place.results / 8;
      for (const [key, size] of outputs) rows[key].set(this.doubles.subarray(at, (at += size)), row * size);
    });
    return rows;
  }

  /* Torques (T, n) of joints with an actuator, which bear loads (T, nv) with the loops. */
  borne({ load, psi }) {
    if (this.data.follow) {
      const found = this.rule("borne", { load, psi });
      if (!found.good[0]) this.refuse("borne");
      return found.tau;
    }
    const { weights, count } = this, nv = load.length / count, n = this.data.rates.length, tau = new Float64Array(count * n);
    if (!weights.length) return load;
    for (let row = 0; row < count * n; row++) for (let k = 0; k < nv; k++) tau[row] += weights[row * nv + k] * load[Math.floor(row / n) * nv + k];
    return tau;
  }

  /* How far rounding may have put any torque off: of draws in which each result is off by chance, draw 0 not. */
  rounding() {
    const { data } = this, { count, unit } = data.draws, { few } = data, parts = {};
    const chance = (at) => { // without order between -1 and 1, as in observe/rounding.py
      const x = Math.abs(Math.sin(12.9898 * (at + 1))) * 43758.5453;
      return 2 * (x - Math.floor(x)) - 1;
    };
    for (let draw = 0; draw <= count; draw++) {
      const rows = this.evaluated("load", few, (k, row) => 1 + (draw ? unit * chance((k * (count + 1) + draw) * few.length + row) : 0));
      for (const name in rows) parts[name] = joined([parts[name] || [], rows[name]]);
    }
    return this.rule("rounding", parts).rounding[0];
  }

  // -- motions that values change -------------------------------------------------------------------
  /* Entries of the motion (T, n): positions, rates or accelerations. */
  part(first, count) {
    const { data, motion } = this, out = new Float64Array(this.count * count);
    for (let n = 0; n < this.count; n++) out.set(motion.subarray(n * data.size + first, n * data.size + first + count), n * count);
    return out;
  }
  put(first, count, values) {
    const { data, motion } = this;
    for (let n = 0; n < this.count; n++) motion.set(values.subarray(n * count, (n + 1) * count), n * data.size + first);
  }
  get q() { return this.part(1, this.data.follow.nq); }

  /* Newton's method at samples from where they are; whether it settles. */
  moved(samples, rule) {
    const { data } = this, { rounds, settled, nq } = data.follow;
    for (let round = 0; round < rounds; round++) {
      const here = this.evaluated("here", samples).here, q = this.q.slice(0, samples.length * nq), { moves, most } = this.rule(rule, { here, q });
      samples.forEach((n) => { for (let k = 0; k < nq; k++) this.motion[n * data.size + 1 + k] += moves[n * nq + k]; });
      if (!(most[0] > settled)) return true;
    }
    return false;
  }

  /* Where the motion begins: loops closed from the scene's guess with what leads in place, then all conditions met. */
  begun() {
    const { data } = this, { start, closing, nq } = data.follow;
    let closed = Float64Array.from(start);
    if (closing) {
      this.loops = closing;
      closed = this.newton(this.loopsAt(closed), "free", closing.TINY).q;
    }
    this.motion.set(closed, 1);
    this.moved([0], "moves.start");
    const q = this.motion.slice(1, 1 + nq);
    if (data.rules.begun) {
      const { eta } = this.equations("loops", this.state(closed)), { cosines } = this.equations("loops", this.state(q));
      if (!this.rule("begun", { eta, cosines, q, closed }).good[0]) this.refuse("follow");
    }
    return q;
  }
  loopsAt(q) {
    const there = this.equations("loops", this.state(q)), { sizes } = this.loops;
    return { q, ...there, residual: there.eta.reduce((most, e, k) => Math.max(most, Math.abs(e / sizes[k])), 0) };
  }
  residual(q) { return this.loopsAt(q).residual; }

  /* What equations read for positions at the first sample. */
  state(q) {
    const x = this.own.slice(0, this.data.size);
    x.set(q, 1);
    return x;
  }

  /* The motion with other values, from that of the scene: at once, else in stages on the way to them. */
  follow(values) {
    const { data, own } = this, { stages, nq, nv } = data.follow;
    this.motion.set(own);
    if (values.every((x, k) => x === data.keys[k].value)) return;
    const start = this.begun();
    for (const count of stages) {
      this.motion.set(own);
      let good = true;
      for (let stage = 1; stage <= count && good; stage++) {
        this.setNumbers(values.map((x, k) => (stage === count ? x : data.keys[k].value + (x - data.keys[k].value) * stage / count)));
        good = this.moved(this.all, "moves");
      }
      if (!good) continue;
      const here = this.evaluated("here", this.all).here, q = this.q;
      this.put(1 + nq, nv, new Float64Array(this.count * nv));
      const v = this.rule("placed", { here, q, rates: this.evaluated("rates", this.all).rates }).v;
      this.put(1 + nq, nv, v);
      const a = this.rule("carried", { here, q, rates: this.evaluated("rates", this.all).rates }).a;
      this.put(1 + nq + nv, nv, a);
      if (this.rule("followed", { here, q, v, a, start }).good[0]) return;
    }
    this.refuse("follow");
  }

  made(values) {
    const { data } = this;
    this.setNumbers(values);
    const x = this.view("x", data.size + data.keys.length + data.factors);
    x.fill(1);
    x.set(values, data.size);
    if (data.follow) {
      this.follow(values);
      this.split();
    }
    if (data.outputs.inertia) this.require("definite", this.evaluated("inertia", data.few));
    return data.outputs.load ? this.loaded() : this.going();
  }

  /* The figures of a rule; rounding : of those that it puts off, too. */
  figures(inputs, rounding = 0) {
    const judged = this.rule("figures", inputs);
    if (judged.good && !judged.good[0]) this.refuse("finite");
    return this.data.figures.map(({ of, entry, rounded }) => ({ value: judged[of][entry], error: Math.max(judged[`${of}.error`][entry], rounded ? rounding : 0) }));
  }

  /* Figures of a motion without forces. */
  going() {
    const { data } = this, { q, v } = data, paths = data.outputs.paths ? this.evaluated("paths", this.all) : {};
    const [nq, nv] = [q.names.length, v.names.length], inputs = { ...paths, q: this.part(1, nq), v: this.part(1 + nq, nv), a: this.part(1 + nq + nv, nv) };
    if (!Object.values(inputs).every((x) => x.every(Number.isFinite))) this.refuse("finite");
    return { time: data.duration, figures: this.figures(inputs), times: this.columns[0], columns: this.columns, passed: [] };
  }

  /* Torques of a motion, and their figures. */
  loaded() {
    const { data, count } = this, tau = this.borne(this.evaluated("load", this.all, () => 1)), n = data.rates.length;
    if (!tau.every(Number.isFinite)) this.refuse("finite");
    const rounding = this.rounding(), figures = this.figures({ tau, qd: this.rates }, rounding);
    const torques = data.rates.map((_, k) => Float64Array.from({ length: count }, (__, row) => tau[row * n + k]));
    return { time: data.duration, figures, rounding, times: this.columns[0], columns: [...this.columns, ...torques], passed: [] };
  }
}
