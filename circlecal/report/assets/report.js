"use strict";
// The list of frames and the large view. frames.js calls circlecalFrames, details/*.js call circlecalDetails.
(() => {
  const root = document.documentElement;
  root.classList.add("scripted");
  const stored = (() => { try { return localStorage.getItem("circlecal-theme"); } catch { return null; } })();
  const dark = window.matchMedia("(prefers-color-scheme: dark)");
  const setTheme = (name) => {
    root.dataset.theme = name;
    document.getElementById("theme")?.setAttribute("aria-pressed", String(name === "dark"));
  };
  setTheme(stored || (dark.matches ? "dark" : "light"));
  dark.addEventListener("change", (event) => { if (!stored) setTheme(event.matches ? "dark" : "light"); });

  const MEDIA = {
    thumbnails: [1, "jpg"], frames: [2, "jpg"], template: [4, "svg"],
    points: [8, "svg"], radar: [16, "jpg"], plan: [32, "svg"],
  };
  const DRAWN = 64;
  const PER_PAGE = 60;
  const SORTS = { id: "id", verdict: "code", reason: "code", case: "case", sigma: "sigma_px", residual: "rms_px", time: "time_ms" };
  const FIELDS = ["q", "verdict", "reason", "case", "camera", "rig", "from", "to", "sort", "down"];
  const byNumbers = new Intl.Collator("en", { numeric: true });

  let run = null;      // what frames.js holds
  let shown = [];      // positions of the frames that pass the filter, sorted
  let page = 0;
  let range = null;    // first and last position, from the timeline
  let open = -1;       // place in `shown` of the large view
  let cursor = 0;      // place in `shown` of the card that has or had the focus
  const details = new Map();

  const element = (id) => document.getElementById(id);
  const make = (name, properties = {}, ...children) => {
    const made = Object.assign(document.createElement(name), properties);
    made.append(...children);
    return made;
  };
  const cell = (column, k) => run.columns[column][k];
  const refused = (k) => cell("code", k) >= 0;
  const has = (k, kind) => (cell("media", k) & MEDIA[kind][0]) !== 0;
  const file = (k, kind) => {
    const folder = String(Math.floor(k / run.perFolder)).padStart(3, "0");
    return `${kind}/${folder}/${String(k).padStart(6, "0")}.${MEDIA[kind][1]}`;
  };
  const short = (value) => {
    if (value === null) return "-";
    const size = Math.abs(value);
    return String(Number(value.toFixed(size >= 100 ? 0 : size >= 10 ? 1 : size >= 1 ? 2 : 3)));
  };
  const clock = (seconds) => {
    const tenths = Math.round(seconds * 10), whole = Math.floor(tenths / 10);
    const two = (n) => String(n).padStart(2, "0");
    const hours = Math.floor(whole / 3600), minutes = Math.floor(whole / 60) % 60;
    const text = hours ? `${hours}:${two(minutes)}:${two(whole % 60)}` : `${minutes}:${two(whole % 60)}`;
    return tenths % 10 ? `${text}.${tenths % 10}` : text;
  };

  // filter and sort
  const wanted = () => Object.fromEntries(new FormData(element("filter")));
  const select = () => {
    const want = wanted();
    const words = (want.q || "").toLowerCase().split(/\s+/).filter(Boolean);
    const from = want.from === "" ? -Infinity : Number(want.from);
    const to = want.to === "" ? Infinity : Number(want.to);
    const limited = want.from !== "" || want.to !== "";
    const code = run.codes.findIndex(([name]) => name === want.reason);
    const keep = (k) => {
      if (want.verdict && refused(k) !== (want.verdict === "refused")) return false;
      if (want.reason && cell("code", k) !== code) return false;
      if (want.case && String(cell("case", k)) !== want.case) return false;
      if (want.camera && run.cameras[cell("camera", k)] !== want.camera) return false;
      if (want.rig && !cell("gained", k)) return false;
      if (range && (k < range[0] || k > range[1])) return false;
      if (limited) {
        const sigma = cell("sigma_px", k);
        if (sigma === null || sigma < from || sigma > to) return false;
      }
      if (words.length) {
        const text = `${cell("id", k)} ${refused(k) ? `${run.codes[cell("code", k)][0]} ${cell("reason", k)}` : ""}`.toLowerCase();
        if (!words.every((word) => text.includes(word))) return false;
      }
      return true;
    };
    shown = [];
    for (let k = 0; k < run.columns.id.length; k += 1) if (keep(k)) shown.push(k);
    const column = run.columns[SORTS[want.sort]];
    if (column) {
      const sign = want.down ? -1 : 1;
      shown.sort((a, b) => {
        const x = column[a], y = column[b];
        if (x === null || y === null) return (x === null) - (y === null) || a - b;  // those without a value stay last
        return sign * (typeof x === "string" ? byNumbers.compare(x, y) : x - y) || a - b;
      });
    } else if (want.down) {
      shown.reverse();
    }
  };

  // address: everything that is not the default stands in the part after #
  const remember = () => {
    const want = wanted(), parts = new URLSearchParams();
    for (const name of FIELDS) if (want[name]) parts.set(name, want[name]);
    if (range) parts.set("range", range.join("-"));
    if (page) parts.set("page", String(page + 1));
    if (open >= 0) parts.set("frame", String(shown[open]));
    const text = parts.toString();
    if (text !== location.hash.slice(1) && (text || location.hash.includes("="))) {
      history.replaceState(null, "", text ? `#${text}` : location.pathname + location.search);
    }
  };
  const recall = () => {
    const parts = new URLSearchParams(location.hash.includes("=") ? location.hash.slice(1) : "");
    const form = element("filter");
    form.reset();
    for (const name of FIELDS) {
      const field = form.elements[name];
      if (!field) continue;
      if (field.type === "checkbox") field.checked = parts.has(name);
      else field.value = parts.get(name) || "";
    }
    const ends = /^(\d+)-(\d+)$/.exec(parts.get("range") || "");
    range = ends ? [Number(ends[1]), Number(ends[2])] : null;
    refresh(Number(parts.get("page") || 1) - 1);
    const frame = parts.get("frame");
    const place = frame === null ? -1 : shown.indexOf(Number(frame));
    if (place >= 0) openAt(place);
    else if (element("large").open) element("large").close();
  };

  const refresh = (wantedPage = 0) => {
    select();
    const pages = Math.max(1, Math.ceil(shown.length / PER_PAGE));
    page = Math.min(Math.max(0, Math.floor(wantedPage) || 0), pages - 1);
    cursor = page * PER_PAGE;
    paint();
    const no = shown.reduce((sum, k) => sum + refused(k), 0);
    element("count").textContent = `${shown.length} of ${run.columns.id.length} frames: ${shown.length - no} calibrated, ${no} refused`;
    element("range").hidden = !range;
    if (range) element("range").textContent = `only ${cell("id", range[0])} to ${cell("id", Math.min(range[1], run.columns.id.length - 1))} – show all`;
  };

  const paint = () => {
    const first = page * PER_PAGE;
    const cards = shown.slice(first, first + PER_PAGE).map((k, offset) => make("li", {}, card(k, first + offset)));
    element("list").replaceChildren(...(cards.length ? cards : [make("li", { className: "empty", textContent: "No frame passes this filter." })]));
    const pages = Math.max(1, Math.ceil(shown.length / PER_PAGE));
    element("page").textContent = `page ${page + 1} of ${pages}`;
    element("back").disabled = page === 0;
    element("on").disabled = page >= pages - 1;
  };
  const turn = (wantedPage, focusAt) => {
    page = wantedPage;
    paint();
    if (focusAt !== undefined) focusCard(focusAt);
    remember();
  };

  const nothing = (text) => make("span", { className: "none", textContent: text });
  const picture = (source, alt, lazy) => {
    const made = make("img", { alt, decoding: "async" });
    if (lazy) made.loading = "lazy";
    made.addEventListener("error", () => made.replaceWith(nothing("picture missing")), { once: true });
    made.src = source;
    return made;
  };
  const verdict = (k) => make("span", {
    className: `verdict ${refused(k) ? "no" : "yes"}`,
    textContent: refused(k) ? "✕ refused" : "✓ calibrated",
  });
  const card = (k, place) => {
    const kind = ["thumbnails", "template"].find((name) => has(k, name));
    const sigma = cell("sigma_px", k), number = cell("case", k);
    const said = refused(k) ? run.codes[cell("code", k)][0]
      : [sigma === null ? "no sigma" : `sigma ${short(sigma)} px`, ...(number === null ? [] : [`case ${number}`])].join(", ");
    const made = make("a", { className: "card", href: `#frame=${k}` },
      make("span", { className: "thumb" }, kind ? picture(file(k, kind), "", true) : nothing("no picture")),
      make("span", { className: "told" },
        make("span", { className: "name", textContent: cell("id", k) }),
        make("span", { className: "say" }, verdict(k)),
        make("span", { className: "say", textContent: said })));
    made.addEventListener("click", (event) => {
      if (event.ctrlKey || event.metaKey || event.shiftKey) return;
      event.preventDefault();
      openAt(place);
    });
    made.addEventListener("focus", () => { cursor = place; });
    return made;
  };

  const cards = () => [...element("list").querySelectorAll(".card")];
  const focusCard = (place) => {
    if (!shown.length) return;
    cursor = Math.min(Math.max(0, place), shown.length - 1);
    const there = Math.floor(cursor / PER_PAGE);
    if (there !== page) { page = there; paint(); remember(); }
    cards()[cursor - page * PER_PAGE]?.focus();
  };
  const inList = () => element("list").contains(document.activeElement);
  const perRow = () => {
    const all = cards();
    const top = all.length ? all[0].offsetTop : 0;
    const next = all.findIndex((one) => one.offsetTop !== top);
    return next < 0 ? Math.max(1, all.length) : next;
  };

  // large view
  const openAt = (place) => {
    open = Math.min(Math.max(0, place), shown.length - 1);
    cursor = open;
    const k = shown[open];
    const large = element("large");
    if (!large.open) large.showModal();
    element("large-title").replaceChildren(cell("id", k), " ", verdict(k));
    const video = cell("video", k);
    const when = video >= 0 ? `${run.videos[video]} at ${clock(cell("time_s", k))}, ` : "";
    element("place").textContent = `${when}${open + 1} of ${shown.length}`;
    element("previous").disabled = open === 0;
    element("next").disabled = open === shown.length - 1;
    stage(k);
    radar(k);
    why(k);
    tell(k);
    element("large-title").focus({ preventScroll: true });
    large.querySelector(".large-body").scrollTop = 0;
    remember();
  };
  const stage = (k) => {
    const box = element("stage");
    const layers = [];
    const drawn = (cell("media", k) & DRAWN) !== 0;
    const shape = (event) => box.style.setProperty("--shape", String(event.target.naturalWidth / event.target.naturalHeight || 16 / 9));
    if (has(k, "frames")) layers.push(picture(file(k, "frames"), `Frame ${cell("id", k)}${drawn ? " with the calibration drawn in" : ""}`));
    for (const kind of ["template", "points"]) {
      if (has(k, kind)) layers.push(Object.assign(picture(file(k, kind), kind === "template" ? "Field template as calibrated" : "Points of the circle"), { className: `layer ${kind}` }));
    }
    if (layers.length) layers[0].addEventListener("load", shape, { once: true });
    box.replaceChildren(...(layers.length ? layers : [nothing("no picture and nothing to draw")]));
    element("show-template").disabled = !has(k, "template");
    element("show-points").disabled = !has(k, "points");
    element("missing").textContent = drawn ? "the run's overlay: the frame's own file is gone"
      : has(k, "frames") ? "" : "the frame's file is gone";
    layered();
  };
  const look = (event) => {
    const box = element("stage").getBoundingClientRect();
    const share = (value, start, size) => String(Math.min(Math.max((value - start) / size, 0), 1));
    element("stage").style.setProperty("--look-x", share(event.clientX, box.left, box.width));
    element("stage").style.setProperty("--look-y", share(event.clientY, box.top, box.height));
  };
  const zoomed = () => element("stage").classList.toggle("zoomed", element("zoom").checked);
  const layered = () => {
    for (const kind of ["template", "points"]) {
      const on = element(`show-${kind}`).checked;
      for (const layer of document.querySelectorAll(`#stage .${kind}, #radar .${kind}`)) layer.hidden = !on;
    }
  };
  const radar = (k) => {
    const layers = [];
    if (has(k, "radar")) layers.push(picture(file(k, "radar"), "The frame seen from above"));
    if (has(k, "plan")) layers.push(Object.assign(picture(file(k, "plan"), "Field from above with the part that the frame shows"), { className: has(k, "radar") ? "layer template" : "layer" }));
    const ground = make("div", { className: "ground" }, ...layers);
    layers.at(-1)?.addEventListener("load", (event) => ground.style.setProperty("--shape", String(event.target.naturalWidth / event.target.naturalHeight || 1.5)), { once: true });
    element("radar").replaceChildren(...(layers.length ? [make("h3", { textContent: "Radar: the field from above" }), ground] : []));
    layered();
  };
  const why = (k) => {
    const box = element("why");
    if (!refused(k)) { box.replaceChildren(); return; }
    const [code, meaning, mend] = run.codes[cell("code", k)];
    const stageName = cell("stage", k);
    box.replaceChildren(make("div", { className: "said" },
      make("p", {}, make("code", { textContent: code }), stageName ? ` at ${stageName}` : ""),
      make("p", { textContent: cell("reason", k) || "" }),
      make("p", { className: "note", textContent: `${meaning} ${mend}` })));
  };
  const tell = (k) => {
    const block = Math.floor(k / run.perFile);
    const facts = element("facts"), more = element("more");
    if (!details.has(block)) {
      facts.replaceChildren();
      more.replaceChildren();
      details.set(block, null);
      const name = `details/${String(block).padStart(5, "0")}.js`;
      const script = make("script", { src: name });
      script.addEventListener("error", () => more.replaceChildren(make("p", { className: "note", textContent: `${name} is missing` })));
      document.head.append(script);
      return;
    }
    const told = details.get(block)?.[k % run.perFile];
    if (!told) return;
    facts.replaceChildren(...told.facts.flatMap(([label, text]) => [make("dt", { textContent: label }), make("dd", { textContent: text })]));
    const table = (title, heads, rows) => rows.length ? [make("div", {}, make("h3", { textContent: title }), make("table", {},
      make("thead", {}, make("tr", {}, ...heads.map((head, n) => make("th", { scope: "col", className: n ? "number" : "", textContent: head })))),
      make("tbody", {}, ...rows.map((row) => make("tr", {}, ...row.map((text, n) => make("td", { className: n ? "number" : "", textContent: text })))))))] : [];
    more.replaceChildren(
      ...table("Checks", ["check", "value", "limit", "passed"], told.checks.map(([name, value, limit, passed]) => [name, value, limit, passed ? "✓" : "✕ no"])),
      ...table("Time", ["stage", "ms"], told.times));
  };
  window.circlecalDetails = (block, content) => {
    details.set(block, content);
    if (open >= 0 && Math.floor(shown[open] / run.perFile) === block) tell(shown[open]);
  };

  const toggle = (kind) => {
    const box = element(`show-${kind}`);
    if (!box.disabled) { box.checked = !box.checked; layered(); }
  };
  const zoom = () => {
    element("zoom").checked = !element("zoom").checked;
    zoomed();
  };
  const onKey = (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || !run) return;
    const large = element("large").open;
    const typing = event.target.matches?.("input:not([type=checkbox]), select, textarea");
    if (event.key === "Escape" && typing && !large) { event.target.blur(); return; }
    if (typing) return;
    const step = { j: 1, k: -1, ArrowRight: 1, ArrowLeft: -1 }[event.key];
    if (large) {
      if (step) openAt(open + step);
      else if (event.key === "t") toggle("template");
      else if (event.key === "p") toggle("points");
      else if (event.key === "z") zoom();
      else return;
    } else if (event.key === "/") {
      element("filter").elements.q.focus();
      element("filter").elements.q.select();
    } else if (event.key === "j" || event.key === "k" || (step && inList())) {
      focusCard(inList() ? cursor + step : cursor);
    } else if ((event.key === "ArrowDown" || event.key === "ArrowUp") && inList()) {
      focusCard(cursor + (event.key === "ArrowDown" ? perRow() : -perRow()));
    } else if (event.key === "Enter" && document.activeElement === document.body && shown.length) {
      openAt(cursor);
    } else {
      return;
    }
    event.preventDefault();
  };

  window.circlecalFrames = (content) => {
    run = content;
    const form = element("filter");
    let waiting = 0;
    const changed = () => { clearTimeout(waiting); waiting = setTimeout(() => { refresh(); remember(); }, 80); };
    form.addEventListener("input", changed);
    form.addEventListener("submit", (event) => event.preventDefault());
    form.addEventListener("reset", () => { range = null; setTimeout(() => { refresh(); remember(); }); });
    element("range").addEventListener("click", () => { range = null; refresh(); remember(); form.elements.q.focus(); });
    element("back").addEventListener("click", () => turn(page - 1, (page - 1) * PER_PAGE));
    element("on").addEventListener("click", () => turn(page + 1, (page + 1) * PER_PAGE));
    element("previous").addEventListener("click", () => openAt(open - 1));
    element("next").addEventListener("click", () => openAt(open + 1));
    element("close").addEventListener("click", () => element("large").close());
    element("large").addEventListener("close", () => {
      const place = open;  // the browser gives the focus back to the card that was opened first
      open = -1;
      focusCard(place);
      remember();
    });
    element("large").addEventListener("click", (event) => { if (event.target === element("large")) element("large").close(); });
    for (const kind of ["template", "points"]) element(`show-${kind}`).addEventListener("change", layered);
    element("zoom").addEventListener("change", zoomed);
    element("stage").addEventListener("click", (event) => { look(event); zoom(); });
    element("stage").addEventListener("pointermove", (event) => { if (event.pointerType === "mouse") look(event); });
    document.addEventListener("keydown", onKey);
    for (const bar of document.querySelectorAll("[data-range]")) {
      bar.addEventListener("click", () => { location.hash = `range=${bar.dataset.range}`; });
    }
    window.addEventListener("hashchange", () => {
      if (!location.hash.includes("=")) return;
      recall();
      if (open < 0) element("frames").scrollIntoView();
    });
    recall();
  };

  document.addEventListener("DOMContentLoaded", () => {
    setTheme(root.dataset.theme);
    element("theme").addEventListener("click", () => {
      const name = root.dataset.theme === "dark" ? "light" : "dark";
      setTheme(name);
      try { localStorage.setItem("circlecal-theme", name); } catch { /* private window */ }
    });
  });
})();
