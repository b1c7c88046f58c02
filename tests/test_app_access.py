"""Keyboard and contrast of every tab of the app, on runs of an arm, of a scanner and of a diagnosis."""

import pytest

from app_browser import TABS, click_row, open_page, plot, serve, show_tab, stop
from app_diagnosis import write_diagnosis

pytestmark = pytest.mark.slow

CONTROLS = """() => Array.from(document.querySelectorAll(
        'button, input, a, [role=tab], [role=slider], [tabindex="0"]'))
    .filter((one) => one.offsetParent && !one.disabled && one.getAttribute('aria-hidden') !== 'true'
        && getComputedStyle(one).visibility !== 'hidden')
    .map((one, k) => { one.dataset.control = k; return String(k); })"""
# Of a group of tabs the chosen one takes the focus; arrow keys move it to the others.
GROUPED = """() => Array.from(document.querySelectorAll('[role=tab]'))
    .map((one) => one.dataset.control)"""
NAMES = """(keys) => keys.map((k) =>
    document.querySelector(`[data-control='${k}']`).outerHTML.slice(0, 200))"""
CONTRAST = """() => {
    const channel = (v) => (v / 255 <= 0.04045 ? v / 255 / 12.92 : ((v / 255 + 0.055) / 1.055) ** 2.4);
    const luminance = (c) => 0.2126 * channel(c[0]) + 0.7152 * channel(c[1]) + 0.0722 * channel(c[2]);
    const parse = (text) => {
        const n = (text.match(/[\\d.]+/g) || [0, 0, 0, 0]).map(Number);
        return n.length < 4 ? [...n, 1] : n;
    };
    const over = (top, under) => [0, 1, 2].map((k) => top[k] * top[3] + under[k] * (1 - top[3]));
    const parents = (element) => {
        const found = [];
        for (let e = element; e; e = e.parentElement) found.push(e);
        return found;
    };
    const ground = (element) => parents(element)
        .map((e) => parse(getComputedStyle(e).backgroundColor)).reverse()
        .reduce((under, top) => over(top, under), [255, 255, 255]);
    const opacity = (element) => parents(element)
        .reduce((so_far, e) => so_far * getComputedStyle(e).opacity, 1);
    const skipped = '[disabled], .v-btn--disabled, .js-plotly-plot, style, script';
    const found = [];
    const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
    for (let node = walker.nextNode(); node; node = walker.nextNode()) {
        const element = node.parentElement, text = node.textContent.trim();
        if (!text || !element.offsetParent || element.closest(skipped)) continue;
        const style = getComputedStyle(element), seen = opacity(element);
        if (style.visibility === 'hidden' || style.display === 'none' || seen < 0.05) continue;
        const colour = parse(style.color), back = ground(element);
        const ink = over([colour[0], colour[1], colour[2], colour[3] * seen], back);
        const [a, b] = [luminance(ink), luminance(back)].sort((x, y) => y - x);
        const ratio = (a + 0.05) / (b + 0.05);
        if (ratio < 4.5) found.push(`${text.slice(0, 40)}: ${ratio.toFixed(2)}`);
    }
    return found;
}"""


@pytest.fixture(scope="module", params=["arm", "scanner", "diagnosis"])
def page(request, browser, tmp_path_factory):
    """A page of each kind of run with a selected sample, so that no control is disabled for want of one."""
    folder = tmp_path_factory.mktemp(request.param)
    run = (
        write_diagnosis(folder / "run")
        if request.param == "diagnosis"
        else request.getfixturevalue(f"{request.param}_run")
    )
    made = serve(run, folder / "session")
    page = open_page(browser, made, "Residuals")
    if request.param != "diagnosis":  # it does not hold the positions of its residuals
        click_row(page, 1, 30 if request.param == "scanner" else 300)
    yield page
    page.close()
    stop(made)


def missed_controls(page) -> list[str]:
    """Controls of the page that the tabulator key does not reach."""
    wanted = page.evaluate(CONTROLS)
    page.evaluate("() => { document.activeElement.blur(); document.body.focus(); }")
    reached = set()
    for _ in range(4 * len(wanted) + 20):
        page.keyboard.press("Tab")
        reached.add(page.evaluate("() => document.activeElement.dataset.control"))
        if reached >= set(wanted):
            break
    tabs = set(page.evaluate(GROUPED))
    assert reached & tabs, "the tabulator key reaches no tab"
    return page.evaluate(NAMES, sorted(set(wanted) - reached - tabs))


@pytest.mark.parametrize("tab", TABS)
def test_every_control_is_reached_by_the_tabulator_key(page, tab):
    show_tab(page, tab)
    page.wait_for_timeout(1500)
    assert missed_controls(page) == []


def test_the_arrow_keys_open_every_tab(page):
    show_tab(page, TABS[0])
    page.get_by_role("tab", name=TABS[0], exact=True).focus()
    for tab in TABS[1:]:
        page.keyboard.press("ArrowRight")
        page.keyboard.press("Enter")
        page.locator(f"[data-tab={tab.partition(' ')[0].lower()}]").wait_for()


@pytest.mark.parametrize("tab", TABS)
def test_text_has_a_contrast_of_at_least_4_5(page, tab):
    show_tab(page, tab)
    page.wait_for_timeout(800)
    assert page.evaluate(CONTRAST) == []


def test_text_in_figures_has_a_contrast_of_at_least_4_5(page):
    show_tab(page, "Residuals")
    colours = plot(page, "chart").evaluate(
        "(one) => Array.from(one.querySelectorAll('text')).map((text) => getComputedStyle(text).fill)"
    )
    assert colours and set(colours) <= {"rgb(27, 31, 36)"}


@pytest.mark.parametrize("tab", TABS)
def test_nothing_is_cut_off_in_a_window_of_800_px(page, tab):
    page.set_viewport_size({"width": 800, "height": 900})
    show_tab(page, tab)
    page.wait_for_timeout(800)
    widest = page.evaluate("() => document.documentElement.scrollWidth")
    last = page.get_by_role("tab", name=TABS[-1], exact=True).bounding_box()
    page.set_viewport_size({"width": 1400, "height": 900})
    assert widest <= 800 and last["x"] + last["width"] <= 800
