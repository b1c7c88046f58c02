"""What the browser tests of the app share: a server in a process of its own, and Debian's Chromium."""

import json
import os
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
CHROMIUM = shutil.which("chromium")
# Rendered in software, so that the same is drawn on every machine.
FLAGS = ["--no-sandbox", "--disable-gpu", "--enable-unsafe-swiftshader"]
WAIT_MS = 40_000
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


@dataclass
class Served:
    """A running app: its `address` with the token, `origin` without it, `token`, its folder and session.toml."""

    address: str
    folder: Path
    process: subprocess.Popen

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


def run_workbench(*words, cwd: Path) -> None:
    """Run a command; the test fails with its message where it does not end well."""
    done = subprocess.run(
        [sys.executable, "-m", "workbench", *map(str, words)],
        cwd=cwd,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr


def serve(subject, folder: Path) -> Served:
    """`workbench open SUBJECT` with its session in `folder`; skips where trame is not installed."""
    folder.mkdir(parents=True, exist_ok=True)
    return _serve([str(subject), "--session", str(folder / "session.toml")], folder)


def serve_nothing(folder: Path) -> Served:
    """`workbench open` in an empty folder."""
    return _serve([], folder)


def _serve(words: list[str], folder: Path) -> Served:
    for package in ("trame", "trame_vuetify", "trame_plotly"):
        pytest.importorskip(package, reason="the app needs the extra app of this project")
    process = subprocess.Popen(
        [sys.executable, "-m", "workbench", "open", *words, "--no-browser"],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stdout=subprocess.PIPE,
        stderr=(folder / "stderr.txt").open("w"),
        text=True,
    )
    address = process.stdout.readline().strip()
    if not address:
        process.wait(30)
        raise AssertionError((folder / "stderr.txt").read_text())
    return Served(address, folder, process)


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


def emit(page, figure: str, event: str, value: dict) -> None:
    """Have a figure emit an event of plotly, as a click on a mark in space does."""
    plot(page, figure).evaluate(
        "(element, [name, value]) => element.emit(name, value)", [event, value]
    )


def text_of(page, name: str) -> str:
    """A status line of the page."""
    return page.locator(f"[data-text={name}]").inner_text()


def wait_for_text(page, name: str, part: str, timeout: float = WAIT_MS) -> str:
    """The status line once it holds `part`."""
    page.locator(f"[data-text={name}]", has_text=part).wait_for(timeout=timeout)
    return text_of(page, name)


_SHARED = {
    "variant": "",
    "depends_on": [],
    "options": {},
    "alarms": [],
    "alternatives": [],
    "parameters": [],
    "controls": [],
    "found_again": {"folds": 9, "of": 9},
}
_LINK = {
    "effect": "link-compliance",
    "where": "link-1",
    "variant": "",
    "why": "it makes 87 % of the same signature",
    "probability": 0.01,
    "alike": 0.87,
    "not_recorded": "",
}
_KEPT = {
    **_SHARED,
    "effect": "joint-compliance",
    "where": "joint-2",
    "p_value": 3e-31,
    "probability": 0.99,
    "alternatives": [_LINK],
    "parameters": [{"name": "compliance", "value": 2e-5, "std": 4e-7, "unit": "rad/(N m)"}],
    "controls": [{"control": "permuted", "p_value": 0.005, "passed": True, "why": ""}],
    "size_mm": 0.36,
    "t": 7.7,
    "held_out_gain_mm": 0.08,
    "statement": "Joint 2 deflects under the gravity torque.",
}
_REFUSED = {
    **_SHARED,
    "effect": "backlash",
    "where": "joint-5",
    "p_value": 2e-3,
    "probability": 0.6,
    "size_mm": 0.01,
    "t": 1.1,
    "held_out_gain_mm": 0.0,
    "statement": "Joint 5 stops short.",
    "reason": "the held-out error does not fall",
}


def diagnosis_answer() -> dict:
    """A diagnosis of the bundled arm as `workbench diagnose` writes it, with one term kept and one refused."""
    places = (("joint-2", 0.59, 1e-99), ("link-1", 0.5, 1e-80), ("joint-5", 0.1, 0.4))
    located = [{"where": w, "share_of_mismatch": share, "p_value": p} for w, share, p in places]
    return {
        "command": "diagnose",
        "recording": "elastic-arm",
        "input": "elastic-arm",
        "samples": 300,
        "verdict": "explained",
        "unit": "mm",
        "effects": [dict(_KEPT)],
        "refused": [dict(_REFUSED)],
        "located": located,
        "next_experiment": "Measure 2 poses more.",
        "held_out": {"before_mm": 0.117, "after_mm": 0.039, "noise_mm": 0.035, "folds": 4},
    }


def write_diagnosis(folder: Path) -> Path:
    """A run folder of a diagnosis, with residuals of all samples and the poses of a next experiment."""
    import numpy as np

    import datasets

    folder.mkdir(parents=True)
    (folder / "answer.json").write_text(json.dumps(diagnosis_answer()), encoding="utf-8")
    ids = datasets.read("elastic-arm").sample_ids
    vectors = np.random.default_rng(5).normal(0, 0.03, (len(ids), 6))
    head = "sample," + ",".join(
        f"{when}_{axis}_mm" for when in ("before", "after") for axis in "xyz"
    )
    table = np.column_stack([ids, vectors])
    np.savetxt(folder / "residuals.csv", table, fmt="%.6g", delimiter=",", header=head, comments="")
    poses = (
        "joint 1,joint 2,joint 3,joint 4,joint 5,joint 6\n10,20,-10,5,-60,0\n-30,10,-20,15,-70,40\n"
    )
    (folder / "next-experiment-poses.csv").write_text(poses, encoding="utf-8")
    return folder
