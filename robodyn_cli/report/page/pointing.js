/* What the charts of a result share, the time of their cursor and the span that is seen, and the hands and keys that
   change them. */

const NEAR = 7, FAR = 5; // pixels: a press this near to the cursor takes it along; a drag this far chooses a span
const KEYS = "Drag: zoom into a span. Arrow keys: move the cursor. Plus and minus: zoom. Shift and arrow keys: move the span. 0: all of it.";

class Cursor {
  /* player : of the drawing that follows, null where there is none. */
  constructor(player = null) {
    Object.assign(this, { player, time: player ? player.view.time : null, span: null, charts: [] });
    if (player) player.listeners.push((time) => this.show(time));
  }
  show(time) {
    this.time = time;
    for (const chart of this.charts) chart.show(time);
  }
  goTo(time) {
    if (this.player) this.player.goTo(time);
    else this.show(time);
  }
  /* Move the cursor, by a pose at least. */
  step(by) {
    const before = this.time;
    this.goTo(before + by);
    if (this.player && this.time === before) this.player.show(this.player.view.pose + Math.sign(by));
  }
  /* See a span [from, to] in all charts, or all of their times with null. */
  look(span) {
    this.span = span;
    for (const chart of this.charts) chart.changed();
  }
}

/* Hands on a chart: a click moves the cursor, as a drag at it does; other drags choose the span that is seen. */
class Pointing {
  constructor(chart) {
    this.chart = chart;
    const { box } = chart;
    box.addEventListener("pointerdown", (event) => this.down(event));
    box.addEventListener("pointermove", (event) => this.move(event));
    box.addEventListener("pointerup", (event) => this.up(event));
    box.addEventListener("pointercancel", () => this.leave());
    if (!chart.cursor.drags) box.addEventListener("dblclick", () => chart.cursor.look(null));
    box.addEventListener("keydown", (event) => this.key(event));
  }

  /* The panel that an event is in, and its place along it. */
  at(event) {
    const { chart } = this, box = chart.svg.getBoundingClientRect(), ratio = chart.width / box.width;
    const [px, py] = [(event.clientX - box.left) * ratio, (event.clientY - box.top) * ratio];
    const place = chart.panels.findIndex(({ box: b }) => px >= b.left - 20 && px <= b.right + 20 && py >= b.top - 10 && py <= b.bottom + 10);
    return { place, px };
  }
  down(event) {
    if (event.button) return;
    const { chart } = this, { place, px } = this.at(event);
    if (place < 0) return;
    chart.hovered = place;
    this.panel = chart.panels[place];
    this.from = px;
    this.taken = chart.cursor.drags || (chart.time !== null && Math.abs(px - this.panel.x(chart.time)) < NEAR);
    chart.box.setPointerCapture(event.pointerId);
    if (this.taken) chart.cursor.goTo(this.panel.from(px));
  }
  move(event) {
    const { chart } = this, { place, px } = this.at(event);
    if (!this.panel) {
      if (place < 0) return;
      chart.hovered = place;
      if (chart.time !== null) chart.read();
    } else if (this.taken) chart.cursor.goTo(this.panel.from(px));
    else if (this.rect || Math.abs(px - this.from) > FAR) this.choose(px);
  }
  choose(px) {
    const { box } = this.panel, inside = (x) => Math.min(box.right, Math.max(box.left, x));
    this.ends = [this.from, px].map(inside).sort((a, b) => a - b);
    this.rect = this.rect || made("rect", { class: "chosen", y: box.top, height: box.bottom - box.top }, this.chart.over);
    this.rect.setAttribute("x", this.ends[0]);
    this.rect.setAttribute("width", this.ends[1] - this.ends[0]);
  }
  up(event) {
    const { panel, rect, taken, chart } = this;
    if (!panel) return;
    const ends = rect && this.ends.map((px) => panel.from(px));
    this.leave();
    if (ends) this.zoom(...ends);
    else if (!taken) chart.cursor.goTo(panel.from(this.at(event).px));
  }
  leave() {
    this.rect?.remove();
    this.panel = this.rect = this.ends = null;
  }

  /* All times that the chart has. */
  get whole() {
    const ends = this.chart.data.panels.map((panel) => panel.x);
    return [Math.min(...ends.map(([low]) => low)), Math.max(...ends.map(([, high]) => high))];
  }
  zoom(from, to) {
    const [low, high] = this.whole, span = [Math.max(low, from), Math.min(high, to)];
    if (!(span[1] - span[0] > 1e-9 * Math.max(high - low, Math.abs(high)))) return;
    this.chart.cursor.look(from <= low && to >= high ? null : span);
  }
  key(event) {
    const { cursor } = this.chart, [low, high] = overlap(this.whole, cursor.span), length = high - low;
    const middle = cursor.time >= low && cursor.time <= high ? cursor.time : (low + high) / 2;
    const about = (part) => () => this.zoom(middle - part * (middle - low), middle + part * (high - middle));
    const moved = (by) => () => {
      const [first, last] = this.whole, from = Math.min(Math.max(first, low + by * length), last - length);
      if (cursor.span) this.zoom(from, from + length);
    };
    const arrow = (sign) => (event.shiftKey ? moved(0.2 * sign) : () => cursor.step(sign * length / 100));
    const spans = cursor.drags ? {} : { "+": about(0.5), "=": about(0.5), "-": about(2), 0: () => cursor.look(null), Escape: () => cursor.look(null) };
    const keys = { ArrowLeft: arrow(-1), ArrowRight: arrow(1), Home: () => cursor.goTo(low), End: () => cursor.goTo(high), ...spans };
    if (!(event.key in keys) || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    if (cursor.time === null) cursor.goTo(low);
    keys[event.key]();
  }
}
