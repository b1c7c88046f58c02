"""`python -m benchmarks.app_browser [SAMPLES]`: the app in Chromium on a recording of a million samples.

Starts `workbench open` on the run that `benchmarks.app` makes, and opens the address as soon as it is printed. First
paint is the moment from which heading, errors, status line and an image of the residuals in space are on the screen.
Prints for several openings, each in a new browser, and for each step in seconds:

- `wall`: wall time since the address was opened, with the load of the machine;
- `page_cpu`: processor time of the page's main thread until the step, the figure that counts on a busy machine;
- `server_cpu`: processor time of the server from the opening until everything is drawn.

Then, with the last browser alone, the time from an action to the line that answers it and to the marks in the chart;
median, 95 % and largest time in ms over clicks on many samples to the line (`answer`), the ring in space (`mark`), the
marks in the chart and in the scene; and the peak memory of the server. Needs the extra test and Debian's chromium.
"""

import json
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

from benchmarks.app import make_run

_FLAGS = ["--no-sandbox", "--disable-gpu", "--enable-unsafe-swiftshader"]
_WAIT_MS = 120_000
_OPENINGS = 3
_CLICKS = 24
_MARKS = """(() => {
    const drawn = (name) => {
        const one = document.querySelector(`[data-figure=${name}] .js-plotly-plot`);
        return one && one.data && one.data.length && one.querySelector('.main-svg');
    };
    const line = () => document.querySelector('[data-text=selection]');
    const still = () => document.querySelector('[data-still=arrows]');
    const steps = {
        bar: () => document.querySelector('[role=tab]'),
        first_paint: () => line() && line().innerText && still() && still().complete && still().naturalWidth,
        chart: () => drawn('chart'),
        all_figures: () => drawn('chart') && drawn('histogram') && drawn('arrows'),
    };
    const look = () => {
        for (const name of Object.keys(steps)) if (steps[name]()) {
            delete steps[name];
            requestAnimationFrame(() => setTimeout(() => performance.mark('step-' + name)));
        }
        if (Object.keys(steps).length) setTimeout(look, 10);
    };
    look();
})()"""
"""Marks each step once a frame with it has been painted."""


def main(words: list[str]) -> int:
    """Measure a recording of the given number of samples."""
    from playwright.sync_api import sync_playwright

    samples = int(words[0]) if words else 1_000_000
    with tempfile.TemporaryDirectory() as name, sync_playwright() as started:
        folder = Path(name)
        make_run(folder, samples)
        browsers = [new_browser(started) for _ in range(_OPENINGS)]
        process, address = serve(folder)
        try:
            for browser in browsers:
                _say(_open(browser, address, process.pid))
            for browser in browsers[:-1]:  # every open page draws each change of the selection
                browser.close()
            _say({"samples": samples, **_act(browsers[-1], process.pid)})
            _say({"clicks": _CLICKS, **_click_times(browsers[-1])})
            _say({"peak_mib": peak_mib(process.pid)})
        finally:
            process.terminate()
            process.wait(30)
    return 0


def _say(made: dict) -> None:
    print(json.dumps(made), flush=True)


def new_browser(started):
    """A browser with an empty page: its own start is no part of the figures."""
    browser = started.chromium.launch(executable_path=shutil.which("chromium"), args=_FLAGS)
    page = browser.new_page(viewport={"width": 1400, "height": 900})
    page.set_default_timeout(_WAIT_MS)
    page.add_init_script(_MARKS)
    page.goto("about:blank")
    browser.start_tracing(page=page, categories=["blink.user_timing"])
    return browser


def serve(folder: Path) -> tuple[subprocess.Popen, str]:
    """`workbench open` on the run in a folder: its process and its address."""
    words = ["open", str(folder / "run"), "--no-browser", "--session", str(folder / "session.toml")]
    process = subprocess.Popen(
        [sys.executable, "-m", "workbench", *words],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(Path(__file__).resolve().parent.parent)},
        stdout=subprocess.PIPE,
        text=True,
    )
    return process, process.stdout.readline().strip()


def _open(browser, address: str, pid: int) -> dict:
    """Wall time and processor time of each step of one opening."""
    page = browser.contexts[0].pages[0]
    before = server_seconds(pid)
    page.goto(address)
    page.wait_for_function("() => performance.getEntriesByName('step-all_figures').length")
    spent = server_seconds(pid) - before
    marks = page.evaluate(
        "() => performance.getEntriesByType('mark').map((one) => [one.name, one.startTime])"
    )
    wall = {name.removeprefix("step-"): round(at / 1000, 2) for name, at in marks}
    events = json.loads(browser.stop_tracing())["traceEvents"]
    load = round(os.getloadavg()[0], 1)
    return {
        "wall": wall,
        "page_cpu": _thread_seconds(events),
        "server_cpu": round(spent, 2),
        "load": load,
    }


def _thread_seconds(events: list[dict]) -> dict[str, float]:
    """Processor time of the page's main thread from the start of the navigation to each mark.

    A navigation into a new process has no such start: there all time of the thread counts.
    """
    marks = {one["name"]: one for one in events if one.get("name", "").startswith("step-")}
    thread = next(iter(marks.values()))["tid"]
    starts = [one for one in events if one.get("name") == "navigationStart"]
    begun = [0, *(one["tts"] for one in starts if one["tid"] == thread and "tts" in one)][-1]
    return {
        name.removeprefix("step-"): round((one["tts"] - begun) / 1e6, 2)
        for name, one in marks.items()
    }


def _act(browser, pid: int) -> dict:
    page = browser.contexts[0].pages[0]
    return _interactions(page, _Clock(page, pid))


def server_seconds(pid: int) -> float:
    """Processor seconds of a process so far, on Linux."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


class _Clock:
    """Processor seconds of the server and of the page's process so far."""

    def __init__(self, page, pid: int):
        self._session, self._pid = page.context.new_cdp_session(page), pid
        self._session.send("Performance.enable")

    @property
    def seconds(self) -> tuple[float, float]:
        """Of the server, and of the page."""
        metrics = self._session.send("Performance.getMetrics")["metrics"]
        server = server_seconds(self._pid)
        return server, next(one["value"] for one in metrics if one["name"] == "ProcessTime")


_ACT = """([action, expected]) => new Promise((done) => {
    const line = document.querySelector('[data-text=selection]');
    performance.mark('step-action');
    const begun = performance.now();
    const old = line.innerText;
    const plot = (name) => document.querySelector(`[data-figure=${name}] .js-plotly-plot`);
    const marks = document.querySelector('[data-overlay=chart]'), before = marks.layersText;
    let answered = 0;
    const drawn = () => {
        if (marks.layersText === before) return setTimeout(drawn, 5);  // set once they are painted
        requestAnimationFrame(() => {
            performance.mark('step-chart_of_action');
            done([answered, performance.now() - begun]);
        });
    };
    const end = () => { seen.disconnect(); answered = performance.now() - begun; drawn(); };
    const seen = new MutationObserver(() => { if (line.innerText !== old) requestAnimationFrame(end); });
    seen.observe(line, {childList: true, characterData: true, subtree: true});
    const pointer = (type, across, down) => {
        const target = document.querySelector('[data-figure=chart] .nsewdrag'), area = target.getBoundingClientRect();
        const place = {clientX: area.left + across * area.width, clientY: area.top + down * area.height};
        target.dispatchEvent(new PointerEvent(type, {...place, bubbles: true, button: 0}));
    };
    const brush = () => {
        pointer('pointerdown', 0.4, 0.01);
        pointer('pointermove', 0.6, 0.99);
        pointer('pointerup', 0.6, 0.99);
    };
    if (action === 'click') plot('arrows').emit('plotly_click', {points: [{customdata: 7}]});
    if (action === 'brush') brush();
    if (action === 'bar') plot('histogram').emit('plotly_click', {points: [{customdata: [0.1, 0.12, 'held_out']}]});
    if (action === 'clear')
        Array.from(document.querySelectorAll('button')).find((b) => b.innerText === 'Clear selection').click();
})"""


def _interactions(page, clock: _Clock) -> dict:
    """Milliseconds from an action to the status line that answers it and to the marks in the chart, the better of two.

    `chart_page_cpu`: processor time of the page's main thread until the new chart; `all_cpu`: of server and page until
    all figures are drawn.
    """
    best: dict[str, float] = {}
    for action in 2 * ("click", "brush", "bar", "clear"):
        for name, value in _interaction(page, clock, action).items():
            key = f"{action}_{name}_ms"
            best[key] = min(value, best.get(key, value))
    return {name: round(value) for name, value in best.items()}


def _interaction(page, clock: _Clock, action: str) -> dict:
    """Milliseconds of one action."""
    page.wait_for_timeout(1500)
    before = clock.seconds
    page.context.browser.start_tracing(page=page, categories=["blink.user_timing"])
    answered, drawn = page.evaluate(_ACT, [action, ""])
    page.wait_for_timeout(1500)  # until all figures are drawn
    events = json.loads(page.context.browser.stop_tracing())["traceEvents"]
    marks = {one["name"]: one["tts"] for one in events if one.get("name", "").startswith("step-")}
    on_page = (marks["step-chart_of_action"] - marks["step-action"]) / 1000
    spent = 1000 * sum(new - old for old, new in zip(before, clock.seconds))
    return {"answer": answered, "chart": drawn, "chart_page_cpu": on_page, "all_cpu": spent}


_CLICK = """(row) => new Promise((done) => {
    const begun = performance.now(), times = {};
    const plot = (name) => document.querySelector(`[data-figure=${name}] .js-plotly-plot`);
    const line = document.querySelector('[data-tab=residuals]'), text = line.innerText;
    const layers = (name) => document.querySelector(`[data-overlay=${name}]`).layersText;  // set once painted
    const before = {chart: layers('chart'), arrows: layers('arrows')};
    const ring = () => document.querySelector('[data-mark=arrows]');
    const steps = {
        answer: () => line.innerText !== text,
        mark: () => ring() && ring().innerText === `sample ${row + 1}` && ring().style.visibility === 'inherit',
        chart: () => layers('chart') !== before.chart,
        scene: () => layers('arrows') !== before.arrows,
    };
    const painted = (name) => requestAnimationFrame(() => setTimeout(() => {
        times[name] = performance.now() - begun;
    }));
    const look = () => {
        for (const name of Object.keys(steps)) if (steps[name]()) { delete steps[name]; painted(name); }
        if (Object.keys(times).length === 4) done(times);
        else setTimeout(look, 4);
    };
    look();
    plot('arrows').emit('plotly_click', {points: [{customdata: row}]});
})"""


_DRAWN = """() => Array.from(new Set(document.querySelector('[data-figure=arrows] .js-plotly-plot')
    ._fullData.find((one) => one.name === 'residuals').customdata))"""


def _click_times(browser) -> dict:
    """Median, 95 % and largest milliseconds from a click on an arrow to each step, over clicks on different samples."""
    page = browser.contexts[0].pages[0]
    rows = page.evaluate(_DRAWN)
    found = []
    for k in range(_CLICKS):
        found.append(page.evaluate(_CLICK, rows[(k * len(rows)) // _CLICKS]))
        page.wait_for_timeout(1000)
    summary = {}
    for name in ("answer", "mark", "chart", "scene"):
        times = [round(one[name]) for one in found]
        late = round(statistics.quantiles(times, n=20)[-1])
        summary[f"{name}_ms"] = {
            "median": statistics.median(times),
            "95 %": late,
            "largest": max(times),
        }
    return {**summary, "load": round(os.getloadavg()[0], 1)}


def peak_mib(pid: int) -> int:
    """Peak resident memory of a process, on Linux."""
    for line in Path(f"/proc/{pid}/status").read_text().splitlines():
        if line.startswith("VmHWM:"):
            return int(line.split()[1]) // 1024
    return -1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
