// The field beside the picture: every marking can be chosen with a click, or with its key.
import { shape } from "./stage.js";

const MARGIN = 5;
const flat = (points) => "M" + points.map(([x, y]) => `${x} ${y}`).join("L");

export class FieldMap {
  constructor(svg, field, choose) {
    this.svg = svg;
    this.groups = new Map();
    const half = [field.length / 2 + MARGIN, field.width / 2 + MARGIN];
    svg.setAttribute("viewBox", `${-half[0]} ${-half[1]} ${2 * half[0]} ${2 * half[1]}`);
    this.foot = svg.appendChild(shape("path", { class: "foot" }));
    for (const marking of field.markings) {
      const spoken = marking.key ? `${marking.label}, key ${marking.key}` : marking.label;
      const group = shape("g", { role: "button", tabindex: "0", "aria-label": spoken, "aria-pressed": "false", "data-name": marking.name });
      if (marking.kind === "point") {
        const [x, y] = marking.points[0];
        group.append(shape("circle", { class: "mark", cx: x, cy: y, r: 0.7 }), shape("circle", { class: "hit", cx: x, cy: y, r: 2.2 }));
      } else {
        group.append(shape("path", { class: "mark", d: flat(marking.points), "vector-effect": "non-scaling-stroke" }), shape("path", { class: "hit", d: flat(marking.points) }));
      }
      group.append(shape("title", {}, spoken));
      group.addEventListener("click", () => choose(marking.name));
      group.addEventListener("keydown", (event) => { if (event.key === "Enter" || event.key === " ") { event.preventDefault(); event.stopPropagation(); choose(marking.name); } });
      this.groups.set(marking.name, group);
      svg.append(group);
    }
    for (const marking of field.markings) {
      if (!marking.key) continue;
      const points = marking.points, middle = points[Math.floor(points.length * (marking.kind === "curve" ? 0.62 : 0.3))] || points[0];
      svg.append(shape("text", { x: middle[0], y: middle[1], "aria-hidden": "true" }, marking.key));
    }
    this.here = svg.appendChild(shape("circle", { class: "here", r: 1.3, visibility: "hidden" }));
  }
  draw(used, active, fits, footprint) {
    for (const [name, group] of this.groups) {
      group.setAttribute("class", [used.has(name) && "used", name === active && "active", fits.has(name) && "fits"].filter(Boolean).join(" "));
      group.setAttribute("aria-pressed", String(used.has(name) || name === active));
    }
    this.foot.setAttribute("d", footprint.length ? `${flat(footprint)}Z` : "");
  }
  point(place) {
    this.here.setAttribute("visibility", place ? "visible" : "hidden");
    if (place) { this.here.setAttribute("cx", place[0]); this.here.setAttribute("cy", place[1]); }
  }
}
