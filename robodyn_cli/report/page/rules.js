/* Rules that Python has recorded (over/live/rules.py): lists of operations on flat arrays of doubles. */

const BINARY = {
  add: (a, b) => a + b, subtract: (a, b) => a - b, multiply: (a, b) => a * b, divide: (a, b) => a / b,
  power: (a, b) => a ** b, minimum: (a, b) => Math.min(a, b), arctan2: (a, b) => Math.atan2(a, b), maximum: (a, b) => Math.max(a, b),
  less: (a, b) => +(a < b), less_equal: (a, b) => +(a <= b), greater: (a, b) => +(a > b), greater_equal: (a, b) => +(a >= b),
  equal: (a, b) => +(a === b), not_equal: (a, b) => +(a !== b), logical_and: (a, b) => +(a && b ? 1 : 0), logical_or: (a, b) => +(a || b ? 1 : 0),
};
const UNARY = {
  negative: (a) => -a, absolute: Math.abs, sqrt: Math.sqrt, floor: Math.floor, sign: Math.sign, exp: Math.exp, log: Math.log,
  isfinite: (a) => +Number.isFinite(a), isnan: (a) => +Number.isNaN(a), logical_not: (a) => +!a, degrees: (a) => a * 180 / Math.PI,
  // halves to the even number
  rint: (a) => (a % 1 === 0.5 || a % 1 === -0.5 ? 2 * Math.round(a / 2) : Math.round(a)),
};
const REDUCING = {
  max: [-Infinity, Math.max], min: [Infinity, Math.min], sum: [0, (a, b) => a + b],
  all: [1, (a, b) => +(a && b ? 1 : 0)], any: [0, (a, b) => +(a || b ? 1 : 0)],
};

function entrywise(f, args) {
  const [a, b, c] = args, n = a.length, m = b ? b.length : 1, l = c ? c.length : 1, size = Math.max(n, m, l), out = new Float64Array(size);
  const i = n > 1 ? 1 : 0, j = m > 1 ? 1 : 0, k = l > 1 ? 1 : 0;
  if (!b) for (let e = 0; e < size; e++) out[e] = f(a[e]);
  else if (!c) for (let e = 0; e < size; e++) out[e] = f(a[e * i], b[e * j]);
  else for (let e = 0; e < size; e++) out[e] = f(a[e * i], b[e * j], c[e * k]);
  return out;
}

/* Rows of a strided array with strides of 1 or 0 in the last axis, or any other: a loop for each axis. */
function strided(all, { first, shape, strides }) {
  const last = shape.length - 1, size = shape.reduce((a, b) => a * b, 1);
  let step = 1;
  const whole = shape.every((_, k) => strides[last - k] === step && (step *= shape[last - k], true));
  if (whole) return all.subarray(first, first + size); // entries that follow one another: nothing is copied
  const out = new Float64Array(size);
  if (last < 0) out[0] = all[first];
  let at = 0;
  const along = (axis, place) => {
    const count = shape[axis], stride = strides[axis];
    if (axis === last) for (let k = 0, from = place; k < count; k++, from += stride) out[at++] = all[from];
    else for (let k = 0; k < count; k++) along(axis + 1, place + k * stride);
  };
  if (last >= 0) along(0, first);
  return out;
}

function joined(args) {
  const out = new Float64Array(args.reduce((sum, a) => sum + a.length, 0));
  let at = 0;
  for (const a of args) {
    out.set(a, at);
    at += a.length;
  }
  return out;
}

function taken(args, runs) {
  const all = args.length === 1 ? args[0] : joined(args);
  if (runs.strides) return strided(all, runs);
  let size = 0, at = 0;
  for (let k = 1; k < runs.length; k += 2) size += runs[k];
  const out = new Float64Array(size);
  for (let k = 0; k < runs.length; k += 2) {
    if (runs[k + 1] > 1) out.set(all.subarray(runs[k], runs[k] + runs[k + 1]), at); else out[at] = all[runs[k]];
    at += runs[k + 1];
  }
  return out;
}

function reduced([start, f], rows, length, initial) {
  const out = new Float64Array(length ? rows.length / length : 1);
  for (let k = 0; k < out.length; k++) {
    let sum = initial === null ? start : initial;
    for (let n = k * length; n < (k + 1) * length; n++) sum = f(sum, rows[n]);
    out[k] = sum;
  }
  return out;
}

/* What is made most often of long arrays has a loop of its own, several times as fast. */
const LOOPS = {
  add: (a, b, out, i, j) => { for (let n = 0; n < out.length; n++) out[n] = a[n * i] + b[n * j]; },
  subtract: (a, b, out, i, j) => { for (let n = 0; n < out.length; n++) out[n] = a[n * i] - b[n * j]; },
  multiply: (a, b, out, i, j) => { for (let n = 0; n < out.length; n++) out[n] = a[n * i] * b[n * j]; },
  divide: (a, b, out, i, j) => { for (let n = 0; n < out.length; n++) out[n] = a[n * i] / b[n * j]; },
  maximum: (a, b, out, i, j) => { for (let n = 0; n < out.length; n++) out[n] = Math.max(a[n * i], b[n * j]); },
  less: (a, b, out, i, j) => { for (let n = 0; n < out.length; n++) out[n] = a[n * i] < b[n * j] ? 1 : 0; },
  greater_equal: (a, b, out, i, j) => { for (let n = 0; n < out.length; n++) out[n] = a[n * i] >= b[n * j] ? 1 : 0; },
};

function paired(loop, [a, b]) {
  const out = new Float64Array(Math.max(a.length, b.length));
  loop(a, b, out, a.length > 1 ? 1 : 0, b.length > 1 ? 1 : 0);
  return out;
}

function magnitudes(x) {
  const out = new Float64Array(x.length);
  for (let n = 0; n < x.length; n++) out[n] = Math.abs(x[n]);
  return out;
}

/* Differences from row to row. */
function differences(x, row) {
  const out = new Float64Array(x.length - row);
  for (let n = 0; n < out.length; n++) out[n] = x[n + row] - x[n];
  return out;
}

/* The first place of the largest entry of each row. */
function firstOfLargest(rows, length) {
  const out = new Float64Array(rows.length / length);
  for (let k = 0; k < out.length; k++) for (let n = 1; n < length; n++) if (rows[k * length + n] > rows[k * length + out[k]]) out[k] = n;
  return out;
}

const polynomial = (c, x) => c.reduceRight((sum, own) => sum * x + own, 0);

/* The places between a and b, in their order, where a polynomial with coefficients of powers c changes its sign. */
function signChanges(c, a, b) {
  if (c.length < 2) return [];
  const turns = signChanges(c.slice(1).map((own, k) => (k + 1) * own), a, b), ends = [a, ...turns, b], found = [];
  for (let k = 1; k < ends.length; k++) {
    let low = ends[k - 1], high = ends[k];
    const rises = polynomial(c, high) > 0;
    if (rises === polynomial(c, low) > 0) continue;
    for (let round = 0; round < 60; round++) {
      const middle = 0.5 * (low + high);
      if (polynomial(c, middle) > 0 === rises) high = middle; else low = middle;
    }
    found.push(0.5 * (low + high));
  }
  return found;
}

/* Coefficients of powers of x - from of the polynomial through values at 0, 1, ... */
function powers(values, from) {
  const own = Array.from(values), c = [];
  for (let order = 1; order < own.length; order++) for (let k = own.length - 1; k >= order; k--) own[k] = (own[k] - own[k - 1]) / order;
  for (let k = own.length - 1; k >= 0; k--) { // c := c (x - k) + own[k]
    c.unshift(0);
    for (let i = 0; i + 1 < c.length; i++) c[i] += (from - k) * c[i + 1];
    c[0] += own[k];
  }
  return c;
}

/* Integrals of polynomials through samples y (T, n) from place to place, where they are positive (solve/quadrature.py). */
function positiveParts([y, first, last, chosen], samples, most) {
  const n = y.length / samples, out = new Float64Array(chosen.length), points = Math.min(most, samples);
  const ofColumns = first.length * n > chosen.length; // else of rows, for all columns
  chosen.forEach((is, at) => {
    if (!is) return;
    const row = ofColumns ? at : Math.floor(at / n), begin = Math.min(Math.max(Math.floor(first[row]) - Math.floor(points / 2) + 1, 0), samples - points);
    const near = Array.from({ length: points }, (_, k) => y[(begin + k) * n + (at % n)]), c = powers(near, first[row] - begin);
    const end = last[last.length > 1 ? row : 0] - first[row], primitive = [0, ...c.map((own, k) => own / (k + 1))], cuts = [0, ...signChanges(c, 0, end), end];
    for (let k = 1; k < cuts.length; k++) {
      if (polynomial(c, 0.5 * (cuts[k - 1] + cuts[k])) > 0) out[at] += polynomial(primitive, cuts[k]) - polynomial(primitive, cuts[k - 1]);
    }
  });
  return out;
}

/* Apply a function of one matrix to each of those that follow one another. */
function ofEach(x, size, f) {
  if (x.length === size) return Float64Array.from(f(x.slice(), 0));
  const parts = [];
  for (let first = 0; first < x.length; first += size) parts.push(...f(x.slice(first, first + size), first / size));
  return Float64Array.from(parts);
}

function product(a, b, m, k, n) {
  return ofEach(a, m * k, (one, which) => {
    const two = b.subarray(which * k * n, (which + 1) * k * n), out = new Float64Array(m * n);
    for (let i = 0; i < m; i++) for (let l = 0; l < k; l++) for (let j = 0; j < n; j++) out[i * n + j] += one[i * k + l] * two[l * n + j];
    return out;
  });
}

/* Gauss's elimination with rows exchanged: the determinant, and in b the solution. */
function eliminate(A, b, n, columns) {
  let determinant = 1;
  for (let k = 0; k < n; k++) {
    let p = k;
    for (let i = k + 1; i < n; i++) if (Math.abs(A[i * n + k]) > Math.abs(A[p * n + k])) p = i;
    for (let j = 0; j < n && p !== k; j++) [A[k * n + j], A[p * n + j]] = [A[p * n + j], A[k * n + j]];
    for (let j = 0; j < columns && p !== k; j++) [b[k * columns + j], b[p * columns + j]] = [b[p * columns + j], b[k * columns + j]];
    determinant *= (p === k ? 1 : -1) * A[k * n + k];
    for (let i = k + 1; i < n; i++) {
      const f = A[i * n + k] / A[k * n + k];
      for (let j = k; j < n; j++) A[i * n + j] -= f * A[k * n + j];
      for (let j = 0; j < columns; j++) b[i * columns + j] -= f * b[k * columns + j];
    }
  }
  for (let i = n - 1; i >= 0; i--) {
    for (let j = 0; j < columns; j++) {
      for (let k = i + 1; k < n; k++) b[i * columns + j] -= A[i * n + k] * b[k * columns + j];
      b[i * columns + j] /= A[i * n + i];
    }
  }
  return determinant;
}

/* Singular values and right singular vectors of A (m, n), largest first: one-sided Jacobi rotations of the columns. */
function singular(A, m, n) {
  const U = Array.from({ length: n }, (_, j) => Float64Array.from({ length: m }, (__, i) => A[i * n + j]));
  const V = Array.from({ length: n }, (_, j) => Float64Array.from({ length: n }, (__, i) => +(i === j)));
  const dot = (a, b) => {
    let total = 0;
    for (let i = 0; i < a.length; i++) total += a[i] * b[i];
    return total;
  };
  const nothing = 1e-33 * dot(A, A);
  for (let round = 0, turned = true; round < 60 && turned; round++) {
    turned = false;
    for (let p = 0; p < n; p++) for (let q = p + 1; q < n; q++) {
      const a = dot(U[p], U[p]), b = dot(U[q], U[q]), c = dot(U[p], U[q]);
      if (!(Math.abs(c) > Math.max(1e-16 * Math.sqrt(a * b), nothing))) continue;
      turned = true;
      const zeta = (b - a) / (2 * c), t = (zeta < 0 ? -1 : 1) / (Math.abs(zeta) + Math.hypot(1, zeta));
      const cosine = 1 / Math.hypot(1, t), sine = cosine * t;
      for (const [x, y] of [[U[p], U[q]], [V[p], V[q]]]) {
        for (let i = 0; i < x.length; i++) [x[i], y[i]] = [cosine * x[i] - sine * y[i], sine * x[i] + cosine * y[i]];
      }
    }
  }
  const sizes = U.map((u) => Math.sqrt(dot(u, u)));
  const order = sizes.map((_, k) => k).sort((i, j) => sizes[j] - sizes[i]).slice(0, Math.min(m, n));
  return { sizes: order.map((k) => sizes[k]), vectors: order.flatMap((k) => Array.from(V[k])) };
}

function pseudoSolved(A, m, n, cut) {
  const { sizes, vectors } = singular(A, m, n), out = new Float64Array(n * m);
  sizes.forEach((size, k) => {
    if (!(size > cut * sizes[0])) return;
    const v = vectors.slice(k * n, (k + 1) * n), u = new Float64Array(m);
    for (let i = 0; i < m; i++) for (let j = 0; j < n; j++) u[i] += A[i * n + j] * v[j] / size;
    for (let j = 0; j < n; j++) for (let i = 0; i < m; i++) out[j * m + i] += v[j] * u[i] / size;
  });
  return out;
}

const OPERATIONS = {
  constant: (args, values) => Float64Array.from(values, Number),
  where: (args) => entrywise((x, a, b) => (x ? a : b), args),
  take: (args, runs) => taken(args, runs),
  matmul: ([a, b], m, k, n) => product(a, b, m, k, n),
  solve: ([A, b], n, columns) => ofEach(A, n * n, (own, k) => {
    const right = b.slice(k * n * columns, (k + 1) * n * columns);
    eliminate(own, right, n, columns);
    return right;
  }),
  det: ([A], n) => ofEach(A, n * n, (own) => [eliminate(own, new Float64Array(0), n, 0)]),
  sigma: ([A], m, n) => ofEach(A, m * n, (own) => singular(own, m, n).sizes),
  right_vectors: ([A], m, n) => ofEach(A, m * n, (own) => singular(own, m, n).vectors),
  pinv: ([A], m, n, cut) => ofEach(A, m * n, (own) => pseudoSolved(own, m, n, cut)),
  diff: ([x], row) => differences(x, row),
  argmax: ([rows], length) => firstOfLargest(rows, length),
  gather: ([x, places]) => places.map((k) => x[k]),
  scatter: ([x, places], value) => {
    const out = x.slice();
    for (const k of places) out[k] = Number(value);
    return out;
  },
  positive: (args, samples, most) => positiveParts(args, samples, most),
  sort: ([x], n) => ofEach(x, n, (own) => own.sort()),
  row: ([x, places], count, length) => ofEach(x, count * length, (own, k) => {
    const place = places[Math.floor(k * places.length * count * length / x.length)];
    const first = (place < 0 ? place + count : place) * length;
    return own.slice(first, first + length);
  }),
};
for (const [name, f] of Object.entries({ ...UNARY, ...BINARY })) OPERATIONS[name] = (args) => entrywise(f, args);
for (const [name, loop] of Object.entries(LOOPS)) OPERATIONS[name] = (args) => paired(loop, args);
OPERATIONS.absolute = ([x]) => magnitudes(x);
for (const [name, pair] of Object.entries(REDUCING)) OPERATIONS[name] = ([rows], length, initial) => reduced(pair, rows, length, initial);

/* The outputs of a rule, by name, for inputs by name. */
function judged(rule, inputs) {
  const values = [];
  // numbers that are always the same are made once
  rule.constants ||= rule.code.map(([op, , ...data]) => (op === "constant" ? OPERATIONS.constant([], ...data) : null));
  for (const [k, [op, args, ...data]] of rule.code.entries()) {
    if (op === "input") values.push(inputs[data[0]].subarray ? inputs[data[0]] : Float64Array.from(inputs[data[0]]));
    else values.push(rule.constants[k] || OPERATIONS[op](args.map((place) => values[place]), ...data));
  }
  return Object.fromEntries(Object.entries(rule.outputs).map(([name, k]) => [name, values[k]]));
}
