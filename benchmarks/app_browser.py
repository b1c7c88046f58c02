"""`python -m benchmarks.app_browser [SAMPLES]`: the app in Chromium on a recording of a million samples.

Starts `workbench open` on the run that `benchmarks.app` makes, and prints in seconds of wall time: from the address to
the first figure on the screen and to all three figures of the tab Residuals, with the processor time of server and page
(the figure that counts on a busy machine), then from an action to the line that answers it and to the new chart; at
last the peak memory of the server. Needs the extra test and Debian's chromium.
"""

import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from benchmarks.app import make_run

_FLAGS = ["--no-sandbox", "--disable-gpu", "--enable-unsafe-swiftshader"]
_WAIT_MS = 120_000
_PAINTED = """() => new Promise((done) => {
    const names = %s;
    const look = () => {
        const all = names.every((name) => {
            const one = document.querySelector(`[data-figure=${name}] .js-plotly-plot`);
            return one && one.data && one.data.length && one.querySelector('.main-svg');
        });
        if (all) requestAnimationFrame(() => requestAnimationFrame(done)); else setTimeout(look, 10);
    };
    look();
})"""


def main(words: list[str]) -> int:
    """Measure a recording of the given number of samples."""
    samples = int(words[0]) if words else 1_000_000
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        make_run(folder, samples)
        process, address = _serve(folder)
        try:
            print(json.dumps({"samples": samples, **_measure(address, process.pid)}), flush=True)
            print(json.dumps({"peak_mib": _peak_mib(process.pid)}), flush=True)
        finally:
            process.terminate()
            process.wait(30)
    return 0


def _serve(folder: Path) -> tuple[subprocess.Popen, str]:
    words = ["open", str(folder / "run"), "--no-browser", "--session", str(folder / "session.toml")]
    process = subprocess.Popen(
        [sys.executable, "-m", "workbench", *words],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(Path(__file__).resolve().parent.parent)},
        stdout=subprocess.PIPE,
        text=True,
    )
    return process, process.stdout.readline().strip()


def _measure(address: str, pid: int) -> dict:
    """Seconds of each step; the page is opened twice, since a browser starts slowly."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as started:
        browser = started.chromium.launch(executable_path=shutil.which("chromium"), args=_FLAGS)
        page = browser.new_page(viewport={"width": 1400, "height": 900})
        page.set_default_timeout(_WAIT_MS)
        page.goto("about:blank")
        clock = _Clock(page, pid)
        made = _first_paint(page, address, "first", clock)
        made |= _first_paint(page, address, "again", clock)
        made |= _interactions(page, clock)
        browser.close()
    return made


class _Clock:
    """Processor seconds of the server and of the page's process so far."""

    def __init__(self, page, pid: int):
        self._session, self._pid = page.context.new_cdp_session(page), pid
        self._session.send("Performance.enable")

    @property
    def seconds(self) -> tuple[float, float]:
        """Of the server, and of the page."""
        fields = Path(f"/proc/{self._pid}/stat").read_text().rpartition(")")[2].split()
        server = (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
        metrics = self._session.send("Performance.getMetrics")["metrics"]
        return server, next(one["value"] for one in metrics if one["name"] == "ProcessTime")


def _first_paint(page, address: str, called: str, clock: _Clock) -> dict:
    before = clock.seconds
    begun = time.perf_counter()
    page.goto(address)
    page.get_by_role("tab", name="Recording").wait_for()
    bar = time.perf_counter() - begun
    made = {f"{called}_bar_s": bar}
    for names in (["histogram"], ["arrows", "chart", "histogram"]):
        page.evaluate(_PAINTED % json.dumps(names))
        made[f"{called}_{len(names)}_figures_s"] = time.perf_counter() - begun
    for name, old, new in zip(("server", "page"), before, clock.seconds):
        made[f"{called}_{name}_cpu_s"] = new - old
    return {name: round(value, 2) for name, value in made.items()}


_ACT = """([action, expected]) => new Promise((done) => {
    const line = document.querySelector('[data-text=selection]');
    const begun = performance.now();
    const old = line.innerText;
    const plot = (name) => document.querySelector(`[data-figure=${name}] .js-plotly-plot`);
    const before = plot('chart').data;
    let answered = 0;
    const drawn = () => {
        if (plot('chart').data === before) return setTimeout(drawn, 5);
        requestAnimationFrame(() => done([answered, performance.now() - begun]));
    };
    const end = () => { seen.disconnect(); answered = performance.now() - begun; drawn(); };
    const seen = new MutationObserver(() => { if (line.innerText !== old) requestAnimationFrame(end); });
    seen.observe(line, {childList: true, characterData: true, subtree: true});
    const range = (a, b, c, d) => ({range: {x: [a, b], y: [c, d]}});
    if (action === 'click') plot('arrows').emit('plotly_click', {points: [{customdata: 7}]});
    if (action === 'brush') plot('chart').emit('plotly_selected', range(-20, 20, 0.1, 0.2));
    if (action === 'bar') plot('histogram').emit('plotly_click', {points: [{customdata: [0.1, 0.12, 'held_out']}]});
    if (action === 'clear')
        Array.from(document.querySelectorAll('button')).find((b) => b.innerText === 'Clear selection').click();
})"""


def _interactions(page, clock: _Clock) -> dict:
    """Milliseconds from an action to the status line that answers it and to the new chart, the better of two.

    `cpu_of_all`: processor time of server and page until all three figures are drawn.
    """
    best: dict[str, float] = {}
    for _ in range(2):
        for action in ("click", "brush", "bar", "clear"):
            page.wait_for_timeout(1500)
            before = clock.seconds
            answered, drawn = page.evaluate(_ACT, [action, ""])
            page.wait_for_timeout(1500)  # until all figures are drawn
            spent = 1000 * sum(new - old for old, new in zip(before, clock.seconds))
            for name, value in (("answer", answered), ("chart", drawn), ("cpu_of_all", spent)):
                key = f"{action}_{name}_ms"
                best[key] = min(value, best.get(key, value))
    return {name: round(value) for name, value in best.items()}


def _peak_mib(pid: int) -> int:
    """Peak resident memory of a process, on Linux."""
    for line in Path(f"/proc/{pid}/status").read_text().splitlines():
        if line.startswith("VmHWM:"):
            return int(line.split()[1]) // 1024
    return -1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
