"""What a person sees of the page itself: the view of figures, report pages of runs, and the end of the server."""

import math

import pytest

from app_browser import (
    open_page,
    opened_app,
    plot,
    serve,
    show_tab,
    stop,
    wait_for_text,
    wait_until_drawn,
)
from workbench.app.figures import style
from workbench.app.ui.view import LEFT, RESET, RIGHT, ZOOM_IN, ZOOM_OUT, View, moved_camera
from workbench.core.errors import InputError

CAMERA = {
    "eye": {"x": 1.0, "y": 0.0, "z": 1.5},
    "center": {"x": 0.0, "y": 0.0, "z": 0.5},
    "up": {"x": 0, "y": 0, "z": 1},
}


def _distance(camera) -> float:
    return math.dist(camera["eye"].values(), camera["center"].values())


def test_zooming_changes_the_distance_alone_and_stays_within_limits():
    nearer = moved_camera(CAMERA, ZOOM_IN)
    assert nearer["center"] == CAMERA["center"]
    assert _distance(nearer) == pytest.approx(_distance(CAMERA) / 1.25)
    assert _distance(moved_camera(nearer, ZOOM_OUT)) == pytest.approx(_distance(CAMERA))
    far, near = CAMERA, CAMERA
    for _ in range(50):
        far, near = moved_camera(far, ZOOM_OUT), moved_camera(near, ZOOM_IN)
    assert _distance(far) == pytest.approx(8) and _distance(near) == pytest.approx(0.2)


def test_rotating_keeps_height_and_distance():
    rotated = moved_camera(CAMERA, RIGHT)
    assert rotated["eye"]["z"] == CAMERA["eye"]["z"] and rotated["eye"]["y"] > 0
    assert _distance(rotated) == pytest.approx(_distance(CAMERA))
    back = moved_camera(rotated, LEFT)
    assert back["eye"] == pytest.approx(CAMERA["eye"])


@pytest.mark.parametrize(
    "camera",
    [
        None,
        [],
        {"eye": {"x": 1, "y": 2, "z": "3"}, "center": CAMERA["center"]},
        {**CAMERA, "eye": {"x": 1, "y": 2, "z": float("nan")}},
    ],
)
def test_a_camera_that_is_none_is_refused(camera):
    with pytest.raises(InputError, match="expected a camera"):
        moved_camera(camera, ZOOM_IN)


def test_a_reset_has_the_browser_forget_the_view():
    view, made = View(), style.space("view")
    plain = view.applied(made).to_plotly_json()["layout"]
    assert plain["uirevision"] == "view"
    view.change(ZOOM_IN, CAMERA)
    zoomed = view.applied(made).to_plotly_json()["layout"]
    assert zoomed["scene"]["camera"]["eye"]["x"] == pytest.approx(0.8)
    view.change(RESET, None)
    again = view.applied(made).to_plotly_json()["layout"]
    assert again["scene"]["camera"] == plain["scene"]["camera"]
    assert len({one["uirevision"] for one in (plain, zoomed, again)}) == 3
    with pytest.raises(InputError, match="expected one of"):
        view.change("jump", CAMERA)


@pytest.fixture(scope="module")
def page(browser, arm_run, tmp_path_factory):
    with opened_app(browser, arm_run, tmp_path_factory.mktemp("session")) as page:
        yield page


def _camera(page) -> dict:
    return plot(page, "arrows").evaluate("(one) => one._fullLayout.scene._scene.getCamera()")


def _wait_for_distance(page, is_nearer: bool, than: float) -> float:
    """Distance of the camera once it is nearer or farther than before."""
    plot(page, "arrows").evaluate(
        """async (one, [nearer, than]) => {
            const distance = () => {
                const {eye, center} = one._fullLayout.scene._scene.getCamera();
                return Math.hypot(eye.x - center.x, eye.y - center.y, eye.z - center.z);
            };
            for (let k = 0; k < 400 && (nearer ? distance() >= than : distance() <= than); k++)
                await new Promise((later) => setTimeout(later, 50));
        }""",
        [is_nearer, than],
    )
    return _distance(_camera(page))


@pytest.mark.slow
def test_the_wheel_over_a_scene_scrolls_the_page_and_leaves_the_scene(page):
    page.set_viewport_size({"width": 1400, "height": 500})
    show_tab(page, "Residuals")
    before = _distance(_camera(page))
    box = plot(page, "arrows").bounding_box()
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    page.mouse.wheel(0, 200)
    page.wait_for_function("() => window.scrollY > 50")
    wait_until_drawn(page)
    assert _distance(_camera(page)) == pytest.approx(before)
    page.set_viewport_size({"width": 1400, "height": 900})


@pytest.mark.slow
def test_a_scene_is_zoomed_and_reset_by_keyboard(page):
    show_tab(page, "Residuals")
    first = _distance(_camera(page))
    label = "Residuals as arrows in space"
    page.get_by_role("button", name=f"Zoom in: {label}").press("Enter")
    nearer = _wait_for_distance(page, True, first - 0.01)
    assert nearer == pytest.approx(first / 1.25)
    page.get_by_role("button", name=f"Rotate left: {label}").press("Enter")
    page.get_by_role("button", name=f"Reset view: {label}").press("Enter")
    assert _wait_for_distance(page, False, nearer + 0.01) == pytest.approx(first)


_SPREAD = "(one) => { const [a, b] = one._fullLayout.yaxis.range; return b - a; }"
"""Width of the shown range of a chart's residuals: what a zoom changes."""


def _settled_spread(page, chart) -> float:
    """Width of the range once it stays: a chart is fitted to its data again after the window has changed its height."""
    wait_until_drawn(page)
    before, spread = None, chart.evaluate(_SPREAD)
    while spread != before:
        page.wait_for_timeout(500)
        before, spread = spread, chart.evaluate(_SPREAD)
    return spread


def _turn_the_wheel(page, chart, notch: int) -> None:
    """Turn the mouse wheel over the middle of a chart."""
    box = chart.bounding_box()
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    page.mouse.wheel(0, notch)


@pytest.mark.slow
def test_the_wheel_over_a_chart_scrolls_the_page(page):
    page.set_viewport_size({"width": 1400, "height": 500})
    show_tab(page, "Residuals")
    chart = plot(page, "chart")
    before = _settled_spread(page, chart)
    _turn_the_wheel(page, chart, 200)
    page.wait_for_function("() => window.scrollY > 50")
    assert _settled_spread(page, chart) == pytest.approx(before)
    page.set_viewport_size({"width": 1400, "height": 900})


@pytest.mark.slow
def test_a_chart_zooms_with_ctrl_and_the_wheel_and_is_reset(page):
    page.set_viewport_size({"width": 1400, "height": 900})
    show_tab(page, "Residuals")
    page.evaluate("() => window.scrollTo(0, 0)")
    chart = plot(page, "chart")
    before = _settled_spread(page, chart)
    page.keyboard.down("Control")
    _turn_the_wheel(page, chart, -200)
    page.keyboard.up("Control")
    zoomed = "one.layout.yaxis.range[1] - one.layout.yaxis.range[0] < 0.95 * before"
    page.wait_for_function(  # plotly takes over a zoom 50 ms after the last notch of the wheel
        f"([one, before]) => {zoomed}", arg=[chart.element_handle(), before]
    )
    page.evaluate("() => window.scrollTo(0, 0)")
    page.get_by_role("button", name="Reset view: Residual of each sample").press("Enter")
    spread = "Math.abs(one._fullLayout.yaxis.range[1] - one._fullLayout.yaxis.range[0] - before)"
    page.wait_for_function(
        f"([one, before]) => {spread} < 1e-6 * before", arg=[chart.element_handle(), before]
    )


@pytest.mark.slow
def test_the_end_of_a_rerun_links_to_its_report_page(page):
    show_tab(page, "Edit and rerun")
    page.get_by_role("button", name="Calibrate").click()
    wait_for_text(page, "job", "Finished after", 300_000)
    link = page.get_by_role("link", name="Report page of this run")
    link.wait_for()
    answer = page.request.get(page.served.origin + "/" + link.get_attribute("href"))
    assert answer.status == 200 and "<html" in answer.text()
    number = link.get_attribute("href").split("/")[1]
    for wrong in (f"runs/{number}/../session.toml", f"runs/{number}/%2e%2e/session.toml"):
        assert page.request.get(f"{page.served.origin}/{wrong}").status == 404
    for wrong in ("runs/999/report.html", "runs/x/report.html", "runs/-1/report.html"):
        assert page.request.get(f"{page.served.origin}/{wrong}").status == 404
    assert page.problems == []


@pytest.mark.slow
def test_the_page_says_how_to_go_on_when_the_server_has_ended(browser, tmp_path):
    made = serve("elastic-arm", tmp_path / "session", is_forked=False)
    page = open_page(browser, made, "Recording")
    stop(made)
    text = page.locator("[data-stopped]")
    text.wait_for()
    assert "start `workbench open` again" in text.inner_text()
    assert str(made.session.resolve()) in text.inner_text()
    page.close()
