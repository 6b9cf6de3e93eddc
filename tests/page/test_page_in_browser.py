"""The page as a reader has it: Debian's chromium opens the file and does what a reader does."""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from conftest import HOSTILE

sync_api = pytest.importorskip("playwright.sync_api")
expect = sync_api.expect
expect.set_options(timeout=60_000)

QUIET = (
    *("--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-sync"),
    *("--disable-background-networking", "--disable-component-update"),
)
BROWSERS = ("chromium", "chromium-browser", "google-chrome")

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """Skipped where there is no chromium, but never silently where CI runs."""
    path = next(filter(None, map(shutil.which, BROWSERS)), None)
    if path is None:
        message = "no chromium: scripts/setup.sh dev installs Debian's"
        if os.environ.get("CI") == "true":
            pytest.fail(message)
        pytest.skip(message)
    with sync_api.sync_playwright() as playwright:
        opened = playwright.chromium.launch(executable_path=path, args=list(QUIET))
        yield opened
        opened.close()


@pytest.fixture(scope="module")
def file(html: str, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("opened") / "report.html"
    path.write_text(html, encoding="utf-8")
    return path


class Visit:
    """A page that is open, and all that went wrong in it, or was asked of a network."""

    def __init__(self, browser: Any, file: Path, **options: Any) -> None:
        context = browser.new_context(**{"viewport": {"width": 1400, "height": 900}} | options)
        context.set_default_timeout(60_000)
        self.context, self.page = context, context.new_page()
        self.faults: list[str] = []
        self.requests: list[str] = []
        self.page.on("console", lambda m: self.faults.append(m.text) if m.type == "error" else None)
        self.page.on("pageerror", lambda error: self.faults.append(str(error)))
        self.page.on("dialog", lambda dialog: self.faults.append(f"dialog {dialog.message}"))
        self.page.on("request", lambda request: self.requests.append(request.url))
        self.page.goto(file.as_uri())
        expect(self.page.locator("#why")).not_to_be_empty(timeout=30_000)


@pytest.fixture
def visit(browser: Any, file: Path) -> Iterator[Visit]:
    one = Visit(browser, file)
    yield one
    one.context.close()
    assert one.faults == []
    assert one.requests == [file.as_uri()]


@pytest.fixture
def page(visit: Visit) -> Any:
    return visit.page


def column(page: Any, name: str) -> list[str]:
    """The cells of a column, from the top."""
    heads = page.locator("#table thead th").all_inner_texts()
    at = 1 + next(i for i, head in enumerate(heads) if head.strip().startswith(name))
    texts = page.locator(f"#table tbody td:nth-child({at})").all_inner_texts()
    return [text.strip() for text in texts]


def number(text: str) -> float:
    return float(re.sub("\N{MINUS SIGN}", "-", text.split("\n")[0].split(" ")[0]))


def chips(page: Any) -> list[str]:
    return [text.strip() for text in page.locator("#chips .chip").all_inner_texts()]


def test_a_column_is_sorted_up_and_down_and_failed_rows_stay_last(page: Any) -> None:
    head = page.get_by_role("button", name="ms per scan")
    for order in (False, True):
        head.click()
        times = column(page, "ms per scan")
        assert times.pop() == ""  # the failed run's
        assert [number(t) for t in times] == sorted(map(number, times), reverse=order)
    page.locator("#table thead th").first.get_by_role("button").click()
    errors = [number(text) for text in column(page, "final translation error")[:-1]]
    assert errors[0] == min(errors)  # the ranking, the best first


FILTERS = {"plicp": 5, "plicp -previous": 4, "window<5 plicp": 2, "failed": 1, "coverage>2": 0}
"""What is typed, and the rows that are left of 11."""


def test_the_filter_keeps_what_it_says(page: Any) -> None:
    for words, kept in FILTERS.items():
        page.locator("#filter").fill(words)
        expect(page.locator("#table tbody tr")).to_have_count(kept)
        expect(page.locator("#rows-shown")).to_have_text(f"{kept} of 11 rows")


def test_rows_are_picked_in_the_table_and_in_the_plot(page: Any) -> None:
    before = chips(page)
    row = page.locator("#table tbody tr:not(.picked)").first
    index = row.get_attribute("data-row")
    box = page.locator(f'#table [data-row="{index}"]').get_by_role("checkbox")
    box.focus()
    page.keyboard.press("Space")
    expect(box).to_be_checked()
    expect(box).to_be_focused()
    assert len(chips(page)) == len(before) + 1
    point = page.locator(f'#scatter [data-row="{index}"]')
    assert point.get_attribute("aria-pressed") == "true"
    point.focus()
    page.keyboard.press("Enter")
    assert chips(page) == before
    page.locator("#chips .chip").first.click()
    assert len(chips(page)) == len(before) - 1


def test_the_slider_goes_through_the_scans(page: Any) -> None:
    slider, why = page.locator("#slider"), page.locator("#why")
    slider.focus()
    page.keyboard.press("Home")
    expect(why).to_have_text("Scan 0 is the start: its pose is the origin.")
    page.keyboard.press("ArrowRight")
    expect(why).to_contain_text("Scan 1 ")
    page.keyboard.press("End")
    expect(why).to_contain_text("Scan 23 ")
    expect(page.locator("#scan-number")).to_have_value("23")
    page.locator("#scan-body h3").first.click()
    page.locator("#chain-text button").first.focus()
    page.keyboard.press("ArrowLeft")  # a key anywhere in the section
    expect(why).to_contain_text("Scan 22 ")


def test_a_refusal_says_which_and_why(page: Any) -> None:
    for option in page.locator("#focus option").all():
        page.locator("#focus").select_option(option.get_attribute("value"))
        found = page.locator("#jump-to option").first
        expect(found).to_contain_text("(")
        if "(0)" not in (found.text_content() or ""):
            break
    page.locator("#jump").click()
    expect(page.locator("#why .bad")).to_have_text(re.compile(r"Refused: \d+: .* from the guess"))
    refused = page.locator("#candidates tr", has_text="refused")
    expect(refused.first).to_contain_text("from the guess")


def test_a_cell_of_the_sweep_opens_its_run(page: Any) -> None:
    cell = page.locator("#heat button").nth(2)
    row = cell.get_attribute("data-row")
    name = cell.get_attribute("title")
    cell.click()
    assert len(chips(page)) == 1
    expect(page.locator("#table tr.picked")).to_have_attribute("data-row", row)
    expect(page.locator("#provenance h3")).to_have_text(name)
    expect(page.locator("#provenance code")).to_contain_text("rbtm-bench run ")


def test_a_scan_hovered_in_one_is_marked_in_all(page: Any) -> None:
    """The charts and the plane are drawn again with the mark where the other has its pointer."""
    canvases = [page.locator("#plane"), *page.locator("#curves canvas").all()]
    canvases[1].scroll_into_view_if_needed()
    before = [canvas.screenshot() for canvas in canvases]
    box = canvases[1].bounding_box()
    page.mouse.move(box["x"] + 0.9 * box["width"], box["y"] + 0.5 * box["height"])
    expect(page.locator("#tip")).to_contain_text(re.compile(r"scan \d+"))
    page.evaluate("document.getElementById('tip').style.visibility = 'hidden'")
    after = [canvas.screenshot() for canvas in canvases]
    assert all(a != b for a, b in zip(before, after, strict=True))
    page.mouse.down()
    page.mouse.up()
    scan = page.locator("#tip").text_content().split("\n")[0].removeprefix("scan ").split("A")[0]
    expect(page.locator("#scan-number")).to_have_value(scan)


def test_markup_in_a_name_is_text(page: Any) -> None:
    page.locator("#filter").fill("failed")
    row = page.locator("#table tbody tr")
    expect(row).to_contain_text(HOSTILE)
    row.locator("td").nth(2).click()
    expect(page.locator("#provenance")).to_contain_text(HOSTILE)
    assert page.locator("body script").count() == 2
    assert page.evaluate("[...document.images].length") == 0


def test_light_and_dark_follow_the_reader(browser: Any, file: Path, page: Any) -> None:
    html = page.locator("html")
    expect(html).to_have_attribute("data-theme", "light")
    page.locator("#theme").click()
    expect(html).to_have_attribute("data-theme", "dark")
    dark = Visit(browser, file, color_scheme="dark")
    expect(dark.page.locator("html")).to_have_attribute("data-theme", "dark")
    dark.context.close()


def test_a_telephone_needs_no_scrolling_sideways(browser: Any, file: Path) -> None:
    small = Visit(browser, file, viewport={"width": 400, "height": 800})
    assert small.page.evaluate("document.documentElement.scrollWidth") <= 400
    small.context.close()
    assert small.faults == []
