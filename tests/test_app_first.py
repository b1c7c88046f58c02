"""What the page shows first: texts and an image of the scene, before the chart library has been loaded."""

import base64
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest

from app_browser import (
    WAIT_MS,
    open_page,
    plot,
    serve,
    show_tab,
    stop,
    wait_for_text,
    wait_until_drawn,
)

LIBRARY = "**/trame-plotly.umd.js"


def _scene(colours):
    """A framed scene of two arrows, as the app draws them."""
    from workbench.app.figures import style

    made = style.framed(style.space("view"), (-10, -10, -10), (10, 10, 10))
    x = [0.0, 5.0, np.nan, 0.0, 0.0, np.nan]
    line = dict(color=colours, colorscale=style.LENGTHS, cmin=0, cmax=1.0, width=3)
    made.add_scatter3d(x=x, y=[0.0] * 6, z=x[::-1], mode="lines", line=line)
    return made.update_layout(title_text="<b>2 arrows")


def _paths(address: str) -> list:
    kind, _, text = address.partition(",")
    assert kind == "data:image/svg+xml;base64"
    root = ElementTree.fromstring(base64.b64decode(text))
    return root.findall("{http://www.w3.org/2000/svg}path")


def test_an_image_of_a_scene_shows_its_box_and_every_class_of_colours():
    from workbench.app.figures.still import static_image

    paths = _paths(static_image(_scene([0.0, 0.0, 0.0, 1.0, 1.0, 1.0])))
    assert len(paths) == 12 + 2
    assert [path.get("stroke") for path in paths[12:]] == ["#7dafd8", "#902117"]


def test_an_image_of_needles_shows_a_shaft_in_the_colour_of_each_length():
    from workbench.app.figures import style
    from workbench.app.figures.arrows import Needles, add_needles
    from workbench.app.figures.still import static_image

    made = style.framed(style.space("view"), [-10.0] * 3, [10.0] * 3)
    points, vectors = np.zeros((3, 2)), np.array([[5.0, 0.0, 0.0], [0.0, 5.0, 0.0]]).T
    needles = Needles(points, vectors, np.arange(2), np.arange(2), np.array([0.0, 1.0]))
    add_needles(made, needles, 30.0, cmax=1.0)
    paths = _paths(static_image(made))[12:]
    assert [path.get("stroke") for path in paths] == ["#7dafd8", "#902117"]


def test_an_image_of_a_scene_keeps_its_centre_and_its_up():
    from workbench.app.figures.still import _View

    view = _View(_scene("#000000").layout.scene)
    centre, up = view.project(np.array([[0.0, 0.0], [0.0, 0.0], [0.0, 5.0]])).T
    assert abs(centre[0]) < 1e-9 and up[1] < centre[1] - 10


def test_a_template_of_the_app_keeps_figures_light():
    from workbench.app.figures import style

    assert len(style.plane("x", "y", "view").to_json()) < 1000


@pytest.fixture(scope="module")
def served(arm_run, tmp_path_factory):
    made = serve(arm_run, tmp_path_factory.mktemp("session"))
    yield made
    stop(made)


@pytest.fixture
def page(browser, served):
    """A page whose chart library is held back until `page.held` is continued."""
    page = browser.new_page(viewport={"width": 1400, "height": 900})
    page.set_default_timeout(WAIT_MS)
    page.held = []
    page.route(LIBRARY, lambda route: page.held.append(route))
    page.goto(served.address)
    yield page
    page.close()


@pytest.mark.slow
@pytest.mark.parametrize("opening", ["first", "again"])
def test_texts_and_an_image_of_the_residuals_need_no_chart_library(page, opening):
    wait_for_text(page, "selection", "0 of 300 samples selected")
    image = page.locator("[data-still=arrows]")
    image.wait_for(timeout=60_000)
    page.wait_for_function(
        "(one) => one.complete && one.naturalWidth > 0", arg=image.element_handle()
    )
    assert page.locator(".js-plotly-plot").count() == 0
    page.wait_for_function("() => !window.Plotly && document.querySelector('[data-still=arrows]')")
    while not page.held:  # it is asked for once the page is on the screen
        page.evaluate("() => new Promise((painted) => requestAnimationFrame(painted))")
    page.held[0].continue_()
    plot(page, "arrows")


@pytest.mark.slow
def test_a_tab_that_was_left_is_there_again_and_a_new_one_says_that_it_draws(browser, served):
    page = open_page(browser, served, "Residuals")
    wait_until_drawn(page)
    page.evaluate(_KEEP)
    page.evaluate(_HAS_WAITED)
    for tab in ("Recording", "Residuals", "Edit and rerun", "Diagnosis", "Recording", "Residuals"):
        show_tab(page, tab)
        wait_until_drawn(page)
        assert page.locator("[data-tab]:visible").count() == 1
    assert page.evaluate(_IS_KEPT) and page.evaluate("() => window.hasWaited")
    page.close()


_KEEP = """() => {
    window.kept = Array.from(document.querySelectorAll('[data-tab=residuals] .js-plotly-plot'));
    window.data = window.kept.map((one) => one.data);
}"""
_IS_KEPT = """() => window.kept.length === 3
    && window.kept.every((one, k) => one.isConnected && one.data === window.data[k] && one.querySelector('.main-svg'))"""


_HAS_WAITED = """() => {
    const look = () => { if (document.querySelector('[data-tab=recording] [aria-label=Drawing]')) window.hasWaited = true; };
    new MutationObserver(look).observe(document.body, {childList: true, subtree: true});
}"""
