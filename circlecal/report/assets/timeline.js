"use strict";
// The timelines: every moment opens its frame; a drag shows the frames between two moments; arrows and Enter do it too.
circlecalPage.timelines = (tell, open, select) => {
  const { make } = circlecalPage;
  const DRAG = 5;  // a movement of fewer pixels of the screen is a click

  const begin = (part) => {
    const first = Number(part.dataset.first), last = Number(part.dataset.last), total = last - first + 1;
    const strips = [...part.querySelectorAll(".strip")], lead = strips[0], said = part.querySelector(".moment");
    const marks = strips.map((strip) => strip.appendChild(make("i", { className: "here", hidden: true })));
    let at = first, drag = null;

    const show = (k, end = k) => {
      at = k;
      for (const mark of marks) {
        mark.hidden = false;
        mark.style.left = `${(100 * (Math.min(k, end) - first)) / total}%`;
        mark.style.width = `${(100 * (Math.abs(end - k) + 1)) / total}%`;
      }
      said.textContent = end === k ? tell(k) : `${tell(Math.min(k, end))} to ${tell(Math.max(k, end))}`;
      lead.setAttribute("aria-valuenow", String(k - first + 1));
      lead.setAttribute("aria-valuetext", tell(k));
    };
    const frame = (event) => {
      const box = lead.getBoundingClientRect();
      return first + Math.min(Math.max(Math.floor(((event.clientX - box.left) / box.width) * total), 0), total - 1);
    };
    for (const strip of strips) {
      strip.addEventListener("pointerdown", (event) => { if (event.button === 0) { drag = { from: frame(event), x: event.clientX, far: false }; strip.setPointerCapture(event.pointerId); } });
      strip.addEventListener("pointermove", (event) => {
        if (drag) drag.far ||= Math.abs(event.clientX - drag.x) > DRAG;
        if (drag?.far) show(drag.from, frame(event)); else show(frame(event));
      });
      strip.addEventListener("pointerup", (event) => {
        const from = drag?.from, far = drag?.far, to = frame(event);
        drag = null;
        if (from === undefined) return;
        if (far && from !== to) select(Math.min(from, to), Math.max(from, to)); else open(to);
      });
      strip.addEventListener("pointercancel", () => { drag = null; });
    }
    lead.tabIndex = 0;
    lead.setAttribute("role", "slider");
    lead.setAttribute("aria-label", `Moment of ${part.dataset.name}: arrows move, Enter opens its frame`);
    lead.setAttribute("aria-valuemin", "1");
    lead.setAttribute("aria-valuemax", String(total));
    lead.setAttribute("aria-valuenow", "1");
    lead.addEventListener("keydown", (event) => {
      const far = Math.max(1, Math.round(total / 20));
      const step = { ArrowRight: 1, ArrowUp: 1, ArrowLeft: -1, ArrowDown: -1, PageUp: far, PageDown: -far, Home: -total, End: total }[event.key];
      if (step) show(Math.min(Math.max(at + step, first), last));
      else if (event.key === "Enter") open(at);
      else return;
      event.preventDefault();
      event.stopPropagation();
    });
    return (k) => { if (k >= first && k <= last) show(k); else for (const mark of marks) mark.hidden = true; };
  };
  const parts = [...document.querySelectorAll(".match")].map(begin);
  return (k) => parts.forEach((mark) => mark(k));
};
