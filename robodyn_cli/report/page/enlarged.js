/* Pictures: a part of one, chosen by a drag or by keys, is seen enlarged; lines keep their width. */

const DEEPEST = 200; // times the whole
const HOW = "Drag: enlarge a part. Plus and minus: zoom. Arrow keys: move. 0: all of it.";

class Enlarged {
  /* box : the element of the page around a picture. figure : its own, whose row of tools gets the way back. */
  constructor(figure, box) {
    const svg = box.querySelector("svg.picture"), back = toolOf("all of it", "See all of the picture", () => this.look(this.whole));
    Object.assign(this, { svg, back, whole: svg.getAttribute("viewBox").split(" ").map(Number) });
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
