// The workbench: what is chosen, what is changed, undo, saving, and everything around picture and field.
import * as net from "./net.js";
import { FieldMap } from "./field.js";
import { FrameList, isToDo } from "./list.js";
import { Stage } from "./stage.js";
import * as drafts from "./drafts.js";

const by = (id) => document.getElementById(id);
const make = (tag, properties, ...inside) => { const node = Object.assign(document.createElement(tag), properties); node.append(...inside); return node; };
const words = (name) => name.replaceAll("_", " ");
const SETTLE_MS = 350, MOST_LINES = 12, AGAIN_MS = 1500, WARM_MS = 1200, AUTHOR = "circlecal author";
const PRIORS = [["field.sizes.length", "field length, m", 105], ["field.sizes.width", "field width, m", 68], ["camera.crown_m", "crown at the circle, m", 0.05], ["camera.k1_mean", "lens, kappa", "for its zoom"]];

let field = null, map = null, list = null, index = -1, annotation = null, answer = null;
let chosen = -1, active = null, offers = [], preview = null, unsaved = false, saving = null, settling = 0, typing = 0, warming = 0, opening = 0, searches = 0;
let start = null, asking = 0, isLeaving = false;
const past = [], future = [];

const copy = (value) => structuredClone(value);
const content = () => copy({ markings: annotation.markings, note: annotation.note, flag: annotation.flag, settings: annotation.settings });
const kindOf = (name) => field.markings.find((m) => m.name === name)?.kind || "point";
const tellAll = (title, text) => { by("trouble-title").textContent = title; by("trouble-text").textContent = text; if (!by("trouble").open) by("trouble").showModal(); };
const tellLines = (title, lines) => { if (lines.length) tellAll(title, [...lines.slice(0, MOST_LINES), ...(lines.length > MOST_LINES ? [`and ${lines.length - MOST_LINES} more`] : [])].join("\n")); };
const trouble = (error) => error.isOffline ? wait(error) : tellAll("That did not work", error.message);
const guarded = (act) => async (...given) => { try { return await act(...given); } catch (error) { trouble(error); return undefined; } };

const stage = new Stage(by("stage"), {
  marks: () => active !== null,
  hover: (place) => tellUnder(place),
  click: guarded((place, how) => clicked(place, how)),
  follow: guarded((way) => followed(way)),
  zoomed: () => { if (annotation) draw(); },
});

// --- a server that is gone

// What to do, until the server answers: after another start of it the page is loaded anew, which takes up what was not saved.
const wait = (error) => {
  by("offline").textContent = error.message;
  by("offline").hidden = false;
  asking ||= setTimeout(askAgain, AGAIN_MS);
};
const askAgain = async () => {
  asking = 0;
  try {
    const told = await net.listing();
    by("offline").hidden = true;
    if (told.start !== start) { isLeaving = true; location.reload(); } else if (unsaved) await push();
  } catch (error) { wait(error); }
};

// --- changing, undoing, saving

const change = (act) => {
  const before = content();
  act(annotation);
  past.push(before);
  if (past.length > 300) past.shift();
  future.length = 0;
  stored();
};
const stored = () => {
  unsaved = true;
  drafts.keep(annotation.id, annotation.revision, { ...content(), confirmed: annotation.confirmed });
  offers = []; answer = { ...answer, suggested: {}, wrong: [] };  // they were for the markings before
  draw();
  return push();
};
const confirm = async () => {  // what is calibrated, as it is: saved, and on to the next frame
  if (answer.status !== "calibrated") return;
  annotation.confirmed = true;
  await stored();
  if (!unsaved) list.step(1, isToDo) || list.step(1) || nextToDo();
};
const undo = (from, to) => {
  if (!from.length) return;
  to.push(content());
  Object.assign(annotation, from.pop());
  chosen = -1;
  fill();
  stored();
};

// Once it has ended, everything is saved, or a dialog says why not and the change stays unsaved on the page.
const push = () => saving ??= send().finally(() => { saving = null; });
const send = guarded(async () => {
  if (!unsaved) return;
  clearTimeout(settling);
  try {
    while (unsaved) {
      unsaved = false;
      const sent = content();
      by("saved").textContent = "saving …";
      const started = performance.now(), told = await net.save(index, annotation.revision, { ...annotation, ...sent, author: by("author").value.trim() });
      for (const key of ["revision", "touched", "author", "changed_at"]) annotation[key] = told.annotation[key];
      if (!unsaved) drafts.drop(annotation.id);
      askName();
      document.body.dataset.milliseconds = String(Math.round(performance.now() - started));
      by("saved").textContent = "saved";
      list.frames[index] = told.row;
      if (!unsaved) { answer = told.answer; draw(); listed(); }
    }
    settling = setTimeout(settle, SETTLE_MS);
  } catch (error) {
    unsaved = true;
    by("saved").textContent = "not saved yet";
    if (error.status === 409) { conflict(error.current); return; }
    throw error;
  }
});
// What is typed counts without leaving the input.
const takeTyped = () => {
  clearTimeout(typing);
  if (document.activeElement?.matches("#note, #priors input")) document.activeElement.blur();
  keepNote();
};
const keepNote = () => {
  clearTimeout(typing);
  if (annotation && by("note").value !== annotation.note) change((a) => { a.note = by("note").value; });
};
/** Whether nothing of the frame that is shown would be lost by leaving it. */
const isSaved = async () => { takeTyped(); await push(); return !unsaved; };
const settle = guarded(async () => {
  const at = index, revision = annotation.revision;
  if (annotation.markings.some((m) => m.used && m.kind === "line" && !m.name)) {
    const told = await net.show(at);
    if (at !== index || unsaved || annotation?.revision !== revision) return;
    answer = told.answer;
    list.frames[at] = told.row;
    draw(); listed();
  }
  await offer();
});
const offer = async () => {
  const at = index, revision = annotation.revision;
  if (answer.status === "calibrated" || annotation.flag) return;
  let found;
  searches += 1; tell();
  try { found = await net.interpretations(at); } finally { searches -= 1; tell(); }
  if (at !== index || annotation?.revision !== revision || unsaved) return;
  offers = found;
  tell();
};

const conflict = (current) => {
  by("conflict").showModal();
  by("take-theirs").onclick = () => { by("conflict").close(); unsaved = false; drafts.drop(annotation.id); open(index); };
  by("keep-mine").onclick = () => { by("conflict").close(); annotation.revision = current.revision; stored(); };
};

// --- frames

// The frame before stays the one that is changed and saved until the wanted one is there, or it cannot be left.
const open = guarded(async (wanted, said = "") => {
  const turn = ++opening;
  list.select(wanted);
  if (!(await isSaved())) { stay(wanted, said); return; }
  if (turn !== opening) return;
  by("busy").hidden = false;
  by("frames").classList.remove("open");
  by("show-frames").setAttribute("aria-expanded", "false");
  let told = null, failure = null;
  try { told = await net.show(wanted); } catch (error) { failure = error; } finally { if (turn === opening) by("busy").hidden = true; }
  if (turn !== opening) return;
  if (!(await isSaved())) { stay(wanted, said); return; }
  clearTimeout(settling);
  index = wanted; chosen = -1; active = null; offers = []; preview = null; past.length = future.length = 0;
  annotation = told?.annotation ?? null; answer = told?.answer ?? null;
  document.querySelector(".side").inert = document.querySelector(".middle").inert = !annotation;
  if (failure) { clear(); throw failure; }
  list.frames[wanted] = told.row;
  by("title").textContent = annotation.id;
  document.title = `${annotation.id} – circlecal workbench`;
  stage.picture.alt = `The frame ${annotation.id}`;
  stage.load(`frames/${wanted}.jpg`, annotation.width, annotation.height);
  by("saved").textContent = said || (annotation.touched ? "saved" : "");
  fill();
  draw(); listed();
  history.replaceState(null, "", `#${encodeURIComponent(annotation.id)}`);
  takeUp();
  await offer();
  clearTimeout(warming);
  warming = setTimeout(warm, WARM_MS);
});
// The next frame is measured while this one is looked at.
const warm = async () => {
  const next = list.shown.find((k) => k > index && isToDo(list.frames[k])) ?? list.shown.find((k) => k > index);
  if (next === undefined || unsaved || saving || searches) return;
  try { await net.measured(next); } catch { /* told when it is opened */ }
};
// What was not saved of a frame before its server or its window ended; it was made from an earlier revision, which the
// server compares.
const takeUp = () => {
  const draft = drafts.find(annotation.id);
  if (!draft) return;
  past.push(content());
  Object.assign(annotation, draft.content, { revision: draft.base });
  fill();
  stored();
};
const stay = (wanted, said) => {
  list.select(index);
  by("busy").hidden = true;
  if (by("conflict").open) return;
  by("drop").hidden = false;
  by("drop").onclick = () => { by("trouble").close(); unsaved = false; drafts.drop(annotation.id); open(wanted, said); };
};
const clear = () => {  // a frame that cannot be shown
  by("title").textContent = list.frames[index][0];
  by("verdict").className = "chip no";
  by("verdict").textContent = "cannot be shown";
  for (const id of ["saved", "missing", "offers", "markings", "facts", "priors"]) by(id).replaceChildren();
  by("note").value = by("flag").value = "";
  by("undo").disabled = by("redo").disabled = true;
  stage.clear();
  listed();
};
const listed = () => {
  list.keep(by("kind").value, by("search").value);
  list.select(index);
  const todo = list.frames.filter(isToDo).length, done = list.frames.filter((f) => f[5]).length;
  by("count").textContent = `${list.shown.length} of ${list.frames.length} ${list.frames.length === 1 ? "frame" : "frames"}, ${todo} to do, ${done} annotated`;
};

// --- naming and marking

const named = (number, name) => change((a) => {
  const marking = a.markings[number];
  if (name === null || (marking.name === name && marking.used)) {
    if (marking.source === "clicked" || marking.kind === "point") a.markings.splice(number, 1);
    else if (marking.name === null) marking.used = false;
    else { marking.name = null; if (marking.kind === "curve") marking.used = false; }
  } else {
    marking.name = name; marking.used = true;
  }
});
const fitting = (marking, name) => kindOf(name) === marking.kind || (marking.kind === "point" && kindOf(name) !== "point" ? false : kindOf(name) === marking.kind);

const pick = (name) => {
  if (!annotation) return;
  const marking = annotation.markings[chosen];
  if (marking && fitting(marking, name)) { const number = chosen; chosen = -1; named(number, name); return; }
  active = active === name ? null : name;
  chosen = -1;
  draw();
};
const add = (name, kind, points, sigma, joined) => change((a) => {
  const own = joined ? a.markings.find((m) => m.name === name && m.source === "clicked" && m.kind === kind) : null;
  if (own) { own.points_px.push(...points); own.sigma_px.push(...sigma); return; }
  if (kind === "point") a.markings = a.markings.filter((m) => m.name !== name);
  a.markings.push({ name, kind, edge: "center", points_px: points, sigma_px: sigma, ends: [], source: "clicked", used: true });
});

const clicked = async (place, { exact }) => {
  if (!annotation || !stage.inside(place)) return;
  const under = exact ? -1 : stage.markingAt(place, annotation.markings);
  const there = annotation.markings[under];
  if (active === null) { chosen = under === chosen ? -1 : under; draw(); return; }
  if (there && there.source !== "clicked" && fitting(there, active) && kindOf(active) !== "point") { named(under, active); return; }
  const name = active, kind = kindOf(name), at = index;
  const mode = exact || !by("snap").checked || kind === "point" ? "exact" : "click";
  const found = await net.mark(at, mode, [place], name);
  if (at !== index) return;
  add(name, kind, found.points, found.sigma, true);
  if (mode !== "exact") await grow(name, kind, at);
};
// Two clicks on a line measure what lies between; the clicks on a circle measure the circle that they mean.
const grow = async (name, kind, at) => {
  const own = annotation.markings.find((m) => m.name === name && m.source === "clicked" && m.kind === kind);
  if (!own || (kind === "line" && own.points_px.length !== 2) || (kind === "curve" && (own.points_px.length < 2 || own.points_px.length > 12))) return;
  const found = await net.mark(at, kind === "line" ? "path" : "circle", own.points_px, name);
  if (at !== index || !found.on_paint || found.points.length <= own.points_px.length) return;
  change((a) => {
    const again = a.markings.find((m) => m.name === name && m.source === "clicked" && m.kind === kind);
    if (again) { again.points_px = found.points; again.sigma_px = found.sigma; again.source = "measured"; }
  });
};
const followed = async (way) => {
  const name = active, kind = kindOf(name), at = index;
  if (kind === "point" || way.length < 2) return;
  const found = await net.mark(at, by("snap").checked ? "path" : "exact", way.slice(0, 2000), name);
  if (at === index) add(name, kind, found.points, found.sigma, true);
};
const nudge = (dx, dy) => change((a) => { const own = a.markings[chosen]; own.points_px = own.points_px.map(([x, y]) => [x + dx, y + dy]); });
const accept = () => {
  if (answer.wrong?.length) { answer.wrong.filter((one) => Object.values(one.names)[0]).slice(0, 1).forEach(take); return; }
  const fits = Object.entries(answer.suggested);
  if (fits.length) change((a) => fits.forEach(([k, name]) => { a.markings[k].name = name; a.markings[k].used = true; }));
  else if (offers.length) take(offers[0]);
};
// A name that is null is taken away with nothing in its place: the marking is not used.
const take = (offered) => change((a) => Object.entries(offered.names).forEach(([k, name]) => { a.markings[k].name = name ?? (a.markings[k].kind === "line" ? null : a.markings[k].name); a.markings[k].used = name !== null; }));

// --- telling

const view = () => ({ annotation, answer, chosen, showTemplate: by("show-template").checked, showMarkings: by("show-markings").checked, circle: field.circle, preview });
const draw = () => {
  if (!annotation) return;
  stage.draw(view());
  stage.drawHeat(by("show-heat").checked ? answer.sigma : null, 1920 / annotation.width);
  by("scale").hidden = !by("show-heat").checked;
  const used = new Set(annotation.markings.filter((m) => m.used && m.name).map((m) => m.name));
  map.draw(used, active, new Set(Object.values(answer.suggested)), answer.footprint);
  tell();
};
// Numbers of the markings as the list has them: those with a name first.
const listOrder = () => annotation.markings.map((m, k) => k).sort((a, b) => (annotation.markings[a].name ? 0 : 1) - (annotation.markings[b].name ? 0 : 1));
const tell = () => {
  const good = answer.status === "calibrated", wrong = [...(answer.wrong ?? []), ...offers.filter((one) => one.instead)];
  const verdict = by("verdict");
  verdict.textContent = annotation.flag ? words(annotation.flag) : good ? `calibrated, sigma ${answer.sigma_px?.toFixed(1) ?? "?"} px (${answer.rating}), ${answer.sigma_m?.toFixed(2) ?? "?"} m` : `refused: ${words(answer.code ?? "no camera")}`;
  verdict.title = verdict.textContent;  // narrow windows cut it off
  verdict.className = `chip ${good ? "yes" : "no"}`;
  by("advice").className = good && !wrong.length ? "yes" : "no";
  const doubt = list?.frames[index]?.[1] === "doubtful" ? `, but known to ${answer.sigma_px?.toFixed(0) ?? "?"} px only: one more line or point helps` : "";
  by("missing").textContent = annotation.flag ? `Flagged: ${words(annotation.flag)}. It is left out of every run; take the flag away to use it.` : wrong.length ? wrong.map((one) => one.told).join(" ") : good ? `Calibrated${doubt}. Look whether the template lies on the paint.` : answer.missing || answer.reason || "";
  const why = good || annotation.flag || by("missing").textContent === answer.reason ? "" : answer.reason || "";
  by("why").textContent = why && `Why: ${why}.`;
  by("why").hidden = !why;
  const fits = Object.entries(answer.suggested);
  const buttons = [];
  if (wrong.length) wrong.forEach((one, k) => {
    const [[number, name]] = Object.entries(one.names), before = one.instead[number];
    const button = make("button", { type: "button", className: "mend", onclick: () => take(one) }, name ? `Name it ${words(name)}, not ${words(before)} ` : `Take ${words(before)} away `);
    if (name && k === wrong.findIndex((other) => Object.values(other.names)[0])) button.append(make("kbd", { textContent: "a" }));
    buttons.push(button);
  });
  else if (fits.length) buttons.push(make("button", { type: "button", onclick: accept }, `Accept ${fits.length === 1 ? "the line that fits" : `${fits.length} lines that fit`}: ${[...new Set(fits.map(([, name]) => words(name)))].join(", ")} `, make("kbd", { textContent: "a" })));
  else offers.forEach((offered, k) => {
    const button = make("button", { type: "button", onclick: () => take(offered) }, `${k ? "Or" : "Perhaps"}: ${[...new Set(Object.values(offered.names))].map(words).join(", ")} `);
    if (!k) button.append(make("kbd", { textContent: "a" }));
    const show = (on) => { preview = on ? Object.keys(offered.names).flatMap((n) => [annotation.markings[n].points_px]) : null; stage.draw(view()); };
    button.addEventListener("mouseenter", () => show(true)); button.addEventListener("mouseleave", () => show(false));
    buttons.push(button);
  });
  if (good && !wrong.length && !annotation.flag && !list?.frames[index]?.[5]) buttons.push(make("button", { type: "button", id: "confirm", onclick: guarded(confirm) }, "It does: save, next frame ", make("kbd", { textContent: "y" })));
  if (!buttons.length && searches && !annotation.flag && answer.status !== "calibrated") buttons.push(make("small", { textContent: "Looking for names that fit …" }));
  by("offers").replaceChildren(...buttons);
  by("active").textContent = active ? `marking: ${words(active)}` : chosen >= 0 ? "which marking is it?" : "";
  by("hint").textContent = active ? "Click or drag along it in the picture; click it here again to stop." : chosen >= 0 ? "Click its marking here, or press its key." : "Click something in the picture, then its marking here. Or a marking first, then its paint.";
  const focused = document.activeElement?.dataset?.marking;
  by("markings").replaceChildren(...listOrder().map((k) => {
    const marking = annotation.markings[k], told = answer.markings[k] || {};
    const kind = told.contradicts ? "wrong" : !marking.used ? "offered" : marking.name ? "named" : "";
    const title = marking.name ? words(marking.name) : told.recognised ? `${words(told.recognised)} (recognised)` : !marking.used ? `${marking.kind === "curve" ? "ellipse" : marking.kind}, not used` : `${marking.kind}, no name`;
    const note = told.contradicts ? "contradicts" : told.rms_px !== null && told.rms_px !== undefined ? `${told.rms_px.toFixed(1)} px off` : `${marking.points_px.length} ${marking.points_px.length === 1 ? "point" : "points"}`;
    const button = make("button", { type: "button", className: `pick ${kind}`, ariaPressed: String(k === chosen), onclick: () => { chosen = chosen === k ? -1 : k; active = null; draw(); } },
      make("i", { className: "swatch" }), make("span", { textContent: title }), make("small", { textContent: note }));
    button.dataset.marking = String(k);
    const away = make("button", { type: "button", className: "away", ariaLabel: `Take ${title} away`, title: "Take away", textContent: "×", onclick: () => { chosen = -1; named(k, null); } });
    return make("li", { className: kind }, button, away);
  }));
  if (focused !== undefined) document.querySelector(`[data-marking="${focused}"]`)?.focus();
  by("facts").replaceChildren(...answer.facts.flatMap(([label, text]) => [make("dt", { textContent: label }), make("dd", { textContent: text })]));
  by("undo").disabled = !past.length; by("redo").disabled = !future.length;
};
const tellUnder = (place) => {
  if (!annotation || !place) { by("under").textContent = ""; map?.point(null); return; }
  const at = circlecalCamera.toField(answer.camera, ...place);
  const grid = answer.sigma, [w, h] = [annotation.width, annotation.height];
  const px = grid && circlecalCamera.atGrid(grid, grid.px, w, h, ...place), m = grid && circlecalCamera.atGrid(grid, grid.m, w, h, ...place);
  const spread = px === null || px === undefined ? "" : `, sigma ${px.toFixed(1)} px${m === null ? "" : `, ${m.toFixed(2)} m`}`;
  by("under").textContent = `${place[0].toFixed(1)}, ${place[1].toFixed(1)} px` + (at ? `: ${circlecalCamera.tell(at)}${spread}` : answer.camera ? ": above the field" : "");
  map.point(at && Math.abs(at[0]) < field.length && Math.abs(at[1]) < field.width ? at : null);
};
const priors = () => by("priors").replaceChildren(...PRIORS.map(([key, label, usual]) => {
  const input = make("input", { type: "number", step: "any", placeholder: `usual ${usual}`, value: annotation.settings[key] ?? "" });
  input.addEventListener("change", () => change((a) => { if (input.value === "") delete a.settings[key]; else a.settings[key] = Number(input.value); }));
  return make("label", {}, label, input);
}));

// What can be typed, as the annotation has it: whenever that is another one than what was typed.
const fill = () => {
  by("note").value = annotation.note;
  by("flag").value = annotation.flag || "";
  priors();
};

// --- keys

// What was pressed, whatever the layout: capitals as small letters, and letters of other scripts by their place.
const keyOf = ({ key, code }) => {
  if (key.length > 1) return key;
  if (key.codePointAt(0) < 128) return key.toLowerCase();
  const place = /^(?:Key([A-Z])|Digit([0-9]))$/.exec(code || "");
  return place ? (place[1] || place[2]).toLowerCase() : key;
};
const BRACKETS = { "[": -1, ",": -1, "]": 1, ".": 1 };
const AT_ONCE = "axy";  // a key that is held down says them once
const step = (event) => ({ ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] })[event.key];
const onKey = (event) => {
  if (document.querySelector("dialog[open]")) return;
  if (event.target.matches("input:not([type=checkbox]):not([type=file]), select, textarea")) { if (event.key === "Escape") event.target.blur(); return; }
  const key = keyOf(event), along = BRACKETS[key];
  // brackets are typed with Option or AltGr on many keyboards
  const command = (event.ctrlKey || event.metaKey) && !(along && event.altKey);
  if (command && annotation) {
    if (key === "z" && !event.shiftKey) undo(past, future);
    else if (key === "y" || key === "z") undo(future, past);
    else return;
    event.preventDefault();
    return;
  }
  if (command || (event.altKey && !along) || (event.repeat && AT_ONCE.includes(key))) return;
  const go = { n: nextToDo, j: () => list.step(1), k: () => list.step(-1) }[key];
  if (go) { go(); event.preventDefault(); return; }
  if (!annotation) return;
  const onStage = document.activeElement === by("stage") || document.activeElement === document.body;
  const arrow = step(event), marking = annotation.markings[chosen];
  const own = field.markings.find((m) => m.key === key);
  const tick = (id) => { by(id).checked = !by(id).checked; by(id).dispatchEvent(new Event("change")); };
  if (key === " " && onStage) { stage.withSpace = true; }
  else if (arrow && onStage) {
    if (marking?.source === "clicked" || marking?.kind === "point") { const size = event.shiftKey ? 1 : 0.1; nudge(size * arrow[0], size * arrow[1]); }
    else { const size = event.shiftKey ? 1 : 10; stage.moveCross(size * arrow[0], size * arrow[1]); tellUnder(stage.cross); draw(); }
  } else if (key === "Enter" && onStage && stage.cross) guarded(clicked)(stage.cross, { exact: event.shiftKey });
  else if (key === "Escape") { chosen = -1; active = null; draw(); }
  else if (along) { const order = listOrder(), n = order.length, at = order.indexOf(chosen); if (n) chosen = order[(at + (along > 0 ? 1 : at < 0 ? 0 : -1) + n) % n]; active = null; draw(); }
  else if (own) pick(own.name);
  else if (key === "a") accept();
  else if (key === "x" || key === "Delete" || key === "Backspace") { if (marking) { const k = chosen; chosen = -1; named(k, null); } }
  else if (key === "y") guarded(confirm)();
  else if (key === "v") tick("show-template");
  else if (key === "p") tick("show-markings");
  else if (key === "m") tick("show-heat");
  else if (key === "g") tick("show-magnifier");
  else if (key === "s") tick("snap");
  else if (key === "f") stage.fit();
  else if (key === "+" || key === "=") stage.zoomAt(1.25);
  else if (key === "-") stage.zoomAt(0.8);
  else if (key === "?") by("keys").showModal();
  else return;
  event.preventDefault();
};

const nextToDo = () => {
  if (list.step(1, isToDo)) return;
  const first = list.shown.find((k) => k < list.current && isToDo(list.frames[k]));
  if (first !== undefined) list.open(first);
  else by("saved").textContent = list.frames.some(isToDo) ? "no other frame to do in this list" : "no frame is left to do";
};
const setTheme = (name) => {
  if (name) document.documentElement.dataset.theme = name;
  const dark = name ? name === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
  by("theme").setAttribute("aria-pressed", String(dark));
  return dark;
};

// The name of who annotates, which goes into the files: asked for once, beside the picture and in nobody's way.
const askName = () => by("author").classList.toggle("asked", !by("author").value.trim());
const begin = guarded(async () => {
  const told = await net.listing();
  field = told.field;
  map = new FieldMap(by("field"), field, pick);
  list = new FrameList(by("list"), by("rows"), open);
  list.frames = told.frames;
  start = told.start;
  drafts.begin(told.folder, told.start);
  by("folder").textContent = told.folder;
  by("format").replaceChildren(...told.formats.map((name) => make("option", { value: name, textContent: name })));
  by("scale").replaceChildren("sigma at 1920 px width: ", ...circlecalCamera.SCALE.flatMap((limit, k) => {
    const swatch = make("i", {});
    swatch.style.background = `rgb(${circlecalCamera.COLOURS[k].join(" ")})`;
    return [swatch, `${limit} px `];
  }), "good below 5, doubtful above 15");
  setTheme(null);
  const wanted = decodeURIComponent(location.hash.slice(1)), found = list.frames.findIndex((f) => f[0] === wanted);
  listed();
  const unsavedIds = drafts.ids(), drafted = list.frames.findIndex((f) => unsavedIds.includes(f[0]));
  const first = drafted >= 0 ? drafted : list.shown.find((k) => isToDo(list.frames[k])) ?? list.shown[0];
  await open(found < 0 ? first : found);
  document.body.dataset.ready = "yes";
});

document.addEventListener("keydown", onKey);
document.addEventListener("keyup", (event) => { if (event.key === " ") stage.withSpace = false; });
by("undo").addEventListener("click", () => undo(past, future));
by("redo").addEventListener("click", () => undo(future, past));
by("previous").addEventListener("click", () => list.step(-1));
by("next").addEventListener("click", () => list.step(1));
by("next-refused").addEventListener("click", nextToDo);
by("kind").addEventListener("change", listed);
by("search").addEventListener("input", listed);
for (const id of ["show-template", "show-markings", "show-heat"]) by(id).addEventListener("change", draw);
by("show-magnifier").addEventListener("change", () => { stage.magnify = by("show-magnifier").checked; stage.magnifier.hidden ||= !stage.magnify; });
by("fit").addEventListener("click", () => stage.fit());
by("larger").addEventListener("click", () => stage.zoomAt(1.4));
by("smaller").addEventListener("click", () => stage.zoomAt(1 / 1.4));
by("note").addEventListener("change", keepNote);
by("note").addEventListener("input", () => { clearTimeout(typing); typing = setTimeout(keepNote, SETTLE_MS); });
addEventListener("beforeunload", (event) => { if (annotation) takeTyped(); if ((unsaved || saving) && !isLeaving) event.preventDefault(); });
by("flag").addEventListener("change", () => change((a) => { a.flag = by("flag").value || null; }));
by("reset").addEventListener("click", guarded(async () => {
  const at = index, measured = await net.measured(at);
  if (at !== index) return;
  chosen = -1; active = null;
  change((a) => { a.markings = measured; a.flag = null; a.settings = {}; a.confirmed = false; });
  fill();
}));
by("theme").addEventListener("click", () => setTheme(setTheme(null) && document.documentElement.dataset.theme !== "light" ? "light" : document.documentElement.dataset.theme === "light" ? "dark" : "dark"));
by("help").addEventListener("click", () => by("keys").showModal());
by("close-keys").addEventListener("click", () => by("keys").close());
by("close-trouble").addEventListener("click", () => by("trouble").close());
by("trouble").addEventListener("close", () => { by("drop").hidden = true; });
by("show-frames").addEventListener("click", () => by("show-frames").setAttribute("aria-expanded", String(by("frames").classList.toggle("open"))));
by("export").addEventListener("click", guarded(async () => {
  if (!(await isSaved())) return;
  const { name, content, leftOut } = await net.exported(by("format").value), address = URL.createObjectURL(content);
  make("a", { href: address, download: name }).click();
  setTimeout(() => URL.revokeObjectURL(address), 60000);
  if (by("format").value !== "workbench") by("saved").textContent = "exported; its points lie on the middle of the paint, as it says itself: circlecal reads it back as it is";
  tellLines("Exported, but for this", leftOut);
}));
const takeIn = guarded(async (files) => {
  if (!files.length || !(await isSaved())) return;
  const at = index, before = annotation && content(), revision = annotation?.revision, warnings = [];
  let taken = 0, unknown = 0, failure = null;
  for (const file of files) {
    try {
      const told = await net.takeIn(file);
      taken += told.taken; unknown += told.unknown; warnings.push(...told.warnings);
    } catch (error) {
      if (error.isOffline || files.length === 1) { failure = error; break; }
      warnings.push(error.message);
    }
  }
  if (failure) throw failure;
  list.frames = (await net.listing()).frames;
  tellLines("Taken in, but for this", warnings);
  await open(index, `${taken} taken in, ${unknown} unknown`);
  if (before && at === index && annotation?.revision !== revision) { past.push(before); tell(); }
});
by("import").addEventListener("change", async () => {
  const files = [...by("import").files];
  try { await takeIn(files); } finally { by("import").value = ""; }  // so that it can be chosen again
});
document.addEventListener("dragover", (event) => { if (event.dataTransfer?.types.includes("Files")) { event.preventDefault(); document.body.classList.add("dropping"); } });
document.addEventListener("dragleave", (event) => { if (!event.relatedTarget) document.body.classList.remove("dropping"); });
document.addEventListener("drop", (event) => { document.body.classList.remove("dropping"); if (event.dataTransfer?.files.length) { event.preventDefault(); takeIn([...event.dataTransfer.files]); } });
try { by("author").value = localStorage.getItem(AUTHOR) || ""; } catch { /* a browser that keeps nothing */ }
by("author").addEventListener("change", () => { askName(); try { localStorage.setItem(AUTHOR, by("author").value.trim()); } catch { /* as above */ } });
begin();
