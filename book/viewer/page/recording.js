// A recording is shown when its button is pressed: only then are the viewer and the recording loaded. One at a time,
// for a viewer takes half a gigabyte of memory.

const NARROWEST = 680; // pixels; the viewer hides its controls in less, so it is drawn smaller instead
let close = () => {};

function fit(frame) {
  const scale = Math.min(1, frame.parentElement.clientWidth / NARROWEST);
  frame.style.width = `${100 / scale}%`;
  frame.style.transform = `scale(${scale})`;
  frame.style.marginBottom = `${(scale - 1) * frame.offsetHeight}px`;
}

document.addEventListener("DOMContentLoaded", () => {
  for (const button of document.querySelectorAll(".recording-bar button")) {
    const stage = document.getElementById(button.getAttribute("aria-controls"));
    const label = button.textContent;
    const watcher = new ResizeObserver(() => stage.hidden || fit(stage.querySelector("iframe")));
    const closeThis = () => {
      watcher.disconnect();
      stage.hidden = true;
      stage.querySelector("iframe").remove();
      button.textContent = label;
      button.setAttribute("aria-expanded", "false");
      close = () => {};
    };
    button.addEventListener("click", () => {
      const open = stage.hidden;
      close();
      if (!open) return;
      const frame = document.createElement("iframe");
      frame.title = button.dataset.title;
      frame.addEventListener("leave", () => button.focus());
      frame.src = button.dataset.viewer;
      stage.prepend(frame);
      stage.hidden = false;
      watcher.observe(stage);
      button.textContent = "Close the recording";
      button.setAttribute("aria-expanded", "true");
      close = closeThis;
    });
  }
});
