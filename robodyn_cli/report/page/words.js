/* Elements with words, and numbers with their errors. */

const DOUBLE = 15; // digits of a number behind its first
const raised = (power) => String(power).replace(/[-\d]/g, (sign) => "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"["-0123456789".indexOf(sign)]);
/* A number for people: short, with a true minus and a power of ten where it helps. */
function text(x, digits = 4) {
  if (!Number.isFinite(x)) return "–";
  const size = Math.abs(x);
  if (x === 0 || (size >= 1e-3 && size < 1e6)) return String(Number(x.toPrecision(digits))).replace("-", "−");
  const [mantissa, power] = x.toExponential(digits - 1).split("e");
  return `${Number(mantissa)}·10${raised(Number(power))}`.replace("-", "−");
}
/* The power of ten of the first digit of a number. */
const placeOf = (x) => (x ? Number(x.toExponential().split("e")[1]) : -400);

/* An error as it is printed with some digits, away from zero: the rule of rounded_up in summaries/facts.py. */
function roundedUp(error, digits) {
  if (!(error > 0 && error < Infinity)) return error;
  const [mantissa, power] = error.toExponential(6).split("e");
  return Number(`${Math.ceil(Number(`${mantissa}e${digits - 1}`))}e${Number(power) - digits + 1}`);
}
/* A number rounded to the digit of ten to the power `last`. */
function cut(x, last) {
  const digits = placeOf(x) - last;
  if (digits >= 0) return Number(x.toExponential(digits)); // halves away from zero
  return Math.abs(x) >= Number(`5e${last - 1}`) ? Math.sign(x) * Number(`1e${last}`) : 0;
}
/* A number whose last digit is that of ten to the power `last`. */
function withPlace(x, last) {
  if (x === 0) return "0";
  const first = placeOf(x);
  if ((first >= -4 || last >= -4) && last < 4 && first < DOUBLE) return x.toFixed(Math.max(0, -last)).replace("-", "−");
  const [mantissa, power] = x.toExponential(Math.max(0, first - last)).split("e");
  return mantissa.replace("-", "−") + (Number(power) ? `·10${raised(Number(power))}` : "");
}
/* A number with the digits that its error leaves, and the error in one digit, which covers what rounding takes away: the
   rule of summaries/rounding.py. One without an error has six digits. */
function stated(x, error, unit) {
  const after = unit ? ` ${unit}` : "";
  if (!(error > 0 && error < Infinity)) return `${text(x, 6)}${after}`;
  const last = Math.max(placeOf(error), placeOf(x) - DOUBLE), kept = cut(x, last), off = roundedUp(error + Math.abs(x - kept), 1);
  return `${withPlace(kept, last)} ± ${withPlace(off, placeOf(off))}${after}`;
}

const named = (tag, words, attributes = {}) => {
  const item = Object.assign(document.createElement(tag), attributes);
  item.textContent = words;
  return item;
};
