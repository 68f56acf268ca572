/* Rules that Python has recorded (over/live/rules.py): lists of operations on flat arrays of doubles. */

const BINARY = {
  add: (a, b) => a + b, subtract: (a, b) => a - b, multiply: (a, b) => a * b, divide: (a, b) => a / b,
  power: (a, b) => a ** b, minimum: (a, b) => Math.min(a, b), maximum: (a, b) => Math.max(a, b),
  less: (a, b) => +(a < b), less_equal: (a, b) => +(a <= b), greater: (a, b) => +(a > b), greater_equal: (a, b) => +(a >= b),
  equal: (a, b) => +(a === b), not_equal: (a, b) => +(a !== b), logical_and: (a, b) => +(a && b ? 1 : 0), logical_or: (a, b) => +(a || b ? 1 : 0),
};
const UNARY = {
  negative: (a) => -a, absolute: Math.abs, sqrt: Math.sqrt, sign: Math.sign, exp: Math.exp, log: Math.log,
  isfinite: (a) => +Number.isFinite(a), isnan: (a) => +Number.isNaN(a), logical_not: (a) => +!a,
  // halves to the even number
  rint: (a) => (a % 1 === 0.5 || a % 1 === -0.5 ? 2 * Math.round(a / 2) : Math.round(a)),
};
const REDUCING = {
  max: [-Infinity, Math.max], min: [Infinity, Math.min], sum: [0, (a, b) => a + b],
  all: [1, (a, b) => +(a && b ? 1 : 0)], any: [0, (a, b) => +(a || b ? 1 : 0)],
};

function entrywise(f, args) {
  const size = Math.max(...args.map((a) => a.length)), [a, b, c] = args, out = new Float64Array(size);
  const i = a.length > 1 ? 1 : 0, j = b && b.length > 1 ? 1 : 0, k = c && c.length > 1 ? 1 : 0;
  for (let n = 0; n < size; n++) out[n] = f(a[n * i], b && b[n * j], c && c[n * k]);
  return out;
}

/* Entries of a strided array: a loop for each axis. */
function strided(all, { first, shape, strides }) {
  const out = new Float64Array(shape.reduce((a, b) => a * b, 1));
  let at = 0;
  const along = (axis, place) => {
    if (axis === shape.length) out[at++] = all[place];
    else for (let k = 0; k < shape[axis]; k++) along(axis + 1, place + k * strides[axis]);
  };
  along(0, first);
  return out;
}

function taken(args, runs) {
  const all = args.length === 1 ? args[0] : Float64Array.from(args.flatMap((a) => Array.from(a)));
  if (runs.strides) return strided(all, runs);
  let size = 0, at = 0;
  for (let k = 1; k < runs.length; k += 2) size += runs[k];
  const out = new Float64Array(size);
  for (let k = 0; k < runs.length; k += 2) for (let n = 0; n < runs[k + 1]; n++) out[at++] = all[runs[k] + n];
  return out;
}

function reduced([start, f], rows, length, initial) {
  const first = initial === null ? start : initial, out = new Float64Array(rows.length / length).fill(first);
  for (let n = 0; n < rows.length; n++) out[Math.floor(n / length)] = f(out[Math.floor(n / length)], rows[n]);
  return out;
}

/* Apply a function of one matrix to each of those that follow one another. */
function ofEach(x, size, f) {
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
  const dot = (a, b) => a.reduce((total, x, i) => total + x * b[i], 0), nothing = 1e-33 * dot(A, A);
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
  sort: ([x], n) => ofEach(x, n, (own) => own.sort()),
  row: ([x, places], count, length) => ofEach(x, count * length, (own, k) => {
    const place = places[Math.floor(k * places.length * count * length / x.length)];
    const first = (place < 0 ? place + count : place) * length;
    return own.slice(first, first + length);
  }),
};
for (const [name, f] of Object.entries({ ...UNARY, ...BINARY })) OPERATIONS[name] = (args) => entrywise(f, args);
for (const [name, pair] of Object.entries(REDUCING)) OPERATIONS[name] = ([rows], length, initial) => reduced(pair, rows, length, initial);

/* The outputs of a rule, by name, for inputs by name. */
function judged(rule, inputs) {
  const values = [];
  for (const [op, args, ...data] of rule.code) {
    if (op === "input") values.push(inputs[data[0]]);
    else values.push(OPERATIONS[op](args.map((k) => values[k]), ...data));
  }
  return Object.fromEntries(Object.entries(rule.outputs).map(([name, k]) => [name, values[k]]));
}
