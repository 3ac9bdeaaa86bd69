// Shows the recording named in this page's address, viewer.html?recording=FILE, with the viewer of the installed
// rerun-notebook. Its widget.js is served as it is: it renders for any model that answers as Jupyter's would.

const FROM_WASM = "re_viewer_bg.wasm";
const stage = document.getElementById("stage");
const wanted = new URLSearchParams(location.search);
const recording = new URL(wanted.get("recording") ?? "", location.href);

// The viewer asks its makers' host for news, and for a binary that lies here packed. This book asks no other host.
const fetchFile = window.fetch.bind(window);
window.fetch = async (request, options) => {
  const url = new URL(request.url ?? request, location.href);
  if (url.protocol.startsWith("http") && url.origin !== location.origin) {
    return new Response(null, { status: 404 });
  }
  if (!url.pathname.endsWith(FROM_WASM)) {
    return fetchFile(request, options);
  }
  const packed = await fetchFile(new URL("re_viewer.bin", location.href));
  if (!packed.ok) {
    return packed;
  }
  return new Response(packed.body.pipeThrough(new DecompressionStream("gzip")), {
    headers: { "Content-Type": "application/wasm" },
  });
};
console.debug = () => {};

// The canvas swallows the keyboard; Escape gives it back to the page around it.
window.addEventListener("keydown", (event) => {
  if (event.key === "Escape") window.frameElement?.dispatchEvent(new Event("leave"));
}, true);

function say(text) {
  const paragraph = document.createElement("p");
  paragraph.setAttribute("role", "alert");
  paragraph.textContent = text;
  stage.replaceChildren(paragraph);
}

if (!wanted.get("recording") || recording.origin !== location.origin) {
  say("No recording to show: this page opens recordings of this book only, as viewer.html?recording=FILE.");
} else if (location.protocol === "file:") {
  say("A browser opens recordings only from a server: serve the book with “make book”, or open the file with “rerun”.");
} else {
  const { default: widget } = await import("./widget.js");
  const traits = { _url: recording.href, _width: "auto", _height: "auto", _theme: "dark" };
  widget.render({ model: { get: (name) => traits[name], on() {}, send() {} }, el: stage });
}
