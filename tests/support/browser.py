"""Pages in a browser, which must request nothing from another host."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any
from urllib.parse import urlsplit

PATIENCE_MS = 30_000
DESKTOP = {"width": 1280, "height": 800}

Page = Any

# Contrast of an element's colour with its ground, by WCAG 2.
CONTRAST = """(element) => {
  const light = (colour) => {
    const [r, g, b] = colour.match(/[\\d.]+/g).map((part) => {
      const c = part / 255;
      return c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4;
    });
    return 0.2126 * r + 0.7152 * g + 0.0722 * b;
  };
  let at = element;
  const style = getComputedStyle(at);
  while (getComputedStyle(at).backgroundColor === "rgba(0, 0, 0, 0)") at = at.parentElement;
  const two = [light(style.color), light(getComputedStyle(at).backgroundColor)];
  return (Math.max(...two) + 0.05) / (Math.min(...two) + 0.05);
}"""


# Each plot that is seen has a size, and either values or the reason why there are none.
DRAWN = """() => Bokeh.documents[0].roots().every((root) => {
  const at = document.getElementById(`plot-${root.name}`);
  if (!at.offsetParent || root.name === "fingers") return true;
  const values = root.renderers.filter(({ glyph }) => glyph.y)
    .flatMap(({ glyph, data_source }) => [...data_source.data[glyph.y.field]]);
  return Bokeh.index.get_one(root).frame.bbox.width > 50
    && values.some(Number.isFinite) === at.querySelector(".empty").hidden;
})"""


def unfold(page: Page) -> None:
    """Unfold all groups of the live page, and wait until their plots are drawn."""
    page.locator("body[data-ready]").wait_for()
    page.evaluate("document.querySelectorAll('details').forEach((each) => { each.open = true; })")
    page.wait_for_function(DRAWN)


class Visit:
    """Visits of pages, each as another reader; wrong: their errors and foreign requests."""

    def __init__(self, browser: Any) -> None:
        self._browser = browser
        self.wrong: list[str] = []

    @contextmanager
    def __call__(self, url: str, **reader: Any) -> Iterator[Page]:
        context = self._browser.new_context(**({"viewport": DESKTOP} | reader))
        context.set_default_timeout(PATIENCE_MS)
        page = context.new_page()
        page.on("request", self._request)
        page.on("websocket", self._request)
        page.on("console", self._console)
        page.on("pageerror", lambda error: self.wrong.append(f"error: {error}"))
        page.goto(url)
        try:
            yield page
        finally:
            context.close()

    def _request(self, request: Any) -> None:
        url = urlsplit(request.url)
        if url.scheme != "file" and url.hostname != "127.0.0.1":
            self.wrong.append(f"foreign request: {request.url}")

    def _console(self, message: Any) -> None:
        if message.type in ("error", "warning"):
            self.wrong.append(f"{message.type}: {message.text}")
