// The chosen theme, before anything is drawn; the button in live.js changes it.
"use strict";
try {
  document.documentElement.dataset.theme = localStorage.getItem("canest-theme") || "automatic";
} catch {
  document.documentElement.dataset.theme = "automatic"; // storage may be forbidden
}
