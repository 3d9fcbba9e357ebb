"""A real browser: headless Chromium, through Playwright."""

import os
import shutil
import tempfile
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

SIZES = {"touch": (800, 480), "desktop": (1440, 900)}


@contextmanager
def chromium() -> Generator[Any]:
    """A browser; skips, and fails in CI, where there is none."""
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        _missing("playwright")
    program = next(filter(None, map(shutil.which, ("chromium-headless-shell", "chromium", "google-chrome"))), None)
    with sync_playwright() as playwright:
        if program is None and not Path(playwright.chromium.executable_path).exists():
            _missing("a Chromium")
        browser = playwright.chromium.launch(executable_path=program)
        try:
            yield browser
        finally:
            browser.close()


def _missing(what: str) -> None:
    text = f"{what} is missing: `make test` brings it"
    if os.environ.get("CI"):
        pytest.fail(text)
    pytest.skip(text)


@contextmanager
def page_at(browser: Any, url: str, size: str, scheme: str = "dark") -> Generator[Any]:
    """A page of some size; fails when anything is said in its console that is not good, and keeps a picture of what fails."""
    width, height = SIZES[size]
    context = browser.new_context(
        viewport={"width": width, "height": height}, color_scheme=scheme, accept_downloads=True
    )
    page = context.new_page()
    wrong: list[str] = []
    page.on("console", lambda message: wrong.append(message.text) if message.type in ("error", "warning") else None)
    page.on("pageerror", lambda error: wrong.append(str(error)))
    try:
        page.goto(url)
        try:
            yield page
        except BaseException:
            page.screenshot(path=f"{tempfile.gettempdir()}/scanhsi-screen.png")
            raise
        assert not wrong, wrong
    finally:
        context.close()


SMALL_TARGETS = """() => [...document.querySelectorAll('button, a, select, input')]
  .filter(one => one.offsetParent && !one.closest('dialog') && getComputedStyle(one).visibility !== 'hidden')
  .map(one => [one.getBoundingClientRect(), one])
  .filter(([box]) => box.height < 40 || box.width < 40)
  .map(([box, one]) => `${one.tagName} ${one.textContent.trim().slice(0, 30)} ${box.width.toFixed()} x ${box.height.toFixed()}`)"""
"""What a finger may miss: smaller than 40 CSS pixels in one direction."""

LOW_CONTRAST = """() => {
  const rgb = text => text.match(/[\\d.]+/g).map(Number);
  const light = ([r, g, b]) => [r, g, b].map(v => (v /= 255) <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4)
    .reduce((sum, v, i) => sum + v * [0.2126, 0.7152, 0.0722][i], 0);
  const behind = one => { for (; one; one = one.parentElement) { const c = rgb(getComputedStyle(one).backgroundColor);
    if (c.length < 4 || c[3] > 0.6) return c; } return [255, 255, 255]; };
  const found = [];
  for (const one of document.querySelectorAll('body *')) {
    const own = [...one.childNodes].some(node => node.nodeType === 3 && node.textContent.trim());
    if (!own || !one.offsetParent || one.disabled || one.closest('.picture')) continue;
    const [a, b] = [light(rgb(getComputedStyle(one).color)), light(behind(one))].sort((x, y) => y - x);
    const ratio = (a + 0.05) / (b + 0.05);
    if (ratio < 4.5) found.push(`${one.tagName} ${one.textContent.trim().slice(0, 30)} ${ratio.toFixed(2)}`);
  }
  return found; }"""
"""Text whose contrast to what is behind it is below 4.5 (WCAG AA)."""

SCROLLS = """() => {
  const page = document.scrollingElement;
  const over = (one, by) => one.scrollHeight > one.clientHeight + by || one.scrollWidth > one.clientWidth + by;
  return over(page, 1) || [...document.querySelectorAll('#screen *')].some(one =>
    ['auto', 'scroll'].includes(getComputedStyle(one).overflowY) && one.scrollHeight > one.clientHeight + 2);
}"""
"""Whether anything on the screen has to be scrolled."""
