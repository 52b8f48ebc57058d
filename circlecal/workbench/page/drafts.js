// Changes that are not saved yet, kept by the browser: a server that ends, or a window, loses none of them.
const FRESH_MS = 5000;  // a draft that is younger may be another window's, which is just saving it
let prefix = null, start = null;

const guarded = (act) => { try { return act(); } catch { return null; } };  // storage that is full or forbidden keeps nothing
const key = (id) => `${prefix}${id}`;

/** Which folder's drafts these are, and which start of the server it is. */
export const begin = (folder, started) => { prefix = `circlecal draft ${folder} `; start = started; };
export const keep = (id, base, content) => guarded(() => localStorage.setItem(key(id), JSON.stringify({ base, content, start, at: Date.now() })));
export const drop = (id) => guarded(() => localStorage.removeItem(key(id)));
/** What was not saved of a frame; null where there is nothing. */
export const find = (id) => guarded(() => {
  const draft = JSON.parse(localStorage.getItem(key(id)));
  return draft && (draft.start !== start || Date.now() - draft.at > FRESH_MS) ? draft : null;
});
/** Ids of the frames of which something was not saved. */
export const ids = () => guarded(() => Object.keys(localStorage).filter((name) => name.startsWith(prefix)).map((name) => name.slice(prefix.length)).filter(find)) || [];
