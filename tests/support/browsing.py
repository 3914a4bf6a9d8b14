"""A real browser, and what it finds wrong with a page."""

import colorsys
import io
import os
import shutil
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from types import MappingProxyType

from axe_playwright_python.sync_playwright import Axe
from PIL import Image
from playwright.sync_api import Browser, Page, ViewportSize, sync_playwright

from tests.support.patience import HANG_S

NOTHING: Mapping[str, str] = MappingProxyType({})
FOLD_PX = 4  # a pixel or two of rounding
HIGHEST_PX = 9000  # of a telephone's page; a name that is broken letter by letter made 13,000


@contextmanager
def chromium() -> Iterator[Browser]:
    """Run a Chromium for as long as the block lasts."""
    program = shutil.which("chromium")
    if program is None:
        raise RuntimeError("chromium is missing: `make setup-system` installs it")
    arguments = ["--no-sandbox"] if os.geteuid() == 0 else []
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=arguments)
        yield browser
        browser.close()


def new_page(
    browser: Browser, width: int = 1280, *, has_axe: bool = False, headers: Mapping[str, str] = NOTHING
) -> Page:
    """Return an empty page that waits as long as only a hang lasts; axe is a script that no policy of ours lets in."""
    viewport: ViewportSize = {"width": width, "height": 900}
    context = browser.new_context(viewport=viewport, bypass_csp=has_axe, extra_http_headers=dict(headers))
    context.set_default_timeout(1000.0 * HANG_S)
    return context.new_page()


def complaints_of(page: Page, url: str, scheme: str, *, has_picture: bool = True) -> list[str]:
    """Return what is wrong with a page: what axe finds, what it loads from elsewhere, errors, what sticks out."""
    asked: list[str] = []
    said: list[str] = []
    page.on("request", lambda request: asked.append(request.url))
    page.on("console", lambda message: said.append(message.text))
    page.on("pageerror", lambda error: said.append(str(error)))
    page.emulate_media(color_scheme="dark" if scheme == "dark" else "light")
    page.goto(url)
    overhang = page.evaluate("document.documentElement.scrollWidth - document.documentElement.clientWidth")
    if overhang > FOLD_PX:
        said.append(f"{overhang} px stick out")
    own = url if url.startswith("file:") else "/".join(url.split("/")[:3])
    said += [one for one in asked if not one.startswith(own)]
    if has_picture and not page.locator("svg[role=img]").count():
        said.append("no picture")
    found = Axe().run(page).response["violations"]
    return said + [f"{one['id']}: {one['nodes'][0]['html']}" for one in found]


_CUT = """least => {
  const said = [], width = document.documentElement.clientWidth;
  for (const one of document.querySelectorAll("main *, header *, footer *")) {
    const box = one.getBoundingClientRect();
    if (!box.width || !box.height || one.closest("svg, .skip, [hidden], .cards thead")) continue;
    const text = one.textContent.slice(0, 60);
    if (box.right > width + 1 || box.left < -1)
      said.push(`${one.tagName} ends at ${box.right} of ${width} px: ${text}`);
    if (one.scrollWidth > one.clientWidth + 4 && getComputedStyle(one).overflowX !== "visible")
      said.push(`${one.tagName} hides ${one.scrollWidth - one.clientWidth} px: ${one.getAttribute("aria-label")}`);
  }
  for (const plot of document.querySelectorAll("svg.plot")) {
    const frame = plot.getBoundingClientRect();
    const axis = plot.querySelector(".axis").getBoundingClientRect();
    const name = plot.querySelector(".side").getBoundingClientRect();
    for (const tick of plot.querySelectorAll(".tick")) {
      const box = tick.getBoundingClientRect();
      if (box.right > axis.left + 1 || box.left < name.right - 1)
        said.push(`the number of an axis touches a curve or its name: ${tick.textContent}`);
    }
    for (const text of plot.querySelectorAll("text")) {
      if (getComputedStyle(text).display === "none") {
        const keys = plot.closest("figure").querySelectorAll(".key");
        if (![...keys].some(key => key.classList.contains([...text.classList].pop())))
          said.push(`neither in its picture nor among its keys: ${text.textContent}`);
        continue;
      }
      const size = parseFloat(getComputedStyle(text).fontSize) * plot.getScreenCTM().a;
      const box = text.getBoundingClientRect();
      if (size < least) said.push(`${size.toFixed(1)} px is too small to read: ${text.textContent}`);
      if (box.left < frame.left - 1 || box.right > frame.right + 1 || box.bottom > frame.bottom + 1)
        said.push(`sticks out of its picture: ${text.textContent}`);
    }
  }
  return said;
}"""
READABLE_PX = 10.0  # of the letters in a picture


def cut_in(page: Page) -> list[str]:
    """Return what of a page that is open cannot be seen: cut off, hidden behind a scroll bar, too small to read."""
    found: list[str] = page.evaluate(_CUT, READABLE_PX)
    return found


def height_of(page: Page) -> int:
    """Return the height of a page that is open, in pixels."""
    return int(page.evaluate("document.documentElement.scrollHeight"))


_ICON = """async () => {
  const link = document.querySelector("link[rel=icon]");
  if (!link) return ["no icon is named"];
  const image = new Image();
  image.src = link.href;
  return image.decode().then(() => [], () => [`the icon cannot be shown: ${link.href}`]);
}"""


def refused_in(browser: Browser, url: str, headers: Mapping[str, str] = NOTHING) -> list[str]:
    """Return what the browser refuses or complains of on a page, its icon asked for as well, its policy in force."""
    page = new_page(browser, headers=headers)
    said: list[str] = []
    page.on("console", lambda message: said.append(message.text))
    page.on("pageerror", lambda error: said.append(str(error)))
    page.goto(url)
    said += page.evaluate(_ICON)
    page.context.close()
    return said


@dataclass(frozen=True, slots=True, kw_only=True)
class Words:
    """Words that can be read on a screenshot: what they are, where they stand, of which colour they are."""

    text: str
    left: float
    top: float
    right: float
    bottom: float
    colour: str  # red, yellow, green, blue; or grey


_WORDS = """() => {
  const said = [], add = (text, box) => {
    if (text.trim() && box.width && box.height && box.bottom <= innerHeight && box.right <= innerWidth + 1)
      said.push([text.trim().replace(/\\s+/g, " "), box.left, box.top, box.right, box.bottom]);
  };
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT), range = document.createRange();
  while (walker.nextNode()) {
    const parent = walker.currentNode.parentElement;
    if (!parent.checkVisibility({visibilityProperty: true}) || parent.closest(".skip, script, svg")) continue;
    range.selectNodeContents(walker.currentNode);
    const box = range.getBoundingClientRect();
    const there = document.elementFromPoint((box.left + box.right) / 2, (box.top + box.bottom) / 2);
    if (there && (there.contains(parent) || parent.contains(there))) add(walker.currentNode.textContent, box);
  }
  for (const cell of document.querySelectorAll("[data-name]")) {  // the heads of cells where a row is a card
    const {left, top} = cell.getBoundingClientRect(), text = cell.dataset.name;
    if (getComputedStyle(cell, "::before").content.startsWith('"'))
      add(text, new DOMRect(left, top, 5 * text.length, 14));
  }
  return said;
}"""
_HUES = ((20, "red"), (70, "yellow"), (170, "green"), (265, "blue"), (340, "grey"), (361, "red"))  # ends in degrees
_COLOURED, _DISTINCT = 0.3, 8  # chroma of a pixel that has a colour; so many of them are no edges of letters


def words_seen(page: Page) -> list[Words]:
    """Return what of a page can be read on its first screenshot."""
    seen: list[list[float | str]] = page.evaluate(_WORDS)
    picture = Image.open(io.BytesIO(page.screenshot())).convert("RGB")
    words = []
    for text, *edges in seen:
        box = [float(edge) for edge in edges]
        left, top, right, bottom = (max(round(edge), 0) for edge in box)
        colours = Counter[str]()
        crop = picture.crop((left, top, max(right, left + 1), max(bottom, top + 1)))
        for count, pixel in crop.getcolors(crop.width * crop.height) or ():
            hue, saturation, value = colorsys.rgb_to_hsv(*(part / 255.0 for part in pixel))  # type: ignore[union-attr]  # RGB
            if saturation * value > _COLOURED:
                colours[next(name for end, name in _HUES if 360.0 * hue < end)] += count
        colour, count = colours.most_common(1)[0] if colours else ("grey", 0)
        kept = colour if count >= _DISTINCT else "grey"
        words.append(
            Words(text=str(text), **dict(zip(("left", "top", "right", "bottom"), box, strict=True)), colour=kept)
        )
    return words
