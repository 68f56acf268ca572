/* Axes of plots: round numbers, prefixes of units, and the part of the values that is seen. */

/* Round numbers between two ends, or powers of ten on a logarithmic axis. */
function ticks(low, high, log, most) {
  if (log) {
    const first = Math.ceil(Math.log10(low) - 1e-9), last = Math.floor(Math.log10(high) + 1e-9);
    const step = Math.max(1, Math.ceil((last - first + 1) / most));
    const powers = [];
    for (let k = first; k <= last; k += step) powers.push(10 ** k);
    return powers.length > 1 ? powers : [low, Math.sqrt(low * high), high].map((x) => Number(x.toPrecision(2)));
  }
  const raw = (high - low) / most, power = 10 ** Math.floor(Math.log10(raw));
  const step = power * [1, 2, 5, 10].find((s) => s * power >= raw * (1 - 1e-9));
  return marks(low - 1e-9 * step, high + 1e-9 * step, step).map((x) => Number(x.toPrecision(12)));
}

/* Ticks with their numbers, of as many digits as tell them apart. */
function numbered(low, high, log, most) {
  const values = ticks(low, high, log, most), place = (x) => Math.floor(Math.log10(Math.abs(x)) + 1e-9);
  const digits = log || values.length < 2 ? 4 : 1 + place(Math.max(...values.map(Math.abs))) - place(values[1] - values[0]);
  return values.map((value) => [value, text(value, Math.min(12, Math.max(4, digits))).replace(/^1·/, "")]);
}

const PREFIXES = { "-12": "p", "-9": "n", "-6": "µ", "-3": "m", 3: "k", 6: "M", 9: "G" };
/* Units that take a prefix: a name that stands alone or before others, without a power. */
const PREFIXED = /^(s|m|N|J|W|V|A|Hz|Pa|rad)(?![\w²³])(?!.* )/;
const SMALL_ONLY = ["s", "rad"];

/* The label of an axis with the prefix that its numbers ask for, and the factor that they get; usual sizes keep the
   unit as it is. */
function scaled(label, low, high, log = false) {
  const [, quantity, unit] = /^(.*)\[([^\]]*)\]$/.exec(label) || [], size = Math.max(Math.abs(low), Math.abs(high));
  const symbol = unit && PREFIXED.exec(unit), power = 3 * Math.floor(Math.log10(size) / 3 + 1e-12);
  const usual = log || !symbol || !(size < 1e-2 || size >= 1e5) || (power > 0 && SMALL_ONLY.includes(symbol[1]));
  const prefix = usual ? undefined : PREFIXES[power];
  return prefix ? { label: `${quantity}[${prefix}${unit}]`, factor: 10 ** -power } : { label, factor: 1 };
}
/* Ticks of an axis whose numbers have a factor. */
function ruled(low, high, log, most, factor) {
  return numbered(low * factor, high * factor, log, most).map(([value, word]) => [value / factor, word]);
}

/* The part of a panel's times that is seen: that of a span, or all where they have none in common. */
function overlap([low, high], span) {
  const part = span ? [Math.max(low, span[0]), Math.min(high, span[1])] : [low, high];
  return part[1] > part[0] ? part : [low, high];
}

/* The ends of what lines have between two times, the values at these among them. */
function extent(lines, [from, to]) {
  let low = Infinity, high = -Infinity;
  const take = (v) => { if (v < low) low = v; if (v > high) high = v; };
  for (const line of lines) {
    for (let k = 0; k < line.x.length; k++) if (line.x[k] >= from && line.x[k] <= to) take(line.y[k]);
    for (const time of [from, to]) take(between(line, time));
  }
  return [low, high];
}
/* Value of a line at a time, between its points in proportion; no number where it has none. */
function between(line, time) {
  const k = countUpTo(line.x, time);
  if (k === 0) return NaN;
  if (Number.isNaN(line.y[k - 1]) && line.x[k - 2] === time) return line.y[k - 2]; // at a sample before a gap
  if (k === line.x.length) return time <= line.x[k - 1] * (1 + 1e-9) ? line.y[k - 1] : NaN;
  const part = (time - line.x[k - 1]) / (line.x[k] - line.x[k - 1]);
  return line.y[k - 1] + part * (line.y[k] - line.y[k - 1]);
}

const FINEST = 1e-6; // of the largest value: single precision draws stairs below
/* The upright ends of a panel: its own, or what is seen of the lines where a part is. */
function uprightEnds(panel, lines, span, whole) {
  const curves = lines.filter((line) => !line.spans[0] && !line.spans[1]);
  if (whole || !curves.length) return panel.y;
  const to = panel.log ? (v) => (v > 0 ? Math.log10(v) : NaN) : (v) => v;
  const [least, most] = panel.y.map(to);
  let [low, high] = extent(curves, span).map(to);
  if (panel.log && !Number.isFinite(low)) low = least;
  if (!(high >= low)) return panel.y;
  const single = curves.some((line) => line.y instanceof Float32Array), size = Math.max(Math.abs(low), Math.abs(high));
  const room = Math.max(0.06 * (high - low), single && !panel.log ? FINEST * size : 0) || 0.05 * size || 0.5 * (most - least);
  [low, high] = [Math.max(low - room, least), Math.min(high + room, most)];
  if (!(high > low)) return panel.y;
  return panel.log ? [10 ** low, 10 ** high] : [low, high];
}
