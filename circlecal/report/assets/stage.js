"use strict";
// The picture of the large view: its layers, wheel zoom and drag, metres and sigma under the pointer, the sigma map.
circlecalPage.Stage = class {
  static MOST = 40;    // largest zoom
  static NEAR = 3;     // zoom of a click and of the key z
  static DRAG = 5;     // a movement of fewer pixels of the screen is a click

  constructor(box, hooks) {
    this.box = box;
    this.hooks = hooks;      // under(text, place on the field or null), zoomed(whether)
    this.told = null;        // size, view and sigma of the frame
    this.zoom = 1; this.x = 0; this.y = 0;
    this.pointer = [0.5, 0.5];  // share of the box
    this.drag = null;
    this.heat = circlecalPage.make("canvas", { className: "heat", hidden: true });
    const on = (name, act, options) => box.addEventListener(name, act, options);
    on("wheel", (event) => { event.preventDefault(); this.zoomBy(Math.exp(-event.deltaY * 0.0016), this.share(event)); }, { passive: false });
    on("pointerdown", (event) => { if (event.button === 0) { this.drag = { start: this.share(event), x: this.x, y: this.y, far: false }; box.setPointerCapture(event.pointerId); } });
    on("pointermove", (event) => this.move(event));
    on("pointerup", (event) => this.release(event));
    on("pointercancel", () => { this.drag = null; });
    on("pointerleave", () => hooks.under("", null));
    new ResizeObserver(() => this.place()).observe(box);
  }

  share(event) {
    const box = this.box.getBoundingClientRect();
    return [(event.clientX - box.left) / box.width, (event.clientY - box.top) / box.height].map((v) => Math.min(Math.max(v, 0), 1));
  }
  load(layers) {
    this.box.replaceChildren(...layers);
    const first = layers[0];
    const shape = () => this.box.style.setProperty("--shape", String(first.naturalWidth / first.naturalHeight || 16 / 9));
    if (first?.tagName === "IMG") first.addEventListener("load", shape, { once: true });
    if (layers.length) this.box.append(this.heat);
    this.told = null;
    this.heat.hidden = true;
    this.hooks.under("", null);
  }
  tell(told) { this.told = told; }

  place() {
    const least = 1 - this.zoom;
    this.x = Math.min(Math.max(this.x, least), 0); this.y = Math.min(Math.max(this.y, least), 0);
    for (const [name, value] of [["--zoom", this.zoom], ["--x", this.x], ["--y", this.y]]) this.box.style.setProperty(name, String(value));
    this.box.classList.toggle("zoomed", this.zoom > 1);
    this.hooks.zoomed(this.zoom > 1);
  }
  zoomBy(factor, [u, v] = this.pointer) {
    const zoom = Math.min(Math.max(this.zoom * factor, 1), this.constructor.MOST), change = zoom / this.zoom;
    this.x = u - change * (u - this.x); this.y = v - change * (v - this.y);
    this.zoom = zoom;
    this.place();
  }
  toggle(at = this.pointer) { this.zoomBy(this.zoom > 1 ? 1 / this.zoom : this.constructor.NEAR, at); }

  move(event) {
    const at = this.share(event);
    if (event.pointerType === "mouse") this.pointer = at;
    this.tellUnder(at);
    if (!this.drag) return;
    const box = this.box.getBoundingClientRect(), dx = at[0] - this.drag.start[0], dy = at[1] - this.drag.start[1];
    this.drag.far ||= Math.hypot(dx * box.width, dy * box.height) > this.constructor.DRAG;
    if (!this.drag.far) return;
    this.x = this.drag.x + dx; this.y = this.drag.y + dy;
    this.place();
  }
  release(event) {
    const clicked = this.drag && !this.drag.far;
    this.drag = null;
    if (clicked) { this.pointer = this.share(event); this.toggle(); }
  }

  // Pixel of the frame at a share of the box.
  pixel([u, v]) {
    const [width, height] = this.told.size;
    return [((u - this.x) / this.zoom) * width - 0.5, ((v - this.y) / this.zoom) * height - 0.5];
  }
  tellUnder(at) {
    if (!this.told?.size) return;
    const { size: [width, height], view, sigma } = this.told, [x, y] = this.pixel(at);
    const field = view && circlecalCamera.toField(view, x, y);
    const read = (values) => sigma && circlecalCamera.atGrid(sigma, values, width, height, x, y);
    const px = read(sigma?.px), m = read(sigma?.m);
    const where = field ? `: ${circlecalCamera.tell(field)}` : view ? ": above the field" : "";
    const spread = !field || px === null ? "" : `, sigma ${circlecalPage.short(px * 1920 / width)} px at 1920 px width${m === null ? "" : `, ${circlecalPage.short(m)} m`}`;
    this.hooks.under(`${x.toFixed(0)}, ${y.toFixed(0)} px${where}${spread}`, field);
  }
  showHeat(on) {
    const grid = on && this.told?.sigma;
    this.heat.hidden = !grid;
    if (!grid) return;
    this.heat.width = grid.columns; this.heat.height = grid.rows;
    const draw = this.heat.getContext("2d"), image = draw.createImageData(grid.columns, grid.rows), scale = 1920 / this.told.size[0];
    grid.px.forEach((px, k) => image.data.set(circlecalCamera.heat(px === null ? null : px * scale), 4 * k));
    draw.putImageData(image, 0, 0);
  }
};
