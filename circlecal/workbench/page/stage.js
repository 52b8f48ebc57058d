// The picture with its layers: moving, zooming, what lies under the pointer, drawing.
const NS = "http://www.w3.org/2000/svg";
const NEAR = 9;  // how near to a marking a click chooses it, pixels of the screen
const DRAG = 5;  // a movement of fewer pixels of the screen is a click
const MAGNIFIED = 9;  // pixels of the magnifier, which narrow windows show at two thirds

export const shape = (tag, attributes, ...inside) => {
  const node = document.createElementNS(NS, tag);
  for (const [name, value] of Object.entries(attributes)) if (value !== null && value !== undefined) node.setAttribute(name, value);
  node.append(...inside);
  return node;
};
export const path = (runs) => runs.map((run) => "M" + run.map(([x, y]) => `${x + 0.5} ${y + 0.5}`).join("L")).join("");

const toSegment = (px, py, [ax, ay], [bx, by]) => {
  const dx = bx - ax, dy = by - ay, length = dx * dx + dy * dy;
  const share = length ? Math.min(1, Math.max(0, ((px - ax) * dx + (py - ay) * dy) / length)) : 0;
  return Math.hypot(px - ax - share * dx, py - ay - share * dy);
};
// Pieces of a marking's points between gaps, so that what is hidden is not drawn over.
export const pieces = (marking) => {
  const points = marking.points_px;
  if (marking.kind === "point" || points.length < 3) return [points];
  const steps = points.slice(1).map(([x, y], k) => Math.hypot(x - points[k][0], y - points[k][1]));
  const usual = [...steps].sort((a, b) => a - b)[Math.floor(steps.length / 2)];
  const found = [[points[0]]];
  steps.forEach((step, k) => { if (marking.source === "measured" && step > 12 * usual + 4) found.push([]); found.at(-1).push(points[k + 1]); });
  return found;
};

export class Stage {
  constructor(element, hooks) {
    this.element = element;
    this.hooks = hooks;
    this.scene = element.querySelector("#scene");
    this.picture = element.querySelector("img");
    this.layers = element.querySelector("svg");
    this.heat = element.querySelector("#heat");
    this.magnifier = element.querySelector("#magnifier");
    this.size = [16, 9];
    this.zoom = this.whole = 1; this.left = 0; this.top = 0;  // whole: zoom at which all of the picture is seen
    this.cross = null;
    this.template = {};
    this.pointers = new Map();
    this.withSpace = false;
    this.magnify = true;
    this._listen();
    new ResizeObserver(() => { if (this.fitted) this.fit(); }).observe(element);
  }

  _listen() {
    const on = (name, act, options) => this.element.addEventListener(name, act, options);
    on("wheel", (event) => { event.preventDefault(); this.zoomAt(Math.exp(-event.deltaY * 0.0016), event.clientX, event.clientY); }, { passive: false });
    on("pointerdown", (event) => this._down(event));
    on("pointermove", (event) => this._move(event));
    on("pointerup", (event) => this._up(event));
    on("pointercancel", (event) => { this.pointers.delete(event.pointerId); this.drag = null; });
    on("pointerleave", () => { this.magnifier.hidden = true; this.hooks.hover(null); });
    on("contextmenu", (event) => event.preventDefault());
  }

  load(address, width, height) {
    this.size = [width, height];
    this.picture.width = width; this.picture.height = height;
    this.scene.style.width = `${width}px`; this.scene.style.height = `${height}px`;
    this.layers.setAttribute("viewBox", `0 0 ${width} ${height}`);
    this.picture.src = address;
    this.cross = null;
    this.fit();
  }

  clear() {
    this.picture.removeAttribute("src");
    this.picture.alt = "";
    this.layers.replaceChildren();
    this.heat.hidden = this.magnifier.hidden = true;
    this.cross = null;
  }

  place() {
    this.scene.style.transform = `translate(${this.left}px, ${this.top}px) scale(${this.zoom})`;
    this.scene.style.setProperty("--unit", 1 / this.zoom);
    this.hooks.zoomed?.();
  }
  fit() {
    const { clientWidth: w, clientHeight: h } = this.element;
    this.zoom = this.whole = Math.min(w / this.size[0], h / this.size[1]) || 1;
    this.left = (w - this.zoom * this.size[0]) / 2; this.top = (h - this.zoom * this.size[1]) / 2;
    this.fitted = true;
    this.place();
  }
  zoomAt(factor, clientX, clientY) {
    const box = this.element.getBoundingClientRect();
    const x = (clientX ?? box.left + box.width / 2) - box.left, y = (clientY ?? box.top + box.height / 2) - box.top;
    const zoom = Math.min(Math.max(this.zoom * factor, Math.min(this.whole, 0.1)), 60), change = zoom / this.zoom;
    this.left = x - change * (x - this.left); this.top = y - change * (y - this.top);
    this.zoom = zoom; this.fitted = false;
    this.place();
  }
  toPicture(clientX, clientY) {
    const box = this.element.getBoundingClientRect();
    return [(clientX - box.left - this.left) / this.zoom - 0.5, (clientY - box.top - this.top) / this.zoom - 0.5];
  }
  inside([x, y]) { return x >= 0 && y >= 0 && x <= this.size[0] - 1 && y <= this.size[1] - 1; }

  _down(event) {
    this.element.focus({ preventScroll: true });
    this.element.setPointerCapture(event.pointerId);
    this.pointers.set(event.pointerId, [event.clientX, event.clientY]);
    if (this.pointers.size === 2) { this.drag = { pinch: this._spread() }; return; }
    const moves = this.withSpace || event.button === 1 || event.button === 2 || !this.hooks.marks();
    this.drag = { moves, start: [event.clientX, event.clientY], last: [event.clientX, event.clientY], path: [this.toPicture(event.clientX, event.clientY)], far: false, button: event.button };
  }
  _spread() { const [a, b] = [...this.pointers.values()]; return { size: Math.hypot(a[0] - b[0], a[1] - b[1]), at: [(a[0] + b[0]) / 2, (a[1] + b[1]) / 2] }; }
  _move(event) {
    const at = this.toPicture(event.clientX, event.clientY);
    this.hooks.hover(this.inside(at) ? at : null);
    this._magnify(event, at);
    if (!this.drag || !this.pointers.has(event.pointerId)) return;
    this.pointers.set(event.pointerId, [event.clientX, event.clientY]);
    if (this.drag.pinch) {
      const now = this._spread(), before = this.drag.pinch;
      this.left += now.at[0] - before.at[0]; this.top += now.at[1] - before.at[1];
      this.zoomAt(now.size / Math.max(before.size, 1), ...now.at);
      this.drag.pinch = now;
      return;
    }
    this.drag.far ||= Math.hypot(event.clientX - this.drag.start[0], event.clientY - this.drag.start[1]) > DRAG;
    if (!this.drag.far) return;
    if (this.drag.moves) {
      this.element.classList.add("moving");
      this.left += event.clientX - this.drag.last[0]; this.top += event.clientY - this.drag.last[1];
      this.fitted = false;
      this.place();
    } else if (this.inside(at)) {
      this.drag.path.push(at);
      this._trace();
    }
    this.drag.last = [event.clientX, event.clientY];
  }
  _trace() {
    this.trace ||= this.layers.appendChild(shape("path", { class: "preview" }));
    if (!this.trace.isConnected) this.layers.append(this.trace);
    this.trace.setAttribute("d", path([this.drag.path]));
  }
  _up(event) {
    this.pointers.delete(event.pointerId);
    this.element.classList.remove("moving");
    const drag = this.drag;
    this.drag = null;
    this.trace?.remove();
    if (!drag || drag.pinch || drag.button > 0) return;
    if (drag.far && !drag.moves) this.hooks.follow(drag.path);
    else if (!drag.far && !this.withSpace) this.hooks.click(drag.path[0], { exact: event.altKey });
  }
  _magnify(event, at) {
    const lens = this.magnifier;
    lens.hidden = !this.magnify || event.pointerType === "touch" || !this.inside(at) || !this.picture.complete;
    if (lens.hidden) return;
    const box = this.element.getBoundingClientRect();
    lens.classList.toggle("left", event.clientX > box.right - lens.clientWidth - 40 && event.clientY < box.top + lens.clientHeight + 40);
    const draw = lens.getContext("2d"), half = lens.width / MAGNIFIED / 2;
    draw.imageSmoothingEnabled = false;
    draw.clearRect(0, 0, lens.width, lens.height);
    draw.drawImage(this.picture, at[0] + 0.5 - half, at[1] + 0.5 - half, 2 * half, 2 * half, 0, 0, lens.width, lens.height);
    this._drawTemplate(draw, at, half);
    draw.strokeStyle = "#ff5ad0";
    draw.lineWidth = 1;
    draw.beginPath();
    const middle = lens.width / 2;
    for (const [a, b] of [[-26, -5], [5, 26]]) { draw.moveTo(middle + a, middle); draw.lineTo(middle + b, middle); draw.moveTo(middle, middle + a); draw.lineTo(middle, middle + b); }
    draw.stroke();
  }

  // Where the template lies in the magnifier, thin enough to see the paint below it.
  _drawTemplate(draw, [x, y], half) {
    const near = ([a, b]) => Math.abs(a - x) < 4 * half && Math.abs(b - y) < 4 * half;
    draw.beginPath();
    for (const run of Object.values(this.template).flat()) {
      run.forEach((point, k) => {
        if (!k || !(near(point) || near(run[k - 1]) || toSegment(x, y, run[k - 1], point) < 2 * half)) return;
        for (const [act, [a, b]] of [["moveTo", run[k - 1]], ["lineTo", point]]) draw[act](MAGNIFIED * (a - x + half), MAGNIFIED * (b - y + half));
      });
    }
    draw.lineWidth = 3; draw.strokeStyle = "rgb(0 0 0 / .55)"; draw.stroke();
    draw.lineWidth = 1.2; draw.strokeStyle = "#5ad1ff"; draw.stroke();
  }

  // Number of the marking under a place of the picture; -1 where there is none.
  markingAt([x, y], markings) {
    let best = -1, least = NEAR / this.zoom;
    markings.forEach((marking, number) => {
      for (const piece of pieces(marking)) {
        for (let k = 0; k < piece.length; k++) {
          const away = toSegment(x, y, piece[Math.max(k - 1, 0)], piece[k]);
          // small things win over what they lie on
          const counted = marking.kind === "point" ? away - 2 / this.zoom : marking.source === "clicked" ? away - 1 / this.zoom : away;
          if (counted < least) { least = counted; best = number; }
        }
      }
    });
    return best;
  }

  moveCross(dx, dy) {
    const [x, y] = this.cross || [this.size[0] / 2, this.size[1] / 2];
    this.cross = [Math.min(Math.max(x + dx, 0), this.size[0] - 1), Math.min(Math.max(y + dy, 0), this.size[1] - 1)];
  }

  draw(view) {
    const { annotation, answer, chosen, showTemplate, showMarkings, preview } = view;
    this.template = showTemplate ? answer.template : {};
    const nodes = [], accepted = answer.status === "calibrated", unit = 1 / this.zoom;
    if (showTemplate) {
      for (const [name, runs] of Object.entries(answer.template)) {
        const line = path(runs);
        if (accepted) nodes.push(shape("path", { class: "halo", d: line }));
        nodes.push(shape("path", { class: `drawn${accepted ? (name === view.circle ? " circle" : "") : " refused"}`, d: line }));
      }
    }
    annotation.markings.forEach((marking, number) => {
      if (!showMarkings && number !== chosen) return;
      const told = answer.markings[number] || {};
      const kind = [told.contradicts && "wrong", !marking.used && "offered", marking.name && marking.used && "named", told.recognised && "recognised", number === chosen && "chosen"].filter(Boolean).join(" ");
      const lines = marking.kind !== "point" && (marking.source !== "clicked" || marking.kind === "line");
      if (lines) {
        const line = path(pieces(marking));
        nodes.push(shape("path", { class: "under", d: line }), shape("path", { class: `traced ${kind}`, d: line }));
      }
      if (marking.kind === "point" || marking.source !== "measured") {
        const few = marking.points_px.length <= 40;
        marking.points_px.forEach(([x, y], k) => {
          if (few || k % 6 === 0) nodes.push(shape("circle", { class: `dot ${kind} ${marking.name ? "" : "loose"}`, cx: x + 0.5, cy: y + 0.5, r: (marking.kind === "point" || few ? 4.5 : 2.5) * unit }));
          const off = told.points_px?.[k];
          if (marking.source === "clicked" && few && off !== null && off !== undefined && marking.points_px.length <= 12) nodes.push(shape("text", { class: "told", x: x + 8 * unit, y: y - 7 * unit, "font-size": 12 * unit }, `${off.toFixed(1)}`));
        });
      }
    });
    if (preview) nodes.push(shape("path", { class: "preview", d: path(preview) }));
    if (this.cross) {
      const [x, y] = this.cross.map((v) => v + 0.5), arm = 12 * unit;
      nodes.push(shape("path", { class: "cross", d: `M${x - arm} ${y}H${x + arm}M${x} ${y - arm}V${y + arm}` }));
    }
    this.layers.replaceChildren(...nodes);
  }

  drawHeat(grid, scale) {
    this.heat.hidden = !grid;
    if (!grid) return;
    this.heat.width = grid.columns; this.heat.height = grid.rows;
    const draw = this.heat.getContext("2d"), image = draw.createImageData(grid.columns, grid.rows);
    grid.px.forEach((sigma, k) => image.data.set(circlecalCamera.heat(sigma === null ? null : sigma * scale), 4 * k));
    draw.putImageData(image, 0, 0);
  }
}
