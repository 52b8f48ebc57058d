const OFFLINE = "The server does not answer. Start circlecal annotate again as before: this page then goes on by itself. Your last change is kept in this browser.";
// What the server is asked; every failure becomes an Error with one clear line.
const fetched = async (address, options = {}) => {
  let answer;
  try {
    answer = await fetch(address, { cache: "no-store", ...options });
  } catch {
    throw Object.assign(new Error(OFFLINE), { isOffline: true });
  }
  if (answer.ok) return answer;
  const content = answer.headers.get("content-type")?.includes("json") ? await answer.json() : null;
  const failure = new Error(content?.error || `the server answered ${answer.status}`);
  failure.status = answer.status;
  failure.isOffline = answer.status === 404;  // served, and not at this address any more
  failure.current = content?.current;
  throw failure;
};
const ask = async (address, options) => (await fetched(address, options)).json();
const send = (address, method, body) => ask(address, { method, body: JSON.stringify(body), headers: { "Content-Type": "application/json" } });

export const listing = () => ask("frames.json");
export const show = (index) => ask(`frames/${index}.json`);
export const save = (index, base, annotation) => send(`frames/${index}.json`, "PUT", { base, annotation });
export const mark = (index, mode, points, name) => send(`frames/${index}/mark`, "POST", { mode, points, name });
export const interpretations = (index) => ask(`frames/${index}/interpretations`);
export const measured = (index) => ask(`frames/${index}/measured`);
/** Name and content of a file with all annotations, and what could not be put into it, a line each. */
export const exported = async (format) => {
  const answer = await fetched(`export/${format}`), told = (name) => answer.headers.get(name);
  return { name: told("content-disposition").match(/filename="(.*)"/)[1], content: await answer.blob(), leftOut: JSON.parse(told("circlecal-left-out")) };
};
export const takeIn = (file) => ask(`import?name=${encodeURIComponent(file.name)}`, { method: "POST", body: file });
