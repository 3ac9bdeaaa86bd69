/* The player of widgets asks for its labels' mathematics as MathJax 2 was asked, and the book has MathJax 3. */
document.addEventListener("DOMContentLoaded", () => {
  if (window.MathJax?.startup) {
    const typeset = (element) => MathJax.startup.promise.then(() => MathJax.typesetPromise([element]));
    MathJax.Hub = { Queue: ([, , element]) => typeset(element) };
  }
});

/* A slider is called as the text before it, and its value is the text behind it, not the number of the frame. */
function nameSlider(widget) {
  const handle = widget.querySelector(".noUi-handle");
  const readout = widget.querySelector(".widget-readout");
  if (!handle || !readout || handle.dataset.named) return;
  handle.dataset.named = "yes";
  const name = widget.querySelector(".widget-label")?.textContent.trim() || "frame";
  handle.setAttribute("aria-label", name);
  readout.setAttribute("aria-label", `${name}, value`);
  readout.setAttribute("role", "textbox");
  const tell = () => {
    const value = readout.textContent.trim();
    if (value && handle.getAttribute("aria-valuetext") !== value) handle.setAttribute("aria-valuetext", value);
  };
  new MutationObserver(tell).observe(handle, { attributes: true, attributeFilter: ["aria-valuetext"] });
  new MutationObserver(tell).observe(readout, { childList: true, characterData: true, subtree: true });
  tell();
}

/* What is wider than its place can be reached and scrolled by key, and shows that it goes on. */
const WIDE = "pre, table, mjx-container[display='true'], .cell_output, .cell_output > *, .widget-subarea";
function reachWide() {
  for (const element of document.querySelectorAll(WIDE.split(", ").map((part) => `.bd-article ${part}`).join())) {
    const scrolls = element.scrollWidth > element.clientWidth + 1
      && ["auto", "scroll"].includes(getComputedStyle(element).overflowX);
    if (scrolls === element.hasAttribute("data-scrolls")) continue;
    element.toggleAttribute("data-scrolls", scrolls);
    if (scrolls) element.setAttribute("tabindex", "0");
    else element.removeAttribute("tabindex");
  }
}

/* The theme's buttons have names that differ from what is seen on them, and a fold of its contents has none. */
function nameTheme() {
  const modes = { light: "Light", dark: "Dark", auto: "System Settings" };
  for (const button of document.querySelectorAll(".theme-switch-button")) {
    button.setAttribute("aria-label", `Color mode: ${modes[document.documentElement.dataset.mode] ?? modes.auto}`);
  }
  for (const button of document.querySelectorAll(".search-button-field")) button.removeAttribute("aria-label");
  for (const summary of document.querySelectorAll(".bd-links summary")) {
    summary.setAttribute("aria-label", `Pages of ${summary.closest("li").querySelector("a").textContent.trim()}`);
  }
}

document.addEventListener("DOMContentLoaded", () => {
  const look = () => {
    document.querySelectorAll(".widget-slider").forEach(nameSlider);
    reachWide();
  };
  let waiting = false;
  const soon = () => {
    if (waiting) return;
    waiting = true;
    setTimeout(() => { waiting = false; look(); }, 200);
  };
  nameTheme();
  new MutationObserver(nameTheme).observe(document.documentElement, { attributeFilter: ["data-mode"] });
  new MutationObserver(soon).observe(document.querySelector("main") ?? document.body, { childList: true, subtree: true });
  document.addEventListener("toggle", soon, true); // what a fold hid may be wide
  addEventListener("resize", soon);
  addEventListener("load", soon);
  soon();
});
