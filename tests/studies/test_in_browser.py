"""The reports in a real browser: what is seen, heard, printed and reached by keys."""

import json
import re

import matplotlib.image
import pytest

from jaxtrack.studies import run
from jaxtrack.studies.design import read_design
from jaxtrack.studies.report import papers
from jaxtrack.studies.report import study as study_report
from tests.studies import browser
from tests.studies.own_study import COMPARE, FILE, written
from tests.studies.test_papers_report import reproduced

pytestmark = pytest.mark.skipif(
    browser.found() is None, reason=f"there is no browser here (none of {', '.join(browser.NAMES)})"
)
WIDTHS = (1280, 700, 390, 320)
PAPER = 717  # CSS pixels between the margins of A4

# What text stands on what ground, as pixels: the least contrast on the page, and where.
CONTRAST = """
(() => {
  const pen = document.createElement("canvas").getContext("2d", { willReadFrequently: true });
  const pixel = (...colours) => {
    for (const colour of colours) { pen.fillStyle = colour; pen.fillRect(0, 0, 1, 1); }
    return [...pen.getImageData(0, 0, 1, 1).data].slice(0, 3);
  };
  const light = (rgb) => rgb.map((c) => c / 255)
    .map((c) => (c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4))
    .reduce((sum, c, n) => sum + c * [0.2126, 0.7152, 0.0722][n], 0);
  let least = [99, ""], seen = 0;
  const walk = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (walk.nextNode()) {
    const part = walk.currentNode.parentElement;
    if (!walk.currentNode.data.trim() || part.closest("script, noscript, option")) continue;
    if (part.closest(".skip, .unseen") || !part.checkVisibility()) continue;
    const under = [];
    for (let p = part; p; p = p.parentElement) under.unshift(getComputedStyle(p).backgroundColor);
    const style = getComputedStyle(part);
    const ink = part.tagName === "text" ? style.fill : style.color;
    const pair = [light(pixel("#fff", ...under)), light(pixel("#fff", ...under, ink))];
    const contrast = (Math.max(...pair) + 0.05) / (Math.min(...pair) + 0.05);
    seen += 1;
    if (contrast < least[0]) least = [contrast, part.outerHTML.slice(0, 200)];
  }
  return [...least, seen];
})()
"""
SPILLS = """
[...document.querySelectorAll("body *")].filter((part) => {
  const box = part.getBoundingClientRect();
  return box.width && box.right > innerWidth + 1 && !part.closest(".scroll, pre, .skip");
}).map((part) => part.outerHTML.slice(0, 120))
"""
CUT = """
[...document.querySelectorAll("table, pre, svg, img")].filter((part) =>
  part.getBoundingClientRect().right > document.documentElement.clientWidth + 1
  || part.tagName === "PRE" && part.scrollWidth > part.clientWidth + 1
).map((part) => part.id || part.outerHTML.slice(0, 90))
"""
HIDDEN = """
[...document.querySelectorAll("details > :not(summary)")]
  .filter((part) => !part.checkVisibility({ contentVisibilityAuto: true })).length
"""
REACHABLE = """
[...document.querySelectorAll("a, select, input, summary, .scroll, pre")]
  .filter((part) => part.closest("main") && part.checkVisibility()).length
"""
MAP = "document.getElementById('atlas-map').innerText"


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Return the pages: of a study with three axes, and of the papers' studies."""
    home = tmp_path_factory.mktemp("pages")
    run.run_study(read_design(written(home, FILE + COMPARE)), home / "out")
    study_report.write_report(run.status_of(home / "out"), home / "out")
    reproduced(home / "results")
    results = home / "results" / papers.FILE
    return {"study": home / "out" / study_report.FILE, "results": results}


@pytest.fixture(scope="module")
def tab(tmp_path_factory):
    with browser.opened(tmp_path_factory.mktemp("profile") / "chromium") as page:
        yield page


@pytest.fixture(params=["study", "results"])
def each(tab, files, request):
    """Return the tab with one page after the other."""
    tab.look()
    tab.open(files[request.param])
    return tab


@pytest.fixture
def study(tab, files):
    tab.look()
    tab.open(files["study"])
    return tab


def test_a_page_asks_for_nothing_and_complains_of_nothing(each, files):
    asked = {address for address in each.requested if not address.startswith("data:")}
    assert asked <= {file.resolve().as_uri() for file in files.values()}
    assert each.complaints == []


@pytest.mark.parametrize("width", WIDTHS)
def test_nothing_is_wider_than_the_window(each, width):
    each.look(width=width)
    assert each.run("document.documentElement.scrollWidth") <= width
    assert each.run(SPILLS) == []


@pytest.mark.parametrize("dark", [False, True])
def test_text_stands_out_in_light_and_dark(each, dark, tmp_path):
    each.look(dark=dark)
    least, where, seen = each.run(CONTRAST)
    assert seen > 60
    assert least >= 4.5, where
    each.picture(tmp_path / "seen.png")
    pixels = matplotlib.image.imread(tmp_path / "seen.png")[..., :3]
    assert (pixels.mean() < 0.35) if dark else (pixels.mean() > 0.8)
    assert pixels.std() > 0.03  # there is something on it


def test_the_slider_moves_the_map_by_key_and_says_so(study):
    before = study.run(MAP)
    assert "shrunk.kind = mean" in before
    study.run("document.querySelector('input[type=range]').focus()")
    study.press("ArrowRight", 39)
    after = study.run(MAP)
    assert "shrunk.kind = median" in after
    numbers = lambda text: re.findall(r"\S+ ± \S+", text)
    data = json.loads(study.run("document.getElementById('atlas-data').textContent"))["maps"][0]
    assert numbers(before) == [data["text"][n] for n in (0, 2, 4, 6, 8, 10)]
    assert numbers(after) == [data["text"][n] for n in (1, 3, 5, 7, 9, 11)]
    assert study.run("document.activeElement.getAttribute('aria-valuetext')") == "median"
    assert "median" in study.run("document.getElementById('atlas-said').textContent")
    study.press("ArrowLeft", 37)
    assert study.run(MAP) == before


def choose(tab, name, value):
    """Choose as a user does; the choice keeps the focus, though the controls are made anew."""
    select = f"document.getElementById('atlas-controls').elements[{name!r}]"
    tab.run(f"{select}.value = {value!r}, {select}.dispatchEvent(new Event('change'))")
    assert tab.run("document.activeElement.name") == name
    return tab.run(MAP)


def test_axes_metric_and_method_are_chosen(study):
    text = choose(study, "Down", "shrunk.factor")  # the other axis takes its place
    assert text.startswith("error_m, shrunk: shrunk.factor down, sigma_m across")
    text = choose(study, "Across", "shrunk.kind")
    assert text.startswith("error_m, shrunk: shrunk.factor down, shrunk.kind across; sigma_m = 1.0")
    text = choose(study, "Metric", "beyond")
    assert text.startswith("beyond, shrunk:")
    text = choose(study, "Method", "shrunk − mean")
    assert text.startswith("beyond, shrunk − mean: shrunk.factor down, shrunk.kind across")
    data = json.loads(study.run("document.getElementById('atlas-data').textContent"))["maps"]
    one = next(m for m in data if (m["metric"], m["what"]) == ("beyond", "shrunk − mean"))
    assert re.findall(r"\S+ ± \S+", text) == one["text"][:6]
    colours = study.run(
        "[...document.querySelectorAll('#atlas-map td:not(:first-child), #atlas-map tbody td')]"
        ".filter((c) => c.closest('tbody')).map((c) => getComputedStyle(c).backgroundColor)"
    )
    assert len(set(colours)) > 2
    assert study.run(CONTRAST)[0] >= 4.5


def test_without_javascript_the_first_map_stands(tab, files):
    tab.look()
    tab.call("Emulation.setScriptExecutionDisabled", value=True)
    try:
        tab.open(files["study"])
        text = tab.run("document.getElementById('atlas').innerText")
    finally:
        tab.call("Emulation.setScriptExecutionDisabled", value=False)
    assert "Without JavaScript only the first map is shown." in text
    assert len(re.findall(r"\S+ ± \S+", text)) == 6


def test_keys_reach_everything_and_show_where_they_are(each):
    each.press("Tab", 9)
    assert each.run("document.activeElement.className") == "skip"
    assert each.run("document.activeElement.getBoundingClientRect().left") >= 0
    each.press("Enter", 13)
    assert each.run("document.activeElement.id + location.hash") == "main#main"
    wanted = each.run(REACHABLE)
    reached = 0
    for _ in range(wanted):
        each.press("Tab", 9)
        style = "getComputedStyle(document.activeElement)"
        if each.run("document.activeElement.closest('main') !== null"):
            reached += 1
            assert each.run(f"{style}.outlineStyle + {style}.outlineWidth") == "solid3px"
    assert reached == wanted


def test_whatever_is_used_or_looked_at_has_a_name(each):
    each.call("Accessibility.enable")
    nodes = each.call("Accessibility.getFullAXTree")["nodes"]
    told = [
        (n["role"]["value"], n.get("name", {}).get("value", "")) for n in nodes if not n["ignored"]
    ]
    needed = {"image", "slider", "combobox", "table", "region", "link", "heading"}
    assert {"image", "table", "link", "heading", "main", "navigation"} <= {role for role, _ in told}
    assert [role for role, name in told if role in needed and not name.strip()] == []
    each.call("Accessibility.disable")


def test_paper_cuts_nothing_and_keeps_the_map_that_was_chosen(each, files):
    slider = each.run("document.querySelector('input[type=range]') !== null")
    if slider:
        each.run("document.querySelector('input[type=range]').focus()")
        each.press("ArrowRight", 39)
    each.look(width=PAPER, media="print")
    assert each.run(CUT) == []
    assert each.run(HIDDEN) == 0  # what is folded on the screen
    assert each.run("getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"
    if slider:
        assert "shrunk.kind = median" in each.run(MAP)
        assert each.run("document.getElementById('atlas-controls').checkVisibility()") is False
    printed = each.pdf()
    assert printed.startswith(b"%PDF-")
    assert len(re.findall(rb"/Type\s*/Page\b", printed)) >= 2
    if slider:
        assert "shrunk.kind = median" in each.run(MAP)


def test_a_link_to_a_mark_opens_what_it_is_in(tab, files):
    tab.look()
    tab.open(files["results"])
    folded = "document.querySelector('details')"
    assert tab.run(f"{folded}.open") is False
    tab.run("location.hash = 'marks-pass-0'")
    assert tab.run(f"new Promise((done) => setTimeout(() => done({folded}.open), 50))") is True
    tab.run("document.querySelector('#marks-fails a').click()")
    place = tab.run("location.hash.slice(1)")
    row = tab.run(f"document.getElementById({place!r}).innerText")
    assert "HT, situation I" in row
    assert "fails" in row
