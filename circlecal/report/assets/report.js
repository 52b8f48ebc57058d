"use strict";
// The list of frames and the large view. frames.js calls circlecalFrames, details/*.js call circlecalDetails, records/*.js
// circlecalRecord, annotate.js circlecalAnnotate.
(() => {
  const { element, make, short, clock, quote, saveFile, picture, nothing } = circlecalPage;
  const MEDIA = {
    thumbnails: [1, "jpg"], frames: [2, "jpg"], template: [4, "svg"],
    points: [8, "svg"], radar: [16, "jpg"], plan: [32, "svg"], other: [128, "svg"],
  };
  const DRAWN = 64;
  const LAYERS = { template: "Field template as calibrated", points: "Points of the circle", other: "Field template as the other run's camera draws it" };
  const PER_PAGE = 60;
  const MOST_PRINTED = 2000;  // some 40 sheets
  const SORTS = { id: "id", verdict: "code", reason: "code", case: "case", sigma: "sigma_px", residual: "rms_px", time: "time_ms", apart: "apart_px" };
  const FIELDS = ["q", "verdict", "reason", "case", "camera", "rig", "change", "from", "to", "sort", "down"];
  const byNumbers = new Intl.Collator("en", { numeric: true });

  let run = null;      // what frames.js holds
  let shown = [];      // positions of the frames that pass the filter, sorted
  let page = 0;
  let range = null;    // first and last position, from the timeline
  let bar = null;      // column, smallest value, first larger value (null: no limit), from a histogram
  let workbench = null;  // address of circlecal annotate, where it runs
  let open = -1;       // place in `shown` of the large view
  let cursor = 0;      // place in `shown` of the card that has or had the focus
  let stage = null;    // the large picture
  let markMoment = () => {};
  const details = new Map();

  const cell = (column, k) => run.columns[column][k];
  const refused = (k) => cell("code", k) >= 0;
  const has = (k, kind) => (cell("media", k) & MEDIA[kind][0]) !== 0;
  const file = (k, kind) => {
    const folder = String(Math.floor(k / run.perFolder)).padStart(3, "0");
    return `${kind}/${folder}/${String(k).padStart(6, "0")}.${MEDIA[kind][1]}`;
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
      if (want.change && cell("change", k) !== Number(want.change)) return false;
      if (bar) {
        const value = cell(bar[0], k);
        if (value === null || (bar[1] !== null && value < bar[1]) || (bar[2] !== null && value >= bar[2])) return false;
      }
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
    if (bar) parts.set("bar", bar.map((limit) => limit ?? "").join(":"));
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
    const limits = /^(sigma_px|rms_px|time_ms):([-+.\de]*):([-+.\de]*)$/.exec(parts.get("bar") || "");
    bar = limits ? [limits[1], ...limits.slice(2).map((limit) => (limit === "" ? null : Number(limit)))] : null;
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
    element("bar").hidden = !bar;
    if (bar) {
      const [name, unit] = { sigma_px: ["sigma", "px at 1920 px width"], rms_px: ["residual", "px at 1920 px width"], time_ms: ["time", "ms"] }[bar[0]];
      element("bar").textContent = `only ${name} ${bar[1] === null ? "below" : `${short(bar[1])} to`} ${bar[2] === null ? "any" : short(bar[2])} ${unit} – show all`;
    }
    element("ids").disabled = !shown.length;
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
  // On paper: the cards of this page, and a table of all frames that pass the filter where these are more.
  const print = () => {
    const rows = shown.slice(0, MOST_PRINTED).map((k) => {
      const sigma = cell("sigma_px", k), number = cell("case", k);
      const texts = [cell("id", k), refused(k) ? "refused" : "calibrated", refused(k) ? run.codes[cell("code", k)][0] : number === null ? "" : `case ${number}`, sigma === null ? "" : short(sigma)];
      return make("tr", {}, ...texts.map((text, n) => make("td", { className: n === 3 ? "number" : "", textContent: text })));
    });
    const left = shown.length > MOST_PRINTED ? `; the first ${MOST_PRINTED} of them here` : "";
    const caption = make("caption", { textContent: `${element("count").textContent}${left}` });
    const heads = ["frame", "verdict", "reason or case", "sigma, px at 1920"].map((text, n) => make("th", { scope: "col", className: n === 3 ? "number" : "", textContent: text }));
    element("printed").replaceChildren(caption, ...(shown.length > PER_PAGE ? [make("thead", {}, make("tr", {}, ...heads)), make("tbody", {}, ...rows)] : []));
  };
  const turn = (wantedPage, focusAt) => {
    page = wantedPage;
    paint();
    if (focusAt !== undefined) focusCard(focusAt);
    remember();
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
    const change = cell("change", k) > 0 ? [make("span", { className: "say", textContent: run.changes[cell("change", k)] })] : [];
    const made = make("a", { className: "card", href: `#frame=${k}` },
      make("span", { className: "thumb" }, kind ? picture(file(k, kind), "", true) : nothing("no picture")),
      make("span", { className: "told" },
        make("span", { className: "name", textContent: cell("id", k) }),
        make("span", { className: "say" }, verdict(k)),
        make("span", { className: "say", textContent: said }), ...change));
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
    show(k);
    radar(k);
    why(k);
    tell(k);
    annotating(k);
    markMoment(k);
    showRecord(null);
    element("large-title").focus({ preventScroll: true });
    large.querySelector(".large-body").scrollTop = 0;
    remember();
  };
  const show = (k) => {
    const layers = [], drawn = (cell("media", k) & DRAWN) !== 0;
    if (has(k, "frames")) layers.push(picture(file(k, "frames"), `Frame ${cell("id", k)}${drawn ? " with the calibration drawn in" : ""}`));
    for (const [kind, alt] of Object.entries(LAYERS)) {
      element(`show-${kind}`).disabled = !has(k, kind);
      if (has(k, kind)) layers.push(Object.assign(picture(file(k, kind), alt), { className: `layer ${kind}` }));
    }
    stage.load(layers.length ? layers : [nothing("no picture and nothing to draw")]);
    element("missing").textContent = has(k, "frames") && !drawn ? ""
      : `${drawn ? "this is the run's overlay; " : ""}the frame's own file was not found: circlecal report --frames FOLDER tells where it is`;
    layered();
  };
  const layered = () => {
    for (const kind of Object.keys(LAYERS)) {
      const on = element(`show-${kind}`).checked;
      for (const layer of document.querySelectorAll(`#stage .${kind}, #radar .${kind}`)) layer.hidden = !on;
    }
    stage.showHeat(element("show-heat").checked);
    element("heat-scale").hidden = stage.heat.hidden;
  };
  const under = (text, field) => {
    element("under").textContent = text;
    const here = document.querySelector("#radar .here"), half = stage.told?.radar;
    if (!here || !half) return;
    here.hidden = !field || Math.abs(field[0]) > half[0] || Math.abs(field[1]) > half[1];
    if (here.hidden) return;
    here.style.left = `${50 + (50 * field[0]) / half[0]}%`;
    here.style.top = `${50 + (50 * field[1]) / half[1]}%`;
  };
  const radar = (k) => {
    const layers = [];
    if (has(k, "radar")) layers.push(picture(file(k, "radar"), "The frame seen from above"));
    if (has(k, "plan")) layers.push(Object.assign(picture(file(k, "plan"), "Field from above with the part that the frame shows"), { className: has(k, "radar") ? "layer template" : "layer" }));
    const ground = make("div", { className: "ground" }, ...layers, make("i", { className: "here", hidden: true }));
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
    stage.tell(told);
    element("show-heat").disabled = !told.sigma;
    layered();
    facts.replaceChildren(...told.facts.flatMap(([label, text]) => [make("dt", { textContent: label }), make("dd", { textContent: text })]));
    const cell = (content, n) => {  // a text, or one with what it means, which is shown where it matters
      const [text, meaning, matters] = Array.isArray(content) ? content : [content, "", false];
      const note = matters && meaning ? [make("p", { className: "note", textContent: meaning })] : [];
      return make("td", { className: n ? "number" : "", title: meaning, textContent: text }, ...note);
    };
    const table = (title, heads, rows) => rows.length ? [make("div", {}, make("h3", { textContent: title }), make("table", {},
      make("thead", {}, make("tr", {}, ...heads.map((head, n) => make("th", { scope: "col", className: n ? "number" : "", textContent: head })))),
      make("tbody", {}, ...rows.map((row) => make("tr", {}, ...row.map(cell))))))] : [];
    more.replaceChildren(
      ...table("Against the other run", ["", ""], told.other),
      ...table("Checks", ["check", "value", "limit", "passed"], told.checks.map(([name, value, limit, passed]) => {
        const [measures, atLeast] = run.checks[name] ?? ["", null];
        const bound = atLeast === null ? limit : `${atLeast ? "≥" : "≤"} ${limit}`;
        return [[name, measures, !passed], value, bound, passed ? "✓" : "✕ no"];
      })),
      ...table("Time", ["stage", "ms"], told.times));
  };
  window.circlecalDetails = (block, content) => {
    details.set(block, content);
    if (open >= 0 && Math.floor(shown[open] / run.perFile) === block) tell(shown[open]);
  };

  // the whole record: one file each, read when it is asked for
  const showRecord = (k) => {
    const box = element("record");
    box.hidden = k === null;
    element("show-record").setAttribute("aria-expanded", String(k !== null));
    if (k === null) return;
    element("record-text").textContent = "reading …";
    const name = `records/${String(Math.floor(k / run.perFolder)).padStart(3, "0")}/${String(k).padStart(6, "0")}.js`;
    const script = make("script", { src: name });
    script.addEventListener("error", () => { element("record-text").textContent = `${name} is missing`; });
    script.addEventListener("load", () => script.remove());
    document.head.append(script);
  };
  window.circlecalRecord = (k, record) => { if (shown[open] === k) element("record-text").textContent = JSON.stringify(record, null, 1); };

  const annotating = (k) => {
    element("command").textContent = `circlecal annotate ${quote(run.folder)} --frame ${quote(cell("id", k))}`;
    const link = element("annotate");
    link.hidden = !workbench;
    if (workbench) link.href = `${workbench}#${encodeURIComponent(cell("id", k))}`;
  };
  window.circlecalAnnotate = (address) => { workbench = /^http:\/\/127\.0\.0\.1:\d+\/[\w-]+\/$/.test(address || "") ? address : null; };

  const moment = (k) => {
    const sigma = cell("sigma_px", k);
    const time = cell("time_s", k) === null ? "" : `${clock(cell("time_s", k))}, `;
    return `${time}${cell("id", k)}: ${refused(k) ? `refused, ${run.codes[cell("code", k)][0]}` : `calibrated${sigma === null ? "" : `, sigma ${short(sigma)} px`}`}`;
  };
  const openFrame = (k) => {
    if (!shown.includes(k)) { element("filter").reset(); range = bar = null; refresh(); }
    openAt(shown.indexOf(k));
  };
  const choose = (first, last) => { range = [first, last]; refresh(); remember(); element("frames").scrollIntoView(); };

  const toggle = (id) => {
    const box = element(id);
    if (!box.disabled) { box.checked = !box.checked; layered(); }
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
      else if (event.key === "t") toggle("show-template");
      else if (event.key === "p") toggle("show-points");
      else if (event.key === "o") toggle("show-other");
      else if (event.key === "m") toggle("show-heat");
      else if (event.key === "z") stage.toggle();
      else if (event.key === "+" || event.key === "-") stage.zoomBy(event.key === "+" ? 1.4 : 1 / 1.4);
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
    form.addEventListener("reset", () => { range = bar = null; setTimeout(() => { refresh(); remember(); }); });
    element("range").addEventListener("click", () => { range = null; refresh(); remember(); form.elements.q.focus(); });
    element("bar").addEventListener("click", () => { bar = null; refresh(); remember(); form.elements.q.focus(); });
    element("ids").addEventListener("click", () => saveFile("ids.txt", shown.map((k) => `${cell("id", k)}\n`).join(""), "text/plain"));
    element("show-record").addEventListener("click", () => showRecord(element("record").hidden ? shown[open] : null));
    element("save-record").addEventListener("click", () => saveFile(`${cell("id", shown[open]).replaceAll("/", "_")}.json`, element("record-text").textContent, "application/json"));
    element("copy").addEventListener("click", async () => {
      try { await navigator.clipboard.writeText(element("command").textContent); element("copy").textContent = "Copied"; } catch { getSelection().selectAllChildren(element("command")); }
    });
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
    for (const name of [...Object.keys(LAYERS), "heat"]) element(`show-${name}`).addEventListener("change", layered);
    element("zoom").addEventListener("change", () => stage.toggle());
    document.addEventListener("keydown", onKey);
    stage = new circlecalPage.Stage(element("stage"), { under, zoomed: (on) => { element("zoom").checked = on; } });
    element("heat-scale").append("sigma at 1920 px width:", ...circlecalCamera.SCALE.flatMap((limit, k) => {
      const swatch = make("i");
      swatch.style.background = `rgb(${circlecalCamera.COLOURS[k].join(" ")})`;
      return [swatch, `${limit} px`];
    }));
    markMoment = circlecalPage.timelines(moment, openFrame, choose);
    let theme = "";
    window.addEventListener("beforeprint", () => { theme = document.documentElement.dataset.theme; document.documentElement.dataset.theme = "light"; for (const image of document.querySelectorAll("#list img")) image.loading = "eager"; print(); });
    window.addEventListener("afterprint", () => { document.documentElement.dataset.theme = theme; element("printed").replaceChildren(); });
    window.addEventListener("hashchange", () => {
      if (!location.hash.includes("=")) return;
      recall();
      if (open < 0) element("frames").scrollIntoView();
    });
    recall();
  };
})();
