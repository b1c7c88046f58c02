"""Small studies for tests: a file's text with some of it changed, and work that says what it did."""

import os
import time
from pathlib import Path

TEXT = """kind = "compliance"
title = "small"
seed = 3
do = ["simulate"]
part = 3
[scene]
robot = "abb_irb120"
samples = 20
sigma_mm = 0.02
[[scene.effect]]
effect = "joint-compliance"
where = "joint-2"
values = { compliance = 3e-5 }
[vary]
method = "sobol"
runs = 40
[[vary.parameter]]
name = "c2"
path = "scene.effect.1.values.compliance"
low = 1e-5
high = 1e-4
[test]
samples = 10
"""


def written(folder: Path, *changes: tuple[str, str], text: str = TEXT) -> Path:
    """The study as a file, with each (old, new) changed; an old text must be there."""
    return write_study(folder / "small.toml", *changes, text=text)


def write_study(path: Path, *changes: tuple[str, str], text: str = TEXT) -> Path:
    """The study at a path, with each (old, new) changed; an old text must be there."""
    for old, new in changes:
        assert old in text, old
        text = text.replace(old, new)
    path.write_text(text, encoding="utf-8")
    return path


def noted(folder: str, slowly: float, study, runs):
    """`do_part` that leaves a mark for every run that it made, in a process identified by its number."""
    from workbench.studies.engine import do_part

    time.sleep(slowly)
    rows, seconds = do_part(study, runs)
    for run in runs:
        with (Path(folder) / f"run-{run}").open("a") as mark:
            mark.write(f"{os.getpid()}\n")
    return rows, seconds


def dying_once(folder: str, study, runs):
    """`do_part` in a process that is killed the first time that it comes to run 10."""
    from workbench.studies.engine import do_part

    mark = Path(folder) / "died"
    if 10 in runs and not mark.exists():
        mark.touch()
        os.kill(os.getpid(), 9)
    return do_part(study, runs)
