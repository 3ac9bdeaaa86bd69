/* The player of widgets asks for its labels' mathematics as MathJax 2 was asked, and the book has MathJax 3. */
document.addEventListener("DOMContentLoaded", () => {
  if (window.MathJax?.startup) {
    const typeset = (element) => MathJax.startup.promise.then(() => MathJax.typesetPromise([element]));
    MathJax.Hub = { Queue: ([, , element]) => typeset(element) };
  }
});
