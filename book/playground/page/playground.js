// On every page: opens the playground that a figure announces, when its button is pressed or, if it says so, at once.

async function open(figure) {
  const button = figure.querySelector("button");
  const stage = figure.querySelector(".playground-stage");
  button.disabled = true;
  button.textContent = "Loading …";
  const base = new URL(figure.dataset.base, location.href).href;
  const now = "now" in figure.dataset;
  const query = now && location.search ? location.search : figure.dataset.query;
  try {
    const { mount } = await import(`${base}playground.js`);
    const mounted = mount(stage, { base, query, run: !now, folded: !now });
    figure.classList.add("playground-open");
    stage.hidden = false;
    const playground = await mounted;
    if (!now) playground.runButton.focus({ preventScroll: true });
  } catch (error) {
    const served = location.protocol !== "file:";
    button.textContent = served ? "The playground did not load; try again" : "The playground needs a server: make book";
    button.disabled = false;
    console.warn(error);
  }
}

document.addEventListener("DOMContentLoaded", () => {
  for (const figure of document.querySelectorAll(".playground")) {
    const button = figure.querySelector("button");
    button.hidden = false;
    button.addEventListener("click", () => open(figure));
    if ("now" in figure.dataset) open(figure);
  }
});
