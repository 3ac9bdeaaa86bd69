"""Prints the built book into one PDF: ``python pdf.py _build/html _build/book.pdf``.

Each page is opened in a headless Chromium and waited for. Films, recordings and widgets become stills, folded code is
left out, long folded tables are only named, solutions move to the end of their chapter, and what is wider than the
paper is made smaller. Then all pages are one page, with the styles of ``_static/book.css`` for paper, and that one is
printed.
"""

import argparse
import shutil
import sys
import threading
from pathlib import Path

import yaml
from playwright.sync_api import Page, sync_playwright
from serve import make_server

BOOK = Path(__file__).resolve().parents[1]
PAPER = 660  # CSS pixels between the margins of A4
MARGINS = dict(top="18mm", bottom="20mm", left="18mm", right="17mm")
LONG = 12  # rows; a folded table with more stays folded, with its title alone
FOOT = '<div style="font-size: 8px; width: 100%; text-align: center"><span class="pageNumber"></span></div>'

# What a page becomes on paper. Its names get the page's own prefix, since all pages become one.
PREPARE = """async ([prefix, root, LONG]) => {
  const article = document.querySelector("article.bd-article");
  article.querySelectorAll(".recording-bar, .recording-stage, script, .headerlink, .prev-next-area, .copybtn")
    .forEach(part => part.remove());
  for (const video of article.querySelectorAll("video")) {
    const still = new Image(video.width, video.height);
    [still.src, still.alt] = [video.poster, video.getAttribute("aria-label")];
    video.replaceWith(still);
  }
  for (const frame of article.querySelectorAll("iframe")) frame.remove();
  article.querySelectorAll(".widget-subarea .widget-hbox:has(.widget-slider)").forEach(controls => {
    const label = controls.querySelector(".widget-label")?.textContent;
    const value = controls.querySelector(".widget-readout");
    const told = document.createElement("p");
    told.className = "paper-only";
    told.textContent = `${label} ${value?.textContent ?? ""} (in the book on a screen, a slider changes it)`;
    controls.replaceWith(told);
  });
  const solutions = document.createElement("section");
  for (const fold of article.querySelectorAll(".tag_exercise details")) solutions.append(fold);
  if (solutions.childElementCount) {
    solutions.insertAdjacentHTML("afterbegin", "<h2>Solutions</h2>");
    article.append(solutions);
  }
  for (const fold of article.querySelectorAll("details")) {
    if (fold.classList.contains("hide") && !solutions.contains(fold)) fold.remove();  // code of figures
    else fold.open = fold.querySelectorAll("tr").length <= LONG;
  }
  for (const image of article.querySelectorAll("img")) {
    image.loading = "eager";
    image.src = image.src;  // the whole address
  }
  await Promise.all([...article.querySelectorAll("img")].map(image => image.decode().catch(() => null)));
  for (const element of article.querySelectorAll("[id]")) element.id = prefix + element.id;
  for (const element of article.querySelectorAll("[for], [aria-labelledby], [aria-controls], [name]"))
    for (const name of ["for", "aria-labelledby", "aria-controls", "name"]) element.removeAttribute(name);
  for (const link of article.querySelectorAll("a[href]")) {
    const url = new URL(link.href);
    if (url.origin !== location.origin) continue;
    const page = url.pathname.slice(root.length).replace(/\\.html$/, "").replaceAll("/", "-");
    if (/\\.html$/.test(url.pathname)) link.setAttribute("href", "#" + page + "--" + url.hash.slice(1));
    else link.removeAttribute("href");  // a download; there is none on paper
  }
  const styles = [...document.querySelectorAll("style")].map(style =>
    [...style.sheet.cssRules].map(rule => rule.cssText).join("\\n"));
  return [`<article class="bd-article paper" id="${prefix}">${article.innerHTML}</article>`, styles];
}"""

# What is wider than its place becomes as small as it must; what still leaves the paper is returned. A formula may leave
# its place on either side, so its letters are measured.
FIT = """() => {
  const span = element => {
    const letters = element.matches("mjx-container") ? [...element.querySelectorAll("mjx-c, mjx-mtext")] : [];
    const boxes = (letters.length ? letters : [element]).map(part => part.getBoundingClientRect());
    return [Math.min(...boxes.map(box => box.left)), Math.max(...boxes.map(box => box.right))];
  };
  const kinds = "mjx-container[display='true'], table, .widget-subarea, .cell_output > *";
  for (const element of document.querySelectorAll(kinds)) {
    const place = element.parentElement.getBoundingClientRect(), [left, right] = span(element);
    const over = Math.max(0, place.left - left, right - place.right);
    const natural = Math.max(element.scrollWidth, over > 1 ? place.width + 2 * over : 0);
    if (natural > place.width + 1) element.style.zoom = place.width / natural * 0.98;
  }
  const paper = document.body.getBoundingClientRect();
  return [...document.querySelectorAll("mjx-container, table, pre, img")].filter(element => {
    const [left, right] = span(element);
    return left < paper.left - 1 || right > paper.right + 1;
  }).map(element => `${element.closest("article").id} ${element.tagName} ${element.textContent.slice(0, 80)}`);
}"""


def find_pages(contents: dict) -> list[str]:
    """The pages in the order of the table of contents.

    Example:
        >>> find_pages({"root": "index", "parts": [{"chapters": [{"file": "a", "sections": [{"file": "b"}]}]}]})
        ['index.html', 'a.html', 'b.html']
    """
    found = [contents["root"]] if "root" in contents else []
    for part in [*contents.get("parts", []), *contents.get("chapters", []), *contents.get("sections", [])]:
        found += ([part["file"]] if "file" in part else []) + [
            page.removesuffix(".html") for page in find_pages({k: v for k, v in part.items() if k != "root"})
        ]
    return [f"{page}.html" for page in found]


def find_chromium() -> str | None:
    """A Chromium that is installed; None for the one that playwright brings."""
    return next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome", "chrome"))), None)


def gather(page: Page, address: str, names: list[str]) -> str:
    """All pages as one HTML page."""
    articles, styles, sheets = [], [], []
    for name in names:
        page.goto(f"{address}/{name}")  # waits until everything is loaded
        page.evaluate("window.MathJax?.startup?.promise")
        for view in page.locator("script[type='application/vnd.jupyter.widget-view+json']").all():
            view.locator("xpath=preceding-sibling::*[contains(@class, 'widget-subarea')]/*").wait_for()
        prefix = f"{name.removesuffix('.html').replace('/', '-')}--"
        sheets += page.eval_on_selector_all("link[rel=stylesheet]", "all => all.map(link => link.href)")
        article, found = page.evaluate(PREPARE, [prefix, "/", LONG])
        articles.append(article)
        styles += found
    links = "".join(f'<link rel="stylesheet" href="{sheet}">' for sheet in dict.fromkeys(sheets))
    inline = "".join(f"<style>{style}</style>" for style in dict.fromkeys(styles))
    head = f'<meta charset="utf-8"><title>Detect and Denoise</title>{links}{inline}'
    body = "".join(articles)
    return (
        f'<!DOCTYPE html><html lang="en" data-theme="light"><head>{head}</head><body class="paper">{body}</body></html>'
    )


def print_book(folder: Path, target: Path, names: list[str] | None = None) -> None:
    """Print these pages, or all, of the built book in ``folder`` to ``target``.

    Raises:
        RuntimeError: if something is still cut off at the edge of the paper.
    """
    names = names or find_pages(yaml.safe_load((BOOK / "_toc.yml").read_text("utf-8")))
    with make_server(folder) as server, sync_playwright() as playwright:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        browser = playwright.chromium.launch(executable_path=find_chromium())
        page = browser.new_page(viewport=dict(width=PAPER, height=1000), color_scheme="light")
        page.set_default_timeout(120_000)
        address = f"http://127.0.0.1:{server.server_port}"
        whole = gather(page, address, names)
        page.route(f"{address}/_whole.html", lambda route: route.fulfill(body=whole, content_type="text/html"))
        page.emulate_media(media="print", color_scheme="light")
        page.goto(f"{address}/_whole.html")
        page.evaluate("document.fonts.ready.then(() => true)")
        if cut := page.evaluate(FIT):
            raise RuntimeError("these are cut off at the edge of the paper:\n" + "\n".join(cut))
        target.parent.mkdir(parents=True, exist_ok=True)
        partial = target.with_suffix(".part")
        page.pdf(
            path=partial, format="A4", margin=MARGINS, print_background=True, outline=True, tagged=True,
            display_header_footer=True, header_template="<span></span>", footer_template=FOOT,
        )  # fmt: skip
        partial.replace(target)
        browser.close()
        server.shutdown()


def main() -> None:
    """Called by ``make pdf``."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("folder", type=Path, help="the built book")
    parser.add_argument("target", type=Path, help="the PDF")
    parser.add_argument("pages", nargs="*", help="such as chapters/01-mdp.html; all by default")
    arguments = parser.parse_args()
    try:
        print_book(arguments.folder, arguments.target, arguments.pages)
    except (RuntimeError, ValueError) as error:
        sys.exit(f"error: {error}")
    print(f"written: {arguments.target} ({arguments.target.stat().st_size / 1e6:.0f} MB)")


if __name__ == "__main__":
    main()
