/* Elements with words, and numbers with their errors. */

/* A number with the digits that its error leaves, and the error; large and small ones with a power of ten. */
function stated(x, error, unit) {
  if (!(error > 0)) return `${text(x, 10)} ${unit}`;
  const place = (y) => Math.floor(Math.log10(y)), size = Math.max(Math.abs(x), error), power = size < 1e-3 || size >= 1e6 ? place(size) : 0;
  const digits = Math.min(15, Math.max(0, 1 - place(error) + power)), number = (x / 10 ** power).toFixed(digits).replace(/^-(0(\.0*)?)$/, "$1").replace("-", "−");
  const both = `${number} ± ${text(error / 10 ** power, 2)}`;
  return power ? `(${both})·${text(10 ** power, 2).replace("1·", "")} ${unit}` : `${both} ${unit}`;
}

const named = (tag, words, attributes = {}) => {
  const item = Object.assign(document.createElement(tag), attributes);
  item.textContent = words;
  return item;
};
