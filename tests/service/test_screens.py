"""The screens, in a real browser before a real service with a simulated instrument: a whole session, and what it looks like."""

import os
import re
from collections.abc import Generator
from pathlib import Path
from typing import Any

import httpx
import pytest

from scanhsi.cube.reader import cube_summary
from support.browser import LOW_CONTRAST, SCROLLS, SIZES, SMALL_TARGETS, chromium, page_at
from support.server import serving

SMALL = ("roi.bands=64", "roi.samples=120", "roi.band_offset=500", 'limits.exposure=["10 ms", "30 ms"]')
SCREENS = ("align", "focus", "expose", "references", "plan", "scan", "view", "calibrate", "system")
PICTURES = os.environ.get("SCANHSI_SCREENSHOTS")
"""Folder for pictures of all screens, to be looked at."""


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("data")


@pytest.fixture(scope="module")
def service(data: Path) -> Generator[str]:
    with serving(data, *SMALL) as server:
        with httpx.Client(base_url=f"{server.url}/api/v1") as http:  # homed, so that no scan asks for it first
            lease = {"Scanhsi-Lease": http.post("/lease", json={"name": "home"}).json()["id"]}
            assert http.post("/mirror/home", headers=lease).json()["homed"]
            http.delete("/lease", headers=lease)
        yield server.url


@pytest.fixture(scope="module")
def browser() -> Generator[Any]:
    with chromium() as found:
        yield found


def _take_control(page: Any) -> None:
    page.click("#control")
    page.get_by_label("Your name").fill("Ada")
    page.locator("dialog button[type=submit]").click()
    page.get_by_role("button", name="Release").wait_for()


def _go(page: Any, screen: str) -> None:
    page.click(f"#rail a[href='#{screen}']")


def _picture(page: Any, name: str) -> None:
    if PICTURES:
        page.wait_for_timeout(500)
        page.screenshot(path=Path(PICTURES) / f"{name}.png")


@pytest.mark.parametrize("size", ["touch", pytest.param("desktop", marks=pytest.mark.soak)])
def test_a_whole_session(browser: Any, service: str, data: Path, size: str) -> None:
    with page_at(browser, service, size) as page:
        _take_control(page)
        assert page.locator(".badge").first.inner_text() == "SIMULATED"

        page.get_by_role("button", name="Live view off").click()
        page.get_by_text("120 samples × 64 bands").wait_for()
        page.get_by_role("button", name="Home").click()
        page.get_by_text("0°", exact=True).wait_for()
        page.get_by_role("button", name="jog 10 steps").click()
        page.locator(".stat", has_text="step").get_by_text("10", exact=True).wait_for()
        _picture(page, f"{size}-align")

        _go(page, "focus")
        page.locator(".stat", has_text="of the best").first.get_by_text("%").wait_for()
        _picture(page, f"{size}-focus")

        _go(page, "expose")
        page.get_by_label("exposure").fill("12")
        page.get_by_role("button", name="Apply").click()
        page.locator(".fact", has_text="exposure").get_by_text("12 ms").wait_for()
        _picture(page, f"{size}-expose")

        _go(page, "references")
        page.get_by_role("button", name="Take dark").click()
        page.get_by_text("calibration: dark").wait_for()
        page.get_by_text("Done.").wait_for(timeout=60_000)
        page.get_by_text("Fits the settings of now.").first.wait_for()
        _picture(page, f"{size}-references")

        _go(page, "plan")
        page.get_by_label("height of the field").fill("20")
        page.get_by_role("button", name="Square pixels").click()
        page.locator(".stat", has_text="pixel aspect1.47").wait_for()  # a step a line: as square as this mirror goes
        name = f"session-{size}.zarr"
        page.get_by_label("name of the cube").fill(name)
        _picture(page, f"{size}-plan")
        page.get_by_role("button", name="To the scan").click()

        page.click("#start-scan")
        page.get_by_role("button", name="Finish").wait_for()
        assert not page.evaluate(SCROLLS), "the screen of a scan needs no scrolling"
        _picture(page, f"{size}-scan")
        page.get_by_role("button", name="View", exact=True).click(timeout=60_000)

        page.get_by_text("64 bands ×").wait_for()
        page.get_by_text("100 spectra of pixels drawn at random.").wait_for()
        page.locator(".picture canvas").click(position={"x": 150, "y": 150})
        page.get_by_text(re.compile(r"^Line \d+, sample \d+\.$")).wait_for()
        _picture(page, f"{size}-view")
        with page.expect_download() as download:
            page.get_by_label("download").select_option("envi")
        assert Path(download.value.path()).stat().st_size > 10_000

        summary = cube_summary(data / name)
        assert summary.complete
        assert summary.lines_missing == 0
        _go(page, "align")
        page.get_by_role("button", name="Live view on").click()
        page.get_by_role("button", name="Live view off").wait_for()
        page.get_by_role("button", name="Release").click()
        page.get_by_role("button", name="Take control").wait_for()


@pytest.mark.parametrize("scheme", ["dark", "light"])
@pytest.mark.parametrize("size", SIZES)
def test_every_screen_can_be_read_and_touched(browser: Any, service: str, size: str, scheme: str) -> None:
    with page_at(browser, service, size, scheme) as page:
        for screen in SCREENS:
            _go(page, screen)
            page.wait_for_timeout(250)
            _picture(page, f"{size}-{scheme}-{screen}")
            assert page.evaluate(LOW_CONTRAST) == [], screen
            assert page.evaluate(SMALL_TARGETS) == [], screen
            assert page.locator("#stop").is_visible(), screen
            assert page.locator(".badge").first.is_visible(), screen


LOSE = """() => import('/js/store.js').then(({ state, tell }) => {
  state.info = { ...state.info, lost: { camera: 'camera aravis 192.168.1.20: control of it was lost.' } };
  tell('state', state.info); })"""


def test_what_is_lost_is_seen_and_opened_anew_with_a_finger(browser: Any, service: str) -> None:
    with page_at(browser, service, "touch") as page:
        _take_control(page)
        _go(page, "system")
        again = page.get_by_role("button", name="Open anew")
        assert again.is_hidden(), "all is well"
        page.evaluate(LOSE)
        page.locator("#bar").get_by_text("camera lost").wait_for()
        page.locator(".note.bad").get_by_text("control of it was lost").wait_for()
        assert page.evaluate(LOW_CONTRAST) == page.evaluate(SMALL_TARGETS) == []
        _picture(page, "touch-lost")
        with page.expect_response("**/api/v1/devices/reopen") as answer:
            again.click()
        assert answer.value.json()["lost"] == {}
        again.wait_for(state="hidden")
        page.get_by_role("button", name="Release").click()


def test_stop_needs_no_control_and_ends_a_scan(browser: Any, service: str) -> None:
    with page_at(browser, service, "touch") as page, page_at(browser, service, "desktop") as other:
        _take_control(page)
        _go(page, "scan")
        page.click("#start-scan")
        page.get_by_role("button", name="Abort").wait_for()
        assert other.locator("#control").is_disabled(), "somebody else is in control"
        other.keyboard.press("Escape")
        page.get_by_text("cancelled").wait_for()
        page.get_by_role("button", name="Release").click()


def test_a_browser_that_dies_does_nothing_to_a_scan(browser: Any, service: str, data: Path) -> None:
    with page_at(browser, service, "touch") as page:
        _take_control(page)
        _go(page, "plan")
        page.get_by_label("name of the cube").fill("alone.zarr")
        page.get_by_label("lines", exact=True).fill("120")
        page.wait_for_timeout(400)
        _go(page, "scan")
        page.click("#start-scan")
        page.get_by_role("button", name="Abort").wait_for()
    with page_at(browser, service, "touch") as page:
        _go(page, "scan")
        page.get_by_text(": done").wait_for(timeout=60_000)
    assert cube_summary(data / "alone.zarr").complete
