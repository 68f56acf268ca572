/* Pictures: a part of one, chosen by a drag or by keys, is seen enlarged; lines keep their width, and the axes that its
   middle is in are numbered at its rim. */

const DEEPEST = 200; // times the whole
const HOW = "Drag: enlarge a part. Plus and minus: zoom. Arrow keys: move. 0: all of it.";

class Enlarged {
  /* box : the element of the page around a picture. figure : its own, whose row of tools gets the way back. */
  constructor(figure, box) {
    const svg = box.querySelector("svg.picture"), back = toolOf("all of it", "See all of the picture", () => this.look(this.whole));
    Object.assign(this, { svg, back, whole: svg.getAttribute("viewBox").split(" ").map(Number), scales: JSON.parse(box.dataset.scales || "[]") });
    this.part = this.whole;
    let row = figure.querySelector(":scope > .tools");
    if (!row) {
      row = named("p", "", { className: "tools" });
      figure.append(row);
    }
    row.prepend(back);
    back.hidden = true;
    box.title = HOW;
    svg.addEventListener("pointerdown", (event) => this.down(event));
    svg.addEventListener("pointermove", (event) => this.move(event));
    svg.addEventListener("pointerup", () => this.up());
    svg.addEventListener("pointercancel", () => this.leave());
    svg.addEventListener("dblclick", () => this.look(this.whole));
    box.addEventListener("keydown", (event) => this.key(event));
  }

  /* See a part [x, y, width, height], no more than the whole and no less than can be told apart. */
  look([x, y, width, height]) {
    const [x0, y0, w0, h0] = this.whole, scale = Math.min(1, Math.max(width / w0, height / h0, 1 / DEEPEST)), [w, h] = [scale * w0, scale * h0];
    const inside = (at, size, own, from, all) => Math.min(Math.max(at + (size - own) / 2, from), from + all - own);
    this.part = [inside(x, width, w, x0, w0), inside(y, height, h, y0, h0), w, h];
    this.svg.setAttribute("viewBox", this.part.map((value) => Number(value.toPrecision(7))).join(" "));
    this.svg.classList.toggle("zoomed", scale < 1);
    this.back.hidden = scale === 1;
    this.marks?.remove();
    if (scale < 1) this.number(scale);
  }
  /* Write the numbers of axes at the rim of what is seen of them; scale : of the part over the whole. */
  number(scale) {
    const [x, y, w, h] = this.part, middle = [x + w / 2, y + h / 2];
    const found = this.scales.find(([[left, top, right, bottom]]) => middle[0] >= left && middle[0] <= right && middle[1] >= top && middle[1] <= bottom);
    this.marks = made("g", { class: "marks", "font-size": 10 * scale, "stroke-width": 3 }, this.svg);
    if (!found) return;
    const [[left, top, right, bottom], across, upright] = found, inset = 4 * scale;
    const seen = { left: Math.max(left, x), right: Math.min(right, x + w), top: Math.max(top, y), bottom: Math.min(bottom, y + h) };
    const write = (word, px, py, anchor) => { made("text", { x: px, y: py, "text-anchor": anchor }, this.marks).textContent = word; };
    const axis = ([label, first, last, log], from, to, low, high, put) => {
      const into = log ? Math.log10 : Number, back = log ? (v) => 10 ** v : Number, [a, b] = [into(first), into(last)];
      const value = (place) => back(a + (place - from) / (to - from) * (b - a)), ends = [value(low), value(high)].sort((one, other) => one - other);
      const own = scaled(label, ...ends, log), plain = ends[1] / ends[0] < 10; // no two powers of ten
      for (const [tick, word] of ruled(...ends, log && !plain, 5, own.factor)) put(word, from + (into(tick) - a) / (b - a) * (to - from));
      return own.label;
    };
    if (across) {
      const label = axis(across, left, right, seen.left, seen.right, (word, px) => write(word, px, seen.bottom - inset, "middle"));
      write(label, seen.right - inset, seen.bottom - 18 * scale, "end");
    }
    if (upright) {
      const label = axis(upright, bottom, top, seen.bottom, seen.top, (word, py) => write(word, seen.left + inset, py + 3 * scale, "start"));
      write(label, seen.left + inset, seen.top + 12 * scale, "start");
    }
  }

  // -- hands ------------------------------------------------------------------------------------------------------
  at(event) {
    return new DOMPoint(event.clientX, event.clientY).matrixTransform(this.svg.getScreenCTM().inverse());
  }
  down(event) {
    if (event.button) return;
    this.from = this.at(event);
    this.pressed = [event.clientX, event.clientY];
    this.svg.setPointerCapture(event.pointerId);
  }
  move(event) {
    if (!this.from) return;
    const [px, py] = this.pressed, to = this.at(event);
    if (!this.rect && Math.hypot(event.clientX - px, event.clientY - py) < FAR) return;
    this.rect ||= made("rect", { class: "chosen" }, this.svg);
    this.chosen = [Math.min(this.from.x, to.x), Math.min(this.from.y, to.y), Math.abs(to.x - this.from.x), Math.abs(to.y - this.from.y)];
    ["x", "y", "width", "height"].forEach((name, k) => this.rect.setAttribute(name, this.chosen[k]));
  }
  up() {
    const { rect, chosen } = this;
    this.leave();
    if (rect) this.look(chosen);
  }
  leave() {
    this.rect?.remove();
    this.from = this.rect = null;
  }
  key(event) {
    const [x, y, w, h] = this.part, about = (scale) => [x + (1 - scale) * w / 2, y + (1 - scale) * h / 2, scale * w, scale * h];
    const parts = { "+": about(0.5), "=": about(0.5), "-": about(2), 0: this.whole, Escape: this.whole,
      ArrowLeft: [x - w / 4, y, w, h], ArrowRight: [x + w / 4, y, w, h], ArrowUp: [x, y - h / 4, w, h], ArrowDown: [x, y + h / 4, w, h] };
    const scrolls = this.back.hidden && event.key.startsWith("Arrow"); // the page
    if (!(event.key in parts) || scrolls || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    this.look(parts[event.key]);
  }
}
