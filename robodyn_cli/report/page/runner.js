/* Runs of a scene's compiled stepping loop. What is made and how it is judged are data of Python (over/live); here they
   are put in order: numbers, start, first run, second run, a third. */

const PAGE = 65536, STACK = 1 << 20, LINE = 64; // bytes
const SAME = 1e-10; // rad or m between poses that closing led to twice

class Refused extends Error {
  constructor(reason, words) {
    super(words);
    this.reason = reason;
  }
}

class Runner {
  static async of(data, bytes) {
    return new (data.motion ? Given : Runner)(data, await WebAssembly.compile(bytes));
  }

  constructor(data, module) {
    this.data = data;
    this.loops = data.start.closing;
    const place = this.place = this.arranged(), end = place.end;
    const memory = new WebAssembly.Memory({ initial: Math.ceil(end / PAGE) }), env = { __linear_memory: memory };
    env.__stack_pointer = new WebAssembly.Global({ value: "i32", mutable: true }, place.stack);
    env.__indirect_function_table = new WebAssembly.Table({ initial: 16, element: "anyfunc" });
    for (const name of data.code.imports) env[name] = Math[name];
    env.passed = (time, event) => { this.passed.push({ time, event }); };
    this.code = new WebAssembly.Instance(module, { env }).exports;
    this.doubles = new Float64Array(memory.buffer);
    this.integers = new BigInt64Array(memory.buffer);
    this.connect();
  }

  /* Where everything lies: constants, the stack, then the arrays, each where a vector may begin. */
  arranged() {
    const place = { stack: (this.data.code.constants + STACK) & -LINE }, sizes = this.sizes();
    let at = place.stack;
    for (const name in sizes) {
      place[name] = at;
      at = (at + sizes[name] + 8 + LINE - 1) & -LINE;
    }
    return { ...place, end: at };
  }

  /* The bytes of each array. */
  sizes() {
    const { data } = this, { memory } = data, nx = data.size, count = data.events.length;
    const samples = Math.max(data.first.n[data.counts.LAST_SAMPLE], data.picture ? data.shown : 0, 1);
    this.bytes = { w: 8 * memory.w, n: 8 * data.first.n.length, y: 8 * nx, p: 8 * memory.parameters.length,
      numbers: 8 * data.own, out: 8 * nx * samples };
    const sizes = { block: memory.block, saved: memory.block, clear: memory.block, p: this.bytes.p, ...memory.fixed, values: 8 * count,
      bracket: 16 * (1 + count), stretches: 8 * memory.stretches.length, places: 8 * memory.places.length, job: 8 * memory.job.length, stop: 8, status: 8,
      given: 8 * data.keys.length, x: 8 * nx, table: 8 * data.numbers.length, results: 8 * this.largest };
    for (const name in this.bytes) sizes[`all.${name}`] = this.bytes[name];
    return sizes;
  }

  /* The most outputs of any equations. */
  get largest() { return Math.max(1, ...Object.values(this.data.outputs).map((own) => Object.values(own).reduce((a, b) => a + b, 0))); }

  connect() {
    const { data, place, bytes } = this, { memory } = data;
    const where = { ...place, out: place["all.out"], bytes: memory.block };
    for (const [name, first] of Object.entries(memory.parts)) where[name] = place.block + first;
    memory.places.forEach((name, k) => this.setInteger("places", k, where[name] || 0));
    const job = { stop: place.stop, clear: place.clear, events: data.events.length, passing: data.passing, "all.status": place.status,
      stops: memory.stretches.length / 3, stretches: place.stretches };
    for (const name in bytes) Object.assign(job, { [`all.${name}`]: place[`all.${name}`], [`bytes.${name}`]: bytes[name] });
    memory.job.forEach((name, k) => this.setInteger("job", k, job[name] || 0));
    for (const name of ["stretches", "updates"]) this.view(name, memory[name].length).set(memory[name].map(Number));
    if (this.code.watch) this.code.watch(place.job);
  }

  view(name, count) { return this.doubles.subarray(this.place[name] / 8, this.place[name] / 8 + count); }
  setInteger(name, k, value) { this.integers[this.place[name] / 8 + k] = BigInt(value); }
  integer(name, k) { return Number(this.integers[this.place[name] / 8 + k]); }

  rule(name, inputs = {}) { return judged(this.data.rules[name], inputs); }

  require(name, inputs) {
    if (this.data.rules[name] && !this.rule(name, inputs).good[0]) this.refuse(name);
  }

  refuse(reason, more = "") { throw new Refused(reason, this.data.reasons[reason] + more); }

  /* Equations of the page at a state, by name of their outputs. */
  equations(name, x) {
    const { data } = this, outputs = data.outputs[name];
    this.view("x", data.size).set(x);
    this.code[name](this.place.x, this.place.table, this.place.results);
    let at = this.place.results / 8;
    return Object.fromEntries(Object.entries(outputs).map(([key, count]) => [key, this.doubles.slice(at, (at += count))]));
  }

  /* Equations along a run, by name of their outputs: rows of single precision, one a sample. */
  along(name, columns) {
    const { data } = this, outputs = Object.entries(data.outputs[name]), count = columns[0].length, x = this.view("x", data.size);
    const results = this.view("results", outputs.reduce((sum, [, size]) => sum + size, 0));
    const rows = outputs.map(([, size]) => new Float32Array(count * size));
    for (let n = 0; n < count; n++) {
      for (let k = 0; k < x.length; k++) x[k] = columns[k][n];
      this.code[name](this.place.x, this.place.table, this.place.results);
      let at = 0;
      outputs.forEach(([, size], k) => { rows[k].set(results.subarray(at, (at += size)), n * size); });
    }
    return Object.fromEntries(outputs.map(([key], k) => [key, rows[k]]));
  }

  // -- before a run --------------------------------------------------------------------------------
  /* Set the tables of numbers. */
  setNumbers(values) {
    const { data } = this;
    data.keys.forEach((key, k) => {
      if (!(values[k] >= key.low && values[k] <= key.high)) this.refuse("range", ` (${key.name})`);
      if (key.special.includes(values[k])) this.refuse("special", ` (${key.name})`);
    });
    const given = values.filter((_, k) => !data.keys[k].start);
    this.view("given", given.length).set(given);
    this.view("table", data.numbers.length).set(data.numbers.map(Number));
    if (this.code.numbers(this.place.given, this.place.table) !== 1n) this.refuse("structure");
  }

  /* The state that values start from. */
  start(values) {
    const { data } = this, own = data.start.own;
    if (this.loops && values.every((x, k) => x === data.keys[k].value)) return this.state(own.q, own.v);
    const q = data.start.q.slice(), v = data.start.v.slice();
    data.keys.forEach((key, k) => { if (key.start) (key.start[0] === "q" ? q : v)[key.start[1]] = values[k]; });
    return this.loops ? this.closed(q, Float64Array.from(v)) : this.state(q, v);
  }

  /* The state in which loops close from q, as the command closes them: from many starts, of which the nearest counts. */
  closed(q, v) {
    const { CLOSED, TINY, missing, free, stages } = this.loops, start = Float64Array.from(q);
    const one = (x) => Float64Array.of(x);
    let best = { "best.q": start, "best.distance": one(Infinity), "best.full": one(-1), "best.sure": one(1) };
    const { size } = this.equations("loops", this.state(start, v));
    for (const { columns, starts, parts } of stages) {
      const seen = [];
      if (best["best.full"][0] >= 0) break;
      for (let k = 0; k < starts; k++) {
        const part = new Float64Array(q.length);
        columns.forEach((column, n) => { part[column] = parts[k * columns.length + n]; });
        let there = this.loopsAt(this.rule("begin", { q: start, size, part }).q);
        if (missing.length) there = this.newton(there, "missing", CLOSED);
        if (free.length) there = this.newton(there, "free", CLOSED);
        // most starts lead to few poses
        if (!(there.residual <= CLOSED) || seen.some((other) => there.q.every((x, i) => Math.abs(x - other[i]) < SAME))) continue;
        seen.push(there.q);
        const turned = missing.length ? this.loopsAt(this.rule("wrapped", there).q) : there;
        if (turned.residual <= CLOSED) there = turned;
        best = this.rule("preferred", { ...best, ...there, start });
      }
    }
    const found = this.loopsAt(best["best.q"]), there = free.length ? this.newton(found, "free", TINY) : found, judgement = this.rule("closed", { ...best, ...there, v });
    if (!judgement.good[0]) this.refuse("closed");
    return this.state(there.q, judgement.v);
  }

  state(q, v) {
    const { data } = this, x = (this.own ||= Float64Array.from(data.state, Number)).slice(); // with states of a controller
    for (let k = 0; k < q.length; k++) x[data.q.places[k]] = q[k];
    for (let k = 0; k < v.length; k++) x[data.v.places[k]] = v[k];
    return x;
  }

  /* The largest residual of the loops at positions q, in parts of its size. */
  residual(q) {
    const { data, doubles } = this, at = this.place.results / 8, { eta, psi, cosines } = data.outputs.loops, { long } = this.loops;
    this.view("x", data.size).set(this.state(q, q));
    this.code.loops(this.place.x, this.place.table, this.place.results);
    const size = doubles[at + eta + psi + cosines];
    let most = 0;
    for (let k = 0; k < eta; k++) most = Math.max(most, Math.abs(long[k] ? doubles[at + k] / size : doubles[at + k]));
    return most;
  }

  loopsAt(q) {
    const residual = this.residual(q), { eta, psi, cosines } = this.data.outputs.loops, first = this.place.results / 8;
    let at = first;
    const next = (count) => this.doubles.slice(at, (at += count));
    return { q, residual, eta: next(eta), psi: next(psi), cosines: next(cosines), size: next(1) };
  }

  /* Damped Gauss-Newton steps of some coordinates onto the loops, as newton_of_many makes them. */
  newton(here, columns, enough) {
    const { ITERATIONS, HALVINGS, PATIENT, CLOSED } = this.loops;
    let slow = 0;
    for (let round = 0; round < ITERATIONS && here.residual > enough && slow <= PATIENT; round++) {
      const { step } = this.rule(`step.${columns}`, here);
      let next = null, part = 1;
      for (let k = 0; k < HALVINGS; k++, part *= 0.5) {
        const trial = here.q.map((x, i) => x + part * step[i]);
        if (this.residual(trial) < here.residual) next = this.loopsAt(trial);
        if (next || here.residual <= CLOSED) break;
      }
      if (!next) break;
      slow = next.residual > 0.5 * here.residual ? slow + 1 : 0;
      here = next;
    }
    return here;
  }

  // -- runs ----------------------------------------------------------------------------------------
  /* One integration; made : its row of doubles, by its rule. */
  drive(spec, x, made) {
    const { data, place } = this, { counts } = data;
    this.view("all.w", made.w.length).set(made.w);
    spec.n.forEach((n, k) => this.setInteger("all.n", k, n));
    this.setInteger("all.n", counts.MAX_STEPS, spec.most ?? Math.round(made.most[0]));
    this.view("all.y", data.size).set(x);
    this.view("all.p", data.memory.parameters.length).set(data.memory.parameters);
    const numbers = this.view("all.numbers", data.own), table = this.view("table", data.own), off = data.off[spec.draw];
    for (let k = 0; k < data.own; k++) numbers[k] = off ? table[k] * (1 + off[k] * 2 ** -53) : table[k];
    this.passed = [];
    this.code.drive(place.places, place.job);
    const status = this.integer("status", 0), event = this.integer("all.n", counts.EVENT), located = this.integer("all.n", counts.LOCATED) === data.location.EVENT;
    return {
      status: Object.keys(data.status).find((name) => data.status[name] === status),
      event: status === data.status.EVENT && located ? event : -1, met: event,
      time: Float64Array.of(this.doubles[place["all.w"] / 8 + data.slots.time]),
      steps: Float64Array.of(this.integer("all.n", counts.ACCEPTED)),
      end: this.view("all.y", data.size).slice(), passed: this.passed,
      made: Math.min(this.integer("all.n", counts.NEXT_SAMPLE) - 1, spec.n[counts.LAST_SAMPLE]),
      out: this.view("all.out", data.size * Math.max(spec.n[counts.LAST_SAMPLE], 0)).slice(),
    };
  }

  arrived(run) {
    const { data } = this, finite = run.end.every(Number.isFinite);
    return finite && (data.locks ? data.dead.includes(run.event) : run.status === "DONE");
  }

  /* The last of several integrations that is made, as integrate_again makes them; null where it does not arrive. */
  again(specs, x, first) {
    const inputs = { steps: first.steps, time: first.time, ...NOT_MADE };
    let run = null;
    for (const spec of specs) {
      const made = this.rule(spec.rule, inputs);
      if (!made.when[0]) continue;
      const begun = run;
      run = this.drive(spec, x, made);
      if (begun) continue;
      // what failed otherwise than by its number of steps is not made once more
      inputs["again.steps"] = this.arrived(run) ? run.steps : Float64Array.of(Infinity);
      inputs["again.given_up"] = Float64Array.of(+(run.status === "MAX_STEPS"));
    }
    return this.arrived(run) ? run : null;
  }

  /* The motion for values of the keys with its errors, or the reason why there is none: {refused, reason}. */
  run(values) {
    try {
      return this.made(values);
    } catch (error) {
      if (error instanceof Refused) return { refused: error.message, reason: error.reason };
      throw error;
    }
  }

  made(values) {
    const { data } = this;
    this.setNumbers(values);
    const x = this.start(values);
    if (data.outputs.begun) x.set(this.equations("begun", x).z, data.begun); // the first update of a sampled controller
    if (data.outputs.inertia) this.require("definite", this.equations("inertia", x));
    if (data.outputs.jacobian) this.require("slow", this.equations("jacobian", x));
    const locks = data.locks;
    if (locks) this.require("regular.start", this.equations("psi", x));
    const first = this.drive(data.first, x, this.rule(data.first.rule));
    if (!this.arrived(first)) {
      if (locks && first.status === "DONE") this.refuse("no lock");
      const event = data.events[first.met], why = first.status === "EVENT" && event ? event.means : ENDED[first.status] || "it does not come to its end";
      this.refuse("ended", `: ${why}, at t = ${first.time[0].toPrecision(6)} s`);
    }
    return locks ? this.locked(x, first) : this.ended(x, first);
  }

  ended(x, first) {
    const { data } = this, work = Float64Array.of(data.work === null ? 0 : first.end[data.work]);
    const inputs = { start: x, steps: first.steps, time: first.time, "first.out": first.out, "first.end": first.end };
    if (data.outputs.energies) {
      const [start, end] = [x, first.end].map((at) => Object.values(this.equations("energies", at)).flatMap((e) => Array.from(e)));
      this.require("balance", { "energies.start": start, "energies.end": end, steps: first.steps, work });
    }
    const second = this.again(data.second, x, first);
    if (!second) this.refuse("second");
    Object.assign(inputs, { "again.out": second.out, "again.end": second.end, "again.steps": second.steps });
    // a third tells what other roundings do, as those of the command's processor do
    const third = this.again(data.third, x, first);
    const errors = third ? this.rule("errors.third", { ...inputs, "third.out": third.out, "third.end": third.end }) : this.rule("errors.second", inputs);
    return this.result(x, first, second, { columns: this.columns(first), end: errors.end, time: Float64Array.of(0) });
  }

  locked(x, first) {
    const { data } = this, beside = x.slice();
    this.require("regular.lock", this.equations("psi", first.end));
    if (data.rules.beside) {
      const { step } = this.rule("beside", this.equations("psi", x));
      data.q.places.forEach((place, k) => { beside[place] += step[k]; });
    }
    const second = this.again(data.second, beside, first);
    if (!second) this.refuse("second");
    const lock = this.rule("lock", { steps: first.steps, time: first.time, "first.end": first.end, "again.time": second.time, "again.steps": second.steps, "again.end": second.end });
    if (!lock.good[0]) this.refuse("lock");
    const picture = this.drive(data.picture, x, this.rule(data.picture.rule, { time: first.time }));
    return this.result(x, first, second, { columns: this.columns(picture), end: lock.end, time: lock.time_error });
  }

  /* The events that both runs passed in the same order, as far as they agree, with the errors of their times. */
  passedBoth(first, second) {
    const { data } = this, both = [];
    for (const [k, { time, event }] of first.passed.entries()) {
      const other = second.passed[k];
      if (!other || other.event !== event) break;
      const inputs = { steps: first.steps, time: first.time, "again.steps": second.steps, passed: Float64Array.of(time), "again.passed": Float64Array.of(other.time) };
      const { name, kind } = data.events[event];
      both.push({ name, kink: kind === "DISCONTINUITY", time, error: this.rule("passed", inputs).error[0] });
    }
    return both;
  }

  /* Samples of each state, from the start on. */
  columns(run) {
    const count = this.data.size, rows = run.out.length / count, every = this.data.every || 1;
    return Array.from({ length: count }, (_, k) => {
      const column = [];
      for (let n = every - 1; n < run.made; n += every) column.push(run.out[k * rows + n]);
      return column;
    });
  }

  result(x, first, second, parts) {
    const { data } = this, end = first.time[0], count = parts.columns[0].length, step = end / data.shown;
    const times = [0, ...parts.columns[0].map((_, k) => (k + 1 === data.shown ? end : (k + 1) * step))];
    const columns = parts.columns.map((column, k) => [x[k], ...column]);
    if (count < data.shown) {
      times.push(end);
      columns.forEach((column, k) => column.push(first.end[k]));
    }
    const pick = (places, all) => places.map((place) => all[place]);
    return {
      time: end, time_error: parts.time[0], steps: first.steps[0], second_steps: second.steps[0],
      q: pick(data.q.places, first.end), v: pick(data.v.places, first.end),
      q_error: pick(data.q.places, parts.end), v_error: pick(data.v.places, parts.end),
      times, columns, passed: this.passedBoth(first, second),
    };
  }
}

const ENDED = {
  MAX_STEPS: "it takes too many steps", STEP_TOO_SMALL: "the step size became too small", NOT_FINITE: "the state stops being finite",
  NOT_SOLVED: "a step has no solution nearby",
};
/* What is known of a second integration before there is one. */
const NOT_MADE = { "again.steps": Float64Array.of(0), "again.given_up": Float64Array.of(0) };
