// Light, dark, or as the system is: chosen before anything is drawn, changed by the button "theme".
"use strict";
const canest = {};

canest.theme = (() => {
  const order = ["automatic", "dark", "light"];
  const root = document.documentElement;
  const listeners = [];
  const system = matchMedia("(prefers-color-scheme: dark)");
  const print = matchMedia("print");
  let printing = false;
  const changed = () => listeners.forEach((listener) => listener());
  const read = () => {
    try { return localStorage.getItem("canest-theme"); } catch { return null; } // storage may be forbidden
  };
  root.dataset.theme = order.includes(read()) ? read() : "automatic";
  system.addEventListener("change", changed);
  const toPaper = (now) => {
    if (now === printing) return;
    printing = now;
    document.querySelectorAll("details").forEach((details) => { details.open = now; });
    changed();
  };
  print.addEventListener("change", () => toPaper(print.matches));
  addEventListener("beforeprint", () => toPaper(true));
  addEventListener("afterprint", () => toPaper(false));

  const isDark = () => !printing
    && (root.dataset.theme === "dark" || (root.dataset.theme === "automatic" && system.matches));
  let palette = {};
  const hex = (part) => Number(part).toString(16).padStart(2, "0");
  /** A colour of the page's palette as this theme has it: "#rrggbb" or "rgba(r,g,b,a)". */
  const tint = (colour) => {
    if (!isDark() || typeof colour !== "string") return colour;
    const parts = colour.match(/^rgba\((\d+),(\d+),(\d+),([\d.]+)\)$/);
    if (!parts) return palette[colour] ?? colour;
    const dark = palette["#" + parts.slice(1, 4).map(hex).join("")];
    if (!dark) return colour;
    const [r, g, b] = [1, 3, 5].map((at) => parseInt(dark.slice(at, at + 2), 16));
    return `rgba(${r},${g},${b},${Math.min(1, 1.3 * parts[4])})`;
  };
  const start = () => {
    palette = JSON.parse(document.getElementById("palette").textContent);
    const button = document.getElementById("theme");
    const label = () => { button.textContent = `Theme: ${root.dataset.theme}`; };
    button.addEventListener("click", () => {
      root.dataset.theme = order[(order.indexOf(root.dataset.theme) + 1) % order.length];
      try { localStorage.setItem("canest-theme", root.dataset.theme); } catch { /* not kept, then */ }
      label();
      changed();
    });
    label();
  };
  return { start, tint, isDark, isPrinting: () => printing, onChange: (listener) => listeners.push(listener) };
})();
