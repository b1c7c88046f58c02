"""What the browser tests of the app share: a server in a process of its own, and Debian's Chromium."""

import os
import select
import shutil
import signal
import subprocess
import sys
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest

from conftest import COMMANDS, command_environment
from workbench.app.figures.arrows import CORNERS

CHROMIUM = shutil.which("chromium")
# Rendered in software, so that the same is drawn on every machine.
FLAGS = ["--no-sandbox", "--disable-gpu", "--enable-unsafe-swiftshader"]
WAIT_MS = 120_000
PLAN = """
[[stage]]
name = "geometry"
why = "lengths and angles of the arm"
free = ["base.*", "sensor.*", "joint-*.theta*", "joint-*.a*"]
earn = false
[[stage]]
name = "compliance"
why = "joints deflect under gravity"
effects = [{ effect = "joint-compliance", where = "joint-2" }, { effect = "joint-compliance", where = "joint-3" }]
"""


FRAMES = """
[[stage]]
name = "frames"
why = "base and hand-eye"
free = ["base.*", "sensor.*"]
earn = false
"""
LOADED = ("workbench.app.server", "workbench.app.ui.page", "trame.app", "wslink.backends.aiohttp")
"""Modules that every server of the app needs."""
TABS = ["Recording", "Residuals", "Edit and rerun", "Sensor", "Diagnosis", "Import"]


class AppProcess:
    """`workbench open`, forked from the process that has the libraries loaded; otherwise like `subprocess.Popen`."""

    def __init__(self, words: list[str], folder: Path):
        errors = folder / "stderr.txt"
        errors.touch()
        words = ["open", *words, "--no-browser"]
        with TemporaryDirectory() as place:
            pipe = Path(place) / "stdout"
            os.mkfifo(pipe)
            self.pid = COMMANDS.start(words, folder, pipe, errors, LOADED)
            self.stdout = pipe.open(encoding="utf-8")

    def send_signal(self, number: int) -> None:
        os.kill(self.pid, number)

    def terminate(self) -> None:
        self.send_signal(signal.SIGTERM)

    def wait(self, timeout: float) -> None:
        """Until it has ended, and its standard output with it."""
        while select.select([self.stdout], [], [], timeout)[0]:
            if not self.stdout.readline():
                return
        raise subprocess.TimeoutExpired("workbench open", timeout)


@dataclass
class Served:
    """A running app: its `address` with the token, `origin` without it, `token`, its folder and session.toml."""

    address: str
    folder: Path
    process: AppProcess | subprocess.Popen

    @property
    def origin(self) -> str:
        return self.address.partition("/?")[0]

    @property
    def port(self) -> int:
        return int(self.origin.rpartition(":")[2])

    @property
    def token(self) -> str:
        return self.address.partition("token=")[2]

    @property
    def session(self) -> Path:
        return self.folder / "session.toml"


def run_workbench(*words, cwd: Path, expected: tuple[int, ...] = (0,)) -> None:
    """Run a command; the test fails with its message where it ends with another status than those expected."""
    with TemporaryDirectory() as scratch:
        environment = command_environment()
        status = COMMANDS(list(map(str, words)), cwd, 600, environment, Path(scratch))
        assert status in expected, f"status {status} " + (Path(scratch) / "stderr").read_text(
            encoding="utf-8"
        )


def calibrate_arm(recording: str, folder: Path, plan: str = PLAN) -> Path:
    """Run folder of a calibration of an arm in few seconds."""
    (folder / "plan.toml").write_text(plan, encoding="utf-8")
    words = ["calibrate", recording, "--plan", folder / "plan.toml", "--folds", 3]
    run_workbench(*words, "--out", folder / "run", cwd=folder)
    return folder / "run"


def calibrate_scanner(folder: Path) -> Path:
    """Run folder of a calibration of a scanner and its arm from rendered images, which lie next to it."""
    from workbench.commands.data.demo import scene

    run_workbench("render", scene(), "--out", folder / "recording", cwd=folder)
    return calibrate_arm(str(folder / "recording"), folder, FRAMES)


def calibrate_hand_eye(folder: Path) -> Path:
    """Run folder of a hand-eye calibration from images of a board at flange poses."""
    from workbench.recordings.templates import write_template

    write_template("board-images", folder / "recording")
    run_workbench("handeye", folder / "recording", "--out", folder / "run", cwd=folder)
    return folder / "run"


def serve(subject, folder: Path, is_forked: bool = True) -> Served:
    """`workbench open SUBJECT` with its session in `folder`; skips where trame is not installed.

    is_forked: from a process that has the libraries loaded, which saves most of the time of the start.
    """
    folder.mkdir(parents=True, exist_ok=True)
    return _serve([str(subject), "--session", str(folder / "session.toml")], folder, is_forked)


def serve_nothing(folder: Path) -> Served:
    """`workbench open` in an empty folder."""
    return _serve([], folder, True)


def _serve(words: list[str], folder: Path, is_forked: bool) -> Served:
    for package in ("trame", "trame_vuetify", "trame_plotly"):
        pytest.importorskip(package, reason="the app needs the extra app of this project")
    process = AppProcess(words, folder) if is_forked else _started(words, folder)
    address = process.stdout.readline().strip()
    if not address:
        process.wait(30)
        raise AssertionError((folder / "stderr.txt").read_text())
    return Served(address, folder, process)


def _started(words: list[str], folder: Path) -> subprocess.Popen:
    """`workbench open` as a shell starts it."""
    return subprocess.Popen(
        [sys.executable, "-m", "workbench", "open", *words, "--no-browser"],
        cwd=folder,
        env=command_environment(),
        stdout=subprocess.PIPE,
        stderr=(folder / "stderr.txt").open("w"),
        text=True,
    )


def stop(served: Served) -> None:
    """End the server that `serve` started."""
    served.process.terminate()
    served.process.wait(30)


def chromium():
    """Playwright's browser, Debian's Chromium; skips with a reason where either is absent."""
    sync_api = pytest.importorskip("playwright.sync_api", reason="Playwright is not installed")
    if CHROMIUM is None:
        pytest.skip("Chromium is not installed: apt-get install -y chromium")
    started = sync_api.sync_playwright().start()
    browser = started.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
    return started, browser


@contextmanager
def opened_app(browser, run, folder: Path, tab: str = ""):
    """A page of a server of its own for a run, None for none; `page.served`, and its script errors in `page.problems`."""
    made = serve_nothing(folder) if run is None else serve(run, folder)
    page = None
    try:
        page = open_page(browser, made, tab)
        page.served, page.problems = made, follow_problems(page)
        yield page
    finally:
        if page is not None:
            page.close()
        stop(made)


def open_page(browser, served: Served, tab: str = ""):
    """A page of the app with its bar painted and, where named, a tab opened."""
    page = browser.new_page(viewport={"width": 1400, "height": 900})
    page.set_default_timeout(WAIT_MS)
    page.goto(served.address)
    page.get_by_role("tab", name="Recording").wait_for()
    if tab:
        show_tab(page, tab)
    return page


def show_tab(page, tab: str) -> None:
    """Open a tab and wait until it is there."""
    page.get_by_role("tab", name=tab, exact=True).click()
    name = tab.partition(" ")[0].lower()
    page.locator(f"[data-tab={name}]").wait_for()


def follow_problems(page) -> list[str]:
    """A list that collects the script errors of a page from now on."""
    problems: list[str] = []
    page.on("pageerror", lambda error: problems.append(str(error)))
    return problems


def click_row(page, row: int, samples: int) -> None:
    """Select a sample by a click on its arrow."""
    emit(page, "arrows", "plotly_click", {"points": [{"customdata": row}]})
    wait_for_text(page, "selection", f"1 of {samples:,} samples selected")


_FOLLOW = """(one, event) => { one.seen = false; one.once(event, () => { one.seen = true; }); }"""
_SEEN = "(one) => one.seen"


def click_at(page, figure: str, x: float, y: float) -> None:
    """Move the mouse to a place of the window and click, once plotly has seen what is there."""
    element = plot(page, figure)
    page.mouse.move(1, 1)
    element.evaluate(_FOLLOW, "plotly_hover")
    page.mouse.move(x, y)
    page.wait_for_function(_SEEN, arg=element.element_handle())
    element.evaluate(_FOLLOW, "plotly_click")
    page.mouse.down()
    if element.evaluate(
        "(one) => Boolean(one._fullLayout.scene)"
    ):  # looks at the pressed button in its next frame
        page.wait_for_function(_SEEN, arg=element.element_handle())
    page.mouse.up()
    page.wait_for_function(_SEEN, arg=element.element_handle())


_IS_DRAWN = """() => {
    const tab = document.querySelector('[data-tab]:not(.hidden-tab)');
    const isWaiting = (one) => one.offsetParent && !one.querySelector('.js-plotly-plot .main-svg');
    const moves = (one) => one.playState === 'running' && Number.isFinite(one.effect.getComputedTiming().endTime);
    return tab && !trame.state.state.trame__busy && !Array.from(tab.querySelectorAll('[data-figure]')).some(isWaiting)
        && !document.getAnimations().some(moves);
}"""
"""Whether the shown tab has all its figures, no request is in progress and nothing fades in or moves."""


def wait_until_drawn(page) -> None:
    """Wait until the shown tab is complete."""
    page.wait_for_function(_IS_DRAWN)


def settled_place(page, find) -> list[float]:
    """What `find` says of a place in the window, once it says the same again: figures grow and scenes rotate."""
    wait_until_drawn(page)
    before, place = None, find()
    while before is None or max(abs(a - b) for a, b in zip(before, place)) > 0.5:
        page.evaluate(_FRAMES)
        before, place = place, find()
    return place


_FRAMES = """async () => {
    for (let k = 0; k < 12; k++) await new Promise((painted) => requestAnimationFrame(painted));
}"""


def painted_marks(page, figure: str, colour: str) -> int:
    """How many marks with edges of a colour the page has painted above a figure."""
    return page.locator(f"[data-overlay={figure}]").evaluate(
        """(canvas, colour) => (canvas.layers || []).filter((one) => one.kind === 'marks' && one.colour === colour)
            .reduce((sum, one) => sum + one.places[0].length, 0)""",
        colour,
    )


_MIDDLE_OF_BIN = """(element, place) => {
    const {xaxis, yaxis} = element._fullLayout, box = element.getBoundingClientRect();
    const bins = element._fullData.find((one) => one.name === 'bins');
    return [box.left + xaxis._offset + xaxis.c2p(bins.x[place]), box.top + yaxis._offset + 0.6 * yaxis._length];
}"""


def click_bin(page, place: int) -> None:
    """Click on a bin of the histogram of the residuals, at 40 % of its height."""
    bins = plot(page, "histogram")
    x, y = settled_place(page, lambda: bins.evaluate(_MIDDLE_OF_BIN, place))
    click_at(page, "histogram", x, y)


def drawn_rows(page) -> list[int]:
    """Rows of the needles that are drawn in space."""
    corners = trace(page, "arrows", "residuals")["customdata"]
    assert len(corners) % CORNERS == 0
    return corners[::CORNERS]


_ENDS_OF_NEEDLES = """(element, corners) => {
    const scene = element._fullLayout.scene._scene, {projection, view, model} = scene.glplot.cameraParams;
    const marks = element._fullData.find((one) => one.name === 'residuals');
    const box = scene.container.getBoundingClientRect();
    const apply = (m, v) => [0, 1, 2, 3].map((i) => [0, 1, 2, 3].reduce((sum, j) => sum + m[4 * j + i] * v[j], 0));
    const place = (vertex) => {
        const point = ['x', 'y', 'z'].map((axis, k) => marks[axis][vertex] * scene.dataScale[k]);
        const seen = [model, view, projection].reduce((v, m) => apply(m, v), [...point, 1]);
        return [box.left + box.width * (0.5 + 0.5 * seen[0] / seen[3]), box.top + box.height * (0.5 - 0.5 * seen[1] / seen[3])];
    };
    const found = {};
    for (let first = 0; first < marks.customdata.length; first += corners)
        found[marks.customdata[first]] = [place(first), place(first + corners - 1)];
    return found;
}"""
"""Row -> where in the window its needle starts and ends, computed from the camera of the scene."""


_HAS_CAMERA = "(one) => one._fullLayout.scene?._scene?.glplot?.cameraParams?.view && true"


def ends_of_needles(page) -> dict[int, np.ndarray]:
    """Row -> (2, 2) px: where in the window the needle of a sample starts, and where its tip is."""
    arrows = plot(page, "arrows")
    page.wait_for_function(_HAS_CAMERA, arg=arrows.element_handle())
    found = arrows.evaluate(_ENDS_OF_NEEDLES, CORNERS)
    return {int(row): np.array(ends) for row, ends in found.items()}


def place_of_needle(page, row: int, share: float = 0.0) -> list[float]:
    """Where in the window a needle is, at a share of its length from the measured point."""
    start, tip = ends_of_needles(page)[row]
    return (start + share * (tip - start)).tolist()


def clearest_needle(page, share: float) -> int:
    """Row of the needle that is, at a share of its length, farthest from all other needles in the window."""
    ends = ends_of_needles(page)
    along = np.linspace(0, 1, 21)[:, None]
    shafts = {row: start + along * (tip - start) for row, (start, tip) in ends.items()}

    def distance(row: int) -> float:
        start, tip = ends[row]
        others = np.concatenate([shaft for other, shaft in shafts.items() if other != row])
        return np.linalg.norm(others - (start + share * (tip - start)), axis=1).min()

    return max(ends, key=distance)


def click_mark(page, row: int, share: float = 0.0) -> None:
    """Click on the needle of a sample in space, at a share of its length from the measured point."""
    click_at(page, "arrows", *settled_place(page, lambda: place_of_needle(page, row, share)))


def brush_chart(page) -> None:
    """Drag a rectangle over the whole chart of the residuals."""
    box = plot(page, "chart").locator(".nsewdrag").first.bounding_box()
    page.mouse.move(box["x"] + 2, box["y"] + 2)
    page.mouse.down()
    page.mouse.move(box["x"] + box["width"] - 2, box["y"] + box["height"] - 2, steps=6)
    page.mouse.up()


def cancel_run(page, command: str) -> None:
    """Start a run of the tab Edit and rerun, and cancel it."""
    show_tab(page, "Edit and rerun")
    wait_until_drawn(page)  # a page that is busy painting may miss a short run
    page.get_by_role("button", name=command).click()
    page.get_by_role("progressbar", name="Run in progress").wait_for()
    page.get_by_role("button", name="Cancel").press("Enter")
    wait_for_text(page, "job", "Cancelled")


_PLACES_IN_SCENE = """(name) => {
    const place = document.querySelector('[data-figure=scene] .js-plotly-plot');
    const drawn = Array.from(place._fullData.find((one) => one.name === name).x).filter((one) => one !== null);
    const layers = document.querySelector('[data-overlay=scene]').layers.filter((one) => one.name === name);
    return JSON.stringify([drawn, layers.map((one) => Array.from(one.places[0]))]);
}"""
"""Where a part of the scene is: of the traces of plotly, and of the marks above them."""


def scrub_by_key(page, name: str) -> None:
    """Move to the next sample by an arrow key, and wait until what `name` says has moved in or above the scene."""
    show_tab(page, "Recording")
    trace(page, "scene", name)
    before = page.evaluate(_PLACES_IN_SCENE, name)
    assert before != "[[],[]]"
    page.get_by_role("slider", name="Sample in the order of the recording").press("ArrowRight")
    page.wait_for_function(
        f"([name, old]) => ({_PLACES_IN_SCENE})(name) !== old", arg=[name, before]
    )


def plot(page, figure: str):
    """The plotly element of a figure, once it is drawn."""
    place = page.locator(f"[data-figure={figure}] .js-plotly-plot")
    place.wait_for()
    page.wait_for_function(
        "(element) => element.data && element.data.length > 0", arg=place.element_handle()
    )
    return place


def trace(page, figure: str, name: str) -> dict:
    """Length and name of a trace of a figure, as the browser holds it."""
    return plot(page, figure).evaluate(
        """(element, name) => {
            const found = element._fullData.find((one) => one.name && one.name.startsWith(name));
            return found ? {name: found.name, x: Array.from(found.x || []), y: Array.from(found.y || []),
                customdata: Array.from(found.customdata || []).map((one) => one && one.length ? Array.from(one) : one)} : null;
        }""",
        name,
    )


def choose_option(page, field: str, option: str) -> None:
    """Open a list by the Enter key, choose an option by the mouse, and wait until the list is closed."""
    page.get_by_role("combobox", name=field, exact=True).press("Enter")
    found = page.get_by_role("option", name=option, exact=True)
    click_option(found)
    found.wait_for(state="hidden")


def click_option(option) -> None:
    """Click an option of an open list once the list stands still.

    While a list opens, it takes no clicks. Playwright would scroll the page to find a place that does; the list then
    moves with the page, and a click ends on another option than it began on.
    """
    option.wait_for()
    option.evaluate(_STANDS_STILL)
    option.click()


_STANDS_STILL = """async (option) => {
    const list = option.closest('.v-overlay__content');
    while (list.getAnimations().length || getComputedStyle(list).pointerEvents === 'none')
        await new Promise((later) => requestAnimationFrame(later));
}"""
"""Returns once the list of an option has opened."""


def emit(page, figure: str, event: str, value: dict) -> None:
    """Have a figure emit an event of plotly, as a click on a mark in space does."""
    plot(page, figure).evaluate(
        "(element, [name, value]) => element.emit(name, value)", [event, value]
    )


def text_of(page, name: str) -> str:
    """A status line of the page."""
    return page.locator(_line(name)).inner_text()


def _line(name: str) -> str:
    """Selector of a status line of the shown tab; tabs that were shown before stay in the page, hidden."""
    return f"[data-tab]:not(.hidden-tab) [data-text={name}]"


def wait_for_text(page, name: str, part: str, timeout: float = WAIT_MS) -> str:
    """The status line once it holds `part`; a failure names what it holds, and the message of the page."""
    from playwright.sync_api import TimeoutError as Late

    try:
        page.locator(_line(name), has_text=part).wait_for(timeout=timeout)
    except Late:
        lines = [one.inner_text() for one in page.locator("[data-text], .v-alert").all()]
        raise AssertionError(f"{name}: expected {part!r}, the page shows {lines}") from None
    return text_of(page, name)
