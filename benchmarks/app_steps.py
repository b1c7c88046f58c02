"""`python -m benchmarks.app_steps [SAMPLES [REPEATS]]`: each interaction of the app in Chromium on a million samples.

The mouse and the keyboard act as a person's do. Prints, for each interaction, the time in ms from the event in the page
until something has been painted, as median, 95 % and largest: `answer` is the line or table that answers it, the other
names are figures. `server_cpu` and `page_cpu` are the processor time in ms of the server's thread and of the page's
process for the interaction, with the pause after it: on a busy machine these are the figures that count. The first
visit of a tab stands apart from the further ones; what was not drawn within 20 s is `nan`. Also prints the load of the
machine, the processor time of server and page while nothing happens, and the peak memory of the server. Needs the extra
test and Debian's chromium.
"""

import json
import os
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from benchmarks.app import make_run
from benchmarks.app_browser import new_browser, peak_mib, serve

_REPEATS = 12
_PAUSE_MS = 1200
_IDLE_S = 10
_TABS = ("Recording", "Residuals", "Edit and rerun", "Diagnosis")
_WATCH = """([event, text, planes, scenes, overlays]) => {
    const plot = (name) => document.querySelector(`[data-figure=${name}] .js-plotly-plot`);
    const seen = (element) => element && getComputedStyle(element).visibility !== 'hidden';
    const line = () => Array.from(document.querySelectorAll(text)).find(seen)?.innerText ?? null;
    const glplot = (name) => plot(name)?._fullLayout?.scene?._scene?.glplot;
    const marks = overlays.map((name) => `marks of ${name}`);
    const parts = [...(text ? ['answer'] : []), ...planes, ...scenes, ...marks], waiting = new Set(parts);
    const layers = (part) => {
        const canvas = document.querySelector(`[data-overlay=${part.replace('marks of ', '')}]`);
        return canvas && canvas.layersText;  // set once they are drawn
    };
    const oldLayers = {};
    for (const part of marks) oldLayers[part] = layers(part);
    const old = {line: text && line(), data: {}}, times = {}, rendered = {};
    for (const name of [...planes, ...scenes]) old.data[name] = plot(name)?.data;
    const isNew = (name) => plot(name)?.data?.length && plot(name).data !== old.data[name];
    for (const name of scenes) {
        const scene = glplot(name), onrender = scene?.onrender;
        if (!scene) continue;
        scene.onrender = function () {
            if (onrender) onrender.apply(this, arguments);
            if (isNew(name)) { scene.onrender = onrender; setTimeout(() => { rendered[name] = true; }); }
        };
        rendered[name] = false;
    }
    const isDrawn = (name) => {  // of a new scene the first frame sets its camera
        if (!isNew(name) || rendered[name] === false || !glplot(name)?.cameraParams?.view) return false;
        const gl = glplot(name).gl;
        gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));  // waits until it is drawn
        return true;
    };
    const is = (name) => {
        if (name === 'answer') return line() !== old.line;
        if (marks.includes(name)) return layers(name) !== oldLayers[name];
        return scenes.includes(name) ? isDrawn(name) : isNew(name);
    };
    window.stepTimes = new Promise((done) => addEventListener(event, (found) => {
        const painted = (name) => requestAnimationFrame(() => setTimeout(() => {
            times[name] = performance.now() - found.timeStamp;
        }));
        const look = () => {
            for (const name of Array.from(waiting)) if (is(name)) { waiting.delete(name); painted(name); }
            const isLate = performance.now() - found.timeStamp > 20000;
            if (isLate) for (const name of waiting) times[name] = NaN;
            if (isLate || Object.keys(times).length === parts.length) done(times);
            else setTimeout(look, 4);
        };
        look();
    }, {capture: true, once: true}));
}"""


@dataclass(frozen=True)
class Step:
    """What is awaited: the event that starts the clock, the line that answers it, and what is drawn again.

    planes, scenes: figures that plotly draws again; overlays: figures whose marks change, which the page draws itself.
    """

    event: str
    line: str
    planes: tuple[str, ...] = ()
    scenes: tuple[str, ...] = ()
    overlays: tuple[str, ...] = ()


@dataclass
class Times:
    """Times in ms of each interaction: name -> one dictionary for each repetition."""

    page: object
    clock: "_Clock"
    repeats: int = _REPEATS
    found: dict[str, list[dict]] = field(default_factory=dict)

    def measure(self, name: str, step: Step, act, *values) -> None:
        """Act as a person, by a call of `act` with `values`, and note the times until the page has answered."""
        words = [step.event, step.line, *map(list, (step.planes, step.scenes, step.overlays))]
        self.page.evaluate(_WATCH, words)
        before = self.clock.seconds
        act(*values)
        row = self.page.evaluate("() => window.stepTimes")
        self.page.wait_for_timeout(_PAUSE_MS)
        spent = [1000 * (new - old) for old, new in zip(before, self.clock.seconds)]
        self.found.setdefault(name, []).append(
            {**row, "server_cpu": spent[0], "page_cpu": spent[1]}
        )

    def summary(self, name: str) -> dict:
        """Median, 95 % and largest ms of each part of an interaction."""
        rows = self.found[name]
        made = {}
        for part in rows[0]:
            values = np.array([row[part] for row in rows])
            made[part] = np.round(np.quantile(values, (0.5, 0.95, 1))).tolist()
        return made


def main(words: list[str]) -> int:
    """Measure a recording of the given number of samples."""
    from playwright.sync_api import sync_playwright

    samples, repeats = [*map(int, words), *(1_000_000, _REPEATS)[len(words) :]]
    with tempfile.TemporaryDirectory() as name, sync_playwright() as started:
        folder = Path(name)
        make_run(folder, samples)
        browser = new_browser(started)
        process, address = serve(folder)
        try:
            page = browser.contexts[0].pages[0]
            page.goto(address)
            page.wait_for_function("() => performance.getEntriesByName('step-all_figures').length")
            browser.stop_tracing()
            page.wait_for_timeout(3 * _PAUSE_MS)
            clock = _Clock(page, process.pid)
            _say({"samples": samples, "idle": _idle(clock)})
            times = Times(page, clock, repeats)
            for measure in (_tabs, _residuals, _recording, _edit):
                known = set(times.found)
                measure(times)
                for step in times.found.keys() - known:
                    _say({step: times.summary(step)})
            load = round(os.getloadavg()[0], 1)
            _say({"peak_mib": peak_mib(process.pid), "load": load, "repeats": repeats})
        finally:
            process.terminate()
            process.wait(30)
    return 0


def _say(made: dict) -> None:
    print(json.dumps(made), flush=True)


class _Clock:
    """Processor time of the thread that answers in the server, and of the page's process."""

    def __init__(self, page, pid: int):
        self._file = Path(f"/proc/{pid}/schedstat")  # of the main thread, in ns
        self._session = page.context.new_cdp_session(page)
        self._session.send("Performance.enable")

    @property
    def seconds(self) -> tuple[float, float]:
        """Of the server's thread, and of the page, so far."""
        metrics = self._session.send("Performance.getMetrics")["metrics"]
        on_page = next(one["value"] for one in metrics if one["name"] == "ProcessTime")
        return int(self._file.read_text().split()[0]) / 1e9, on_page


def _idle(clock: _Clock) -> dict:
    """Per cent of a processor core while nothing happens, of the server's thread and of the page's process."""
    before = clock.seconds
    time.sleep(_IDLE_S)
    shares = [100 * (new - old) / _IDLE_S for old, new in zip(before, clock.seconds)]
    return dict(zip(("server_percent", "page_percent"), np.round(shares, 1).tolist()))


def _tab(page, title: str):
    return page.get_by_role("tab", name=title, exact=True)


def _tabs(times: Times) -> None:
    """From a click on a tab to its text, and at the first visit to its figures."""
    figures = {
        "Recording": Step("click", "[data-tab=recording]", ("coverage",), ("scene",)),
        "Residuals": Step("click", "[data-text=selection]"),  # drawn before
        "Edit and rerun": Step("click", "[data-tab=edit]", ("threshold", "comparison")),
        "Diagnosis": Step("click", "[data-tab=diagnosis]"),
    }
    for visit in range(max(times.repeats // 2, 2)):
        for title in _TABS:
            step = figures[title]
            step = step if visit == 0 else Step(step.event, step.line)
            name = f"tab {title}, {'first' if visit == 0 else 'further'} visit"
            times.measure(name, step, _tab(times.page, title).click)
    _tab(times.page, "Residuals").click()
    times.page.wait_for_timeout(2 * _PAUSE_MS)


def _residuals(times: Times) -> None:
    """Brush, exclude samples or poses, take back, another axis."""
    page = times.page
    line = "[data-text=selection]"
    selected = Step("mouseup", line, overlays=("chart", "arrows"))
    edited = Step("click", line, ("histogram",), (), ("chart", "arrows"))
    axis = Step("click", "", ("chart",))
    for repeat in range(times.repeats):
        times.measure("brush", selected, _brush, page, 0.1 + 0.05 * repeat)
        name = ("Exclude selected samples", "Exclude their poses")[repeat % 2]
        exclude = page.get_by_role("button", name=name)
        times.measure(("exclude", "exclude poses")[repeat % 2], edited, exclude.click)
        _choose_axis(times, axis, repeat + 1)
        _tab(page, "Edit and rerun").click()
        page.wait_for_timeout(2 * _PAUSE_MS)
        undone = Step("click", "[aria-label='Changes of the session']", ("threshold",))
        times.measure("undo", undone, page.get_by_role("button", name="Undo").click)
        _tab(page, "Residuals").click()
        page.wait_for_timeout(2 * _PAUSE_MS)


def _choose_axis(times: Times, step: Step, place: int) -> None:
    """Choose another quantity for the horizontal axis."""
    page = times.page
    page.get_by_role("combobox", name="Horizontal axis").press("Enter")
    page.wait_for_timeout(_PAUSE_MS)
    options = page.get_by_role("option")
    times.measure("axis", step, options.nth(place % options.count()).click)


def _brush(page, share: float) -> None:
    """Drag a rectangle over a part of the chart's width, from its top to half of its height."""
    box = page.locator("[data-figure=chart] .nsewdrag").first.bounding_box()
    page.mouse.move(box["x"] + 2, box["y"] + 2)
    page.mouse.down()
    page.mouse.move(box["x"] + share * box["width"], box["y"] + 0.5 * box["height"], steps=4)
    page.mouse.up()


def _recording(times: Times) -> None:
    """Scrub through time by key and by mouse."""
    page = times.page
    _tab(page, "Recording").click()
    page.wait_for_timeout(3 * _PAUSE_MS)
    slider = page.get_by_role("slider", name="Sample in the order of the recording")
    slider.focus()
    moved = Step("keydown", "[data-text=row]", overlays=("scene",))
    dragged = Step("mouseup", "[data-text=row]", overlays=("scene",))
    for repeat in range(times.repeats):
        times.measure("scrub by key", moved, page.keyboard.press, "PageUp")
        times.measure("scrub by mouse", dragged, _click_slider, page, slider, repeat)


def _click_slider(page, slider, repeat: int) -> None:
    """A click on the track of a slider."""
    track = slider.locator("xpath=ancestor::*[contains(@class, 'v-slider__container')]")
    box = track.bounding_box()
    page.mouse.click(box["x"] + (0.05 + 0.07 * repeat) * box["width"], box["y"] + box["height"] / 2)


def _edit(times: Times) -> None:
    """Drag the outlier threshold: from each movement of the mouse to the count and the histogram."""
    page = times.page
    _tab(page, "Edit and rerun").click()
    page.wait_for_timeout(2 * _PAUSE_MS)
    slider = page.get_by_role("slider", name="Outlier threshold in mm")
    box = slider.bounding_box()
    y = box["y"] + box["height"] / 2
    page.mouse.move(box["x"] + box["width"] / 2, y)
    page.mouse.down()
    step = Step("mousemove", "[data-text=threshold]", ("threshold",))
    for repeat in range(times.repeats):
        x = box["x"] - 12 * (repeat + 1)
        times.measure("threshold", step, page.mouse.move, x, y)
    page.mouse.up()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
