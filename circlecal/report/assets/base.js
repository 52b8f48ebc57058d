"use strict";
// What every part of the page uses: elements, numbers, times, files to save, and the theme.
globalThis.circlecalPage = (() => {
  const element = (id) => document.getElementById(id);
  const make = (name, properties = {}, ...children) => {
    const made = Object.assign(document.createElement(name), properties);
    made.append(...children);
    return made;
  };
  const short = (value) => {
    if (value === null) return "-";
    const size = Math.abs(value);
    return String(Number(value.toFixed(size >= 100 ? 0 : size >= 10 ? 1 : size >= 1 ? 2 : 3)));
  };
  const clock = (seconds) => {
    const hundredths = Math.round(seconds * 100), whole = Math.floor(hundredths / 100);
    const two = (n) => String(n).padStart(2, "0");
    const hours = Math.floor(whole / 3600), minutes = Math.floor(whole / 60) % 60;
    const text = hours ? `${hours}:${two(minutes)}:${two(whole % 60)}` : `${minutes}:${two(whole % 60)}`;
    return hundredths % 100 ? `${text}.${two(hundredths % 100)}`.replace(/0$/, "") : text;
  };
  // One word of a command line, as a POSIX shell reads it.
  const quote = (word) => (/^[\w@%+=:,./-]+$/.test(word) ? word : `'${word.replaceAll("'", "'\\''")}'`);
  const saveFile = (name, content, type) => {
    const address = URL.createObjectURL(new Blob([content], { type }));
    make("a", { href: address, download: name }).click();
    setTimeout(() => URL.revokeObjectURL(address), 1000);
  };
  const picture = (source, alt, lazy) => {
    const made = make("img", { alt, draggable: false });
    if (lazy) Object.assign(made, { loading: "lazy", decoding: "async" });  // others are there when the page is printed
    made.addEventListener("error", () => made.replaceWith(nothing("picture missing")), { once: true });
    made.src = source;
    return made;
  };
  const nothing = (text) => make("span", { className: "none", textContent: text });

  const root = document.documentElement;
  root.classList.add("scripted");
  const stored = (() => { try { return localStorage.getItem("circlecal-theme"); } catch { return null; } })();
  const dark = window.matchMedia("(prefers-color-scheme: dark)");
  const setTheme = (name) => {
    root.dataset.theme = name;
    element("theme")?.setAttribute("aria-pressed", String(name === "dark"));
  };
  setTheme(stored || (dark.matches ? "dark" : "light"));
  dark.addEventListener("change", (event) => { if (!stored) setTheme(event.matches ? "dark" : "light"); });
  document.addEventListener("DOMContentLoaded", () => {
    setTheme(root.dataset.theme);
    element("theme").addEventListener("click", () => {
      const name = root.dataset.theme === "dark" ? "light" : "dark";
      setTheme(name);
      try { localStorage.setItem("circlecal-theme", name); } catch { /* private window */ }
    });
  });
  return { element, make, short, clock, quote, saveFile, picture, nothing };
})();
