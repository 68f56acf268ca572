/* Torques along a motion that values of keys do not change (over/live/given.py), with the figures of joints. */

class Given extends Runner {
  constructor(data, module) {
    super(data, module);
    const count = this.count = data.motion.length / data.size, motion = this.motion = Float64Array.from(data.motion, Number);
    this.weights = Float64Array.from(data.weights, Number);
    this.columns = Array.from({ length: data.size }, (_, k) => Float64Array.from({ length: count }, (__, n) => motion[n * data.size + k]));
    this.rates = new Float64Array(count * data.rates.length);
    for (let n = 0; n < count; n++) data.rates.forEach((place, k) => { this.rates[n * data.rates.length + k] = motion[n * data.size + place]; });
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
  borne(load) {
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

  made(values) {
    const { data, count } = this, all = Array.from({ length: count }, (_, n) => n);
    this.setNumbers(values);
    const x = this.view("x", data.size + data.keys.length + data.factors);
    x.fill(1);
    x.set(values, data.size);
    if (data.outputs.inertia) this.require("definite", this.evaluated("inertia", data.few));
    const tau = this.borne(this.evaluated("load", all, () => 1).load);
    if (!tau.every(Number.isFinite)) this.refuse("finite");
    const judged = this.rule("figures", { tau, qd: this.rates });
    if (judged.good && !judged.good[0]) this.refuse("figures");
    const rounding = this.rounding(), n = data.rates.length;
    const figures = data.figures.map(({ of, entry, rounded }) => ({ value: judged[of][entry], error: Math.max(judged[`${of}.error`][entry], rounded ? rounding : 0) }));
    const torques = data.rates.map((_, k) => Float64Array.from({ length: count }, (__, row) => tau[row * n + k]));
    return { time: data.duration, figures, rounding, times: this.columns[0], columns: [...this.columns, ...torques], passed: [] };
  }
}
