// The list of frames: only the rows in view exist, so ten thousand frames are as quick as ten.
const ROW = 40;
const make = (tag, properties, ...inside) => { const node = Object.assign(document.createElement(tag), properties); node.append(...inside); return node; };
/** Minutes, seconds and, where there are any, hundredths: frames of a clip follow each other by 0.04 s. */
export const clock = (s) => {
  const whole = Math.round(100 * s), rest = whole % 100, seconds = Math.floor(whole / 100);
  return `${Math.floor(seconds / 60)}:${String(seconds % 60).padStart(2, "0")}${rest ? `.${String(rest).padStart(2, "0")}` : ""}`;
};

/** Whether somebody should look at a frame: refused, or doubtful or not calibrated yet and annotated by nobody. */
export const isToDo = ([, state, , , , annotated, flag]) => !flag && (state === "refused" || (state !== "calibrated" && !annotated));

export class FrameList {
  constructor(element, rows, open) {
    this.element = element;
    this.rows = rows;
    this.open = open;
    this.frames = []; this.shown = []; this.current = -1;
    element.addEventListener("scroll", () => this.draw());
    new ResizeObserver(() => this.draw()).observe(element);
    element.addEventListener("keydown", (event) => {
      const step = { ArrowDown: 1, ArrowUp: -1 }[event.key];
      if (step) { event.preventDefault(); event.stopPropagation(); this.step(step); }
    });
  }
  static state(frame) { return frame[1]; }
  keep(kind, text) {
    const wanted = text.trim().toLowerCase();
    const fits = {
      "": () => true, todo: isToDo, refused: (f) => f[1] === "refused", doubtful: (f) => f[1] === "doubtful",
      calibrated: (f) => f[1] === "calibrated" || f[1] === "doubtful", annotated: (f) => f[5], flagged: (f) => f[6],
    }[kind];
    this.shown = this.frames.map((frame, k) => k).filter((k) => fits(this.frames[k]) && (!wanted || `${this.frames[k][0]} ${this.frames[k][2] || ""}`.toLowerCase().includes(wanted)));
    this.rows.style.height = `${ROW * this.shown.length}px`;
    this.draw();
  }
  // a frame that has left the list by what was done to it keeps its place between those before and behind it
  step(by, only = () => true) {
    const ahead = by > 0 ? this.shown.filter((k) => k > this.current) : this.shown.filter((k) => k < this.current).reverse();
    const next = ahead.find((k) => only(this.frames[k]));
    if (next === undefined) return false;
    this.open(next);
    return true;
  }
  select(index) {
    this.current = index;
    const place = this.shown.indexOf(index);
    if (place >= 0) {
      const top = place * ROW, view = this.element;
      if (top < view.scrollTop) view.scrollTop = top;
      else if (top + ROW > view.scrollTop + view.clientHeight) view.scrollTop = top + ROW - view.clientHeight;
    }
    this.draw();
  }
  draw() {
    const first = Math.max(0, Math.floor(this.element.scrollTop / ROW) - 3), count = Math.ceil(this.element.clientHeight / ROW) + 6;
    this.rows.replaceChildren(...this.shown.slice(first, first + count).map((index, k) => {
      const [id, state, code, sigma, time, annotated, flag] = this.frames[index];
      const told = flag ? flag.replace("_", " ") : state === "refused" ? (code || "refused").replaceAll("_", " ") : sigma === null || sigma === undefined ? (state !== "unknown" ? state : annotated ? "annotated" : "not yet looked at") : `${state}, ${sigma.toFixed(1)} px`;
      const row = make("div", { className: `frame ${state}`, role: "option", ariaSelected: String(index === this.current), id: `frame-${index}`, title: id },
        make("i", {}), make("span", {}, make("b", {}, make("bdi", { textContent: id, dir: "ltr" })), make("small", { textContent: time === null ? told : `${clock(time)}  ${told}` })), make("em", { textContent: annotated ? "✓" : "", title: annotated ? "annotated" : "" }));
      row.style.top = `${(first + k) * ROW}px`;
      row.addEventListener("click", () => this.open(index));
      return row;
    }));
    if (this.current >= 0) this.element.setAttribute("aria-activedescendant", `frame-${this.current}`);
  }
}
