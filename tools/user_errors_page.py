"""Writes docs/user-errors.md: what the plausibility check makes of each mistake in each recording.

`python tools/user_errors_page.py` runs the bench of tests/user_errors.py on every recording, with
names of recordings on those alone; docs/user-errors.json keeps the outcomes of the others. Real
recordings that are absent keep their last outcomes. All recordings together take about half an hour.
"""

import json
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests"))

from conftest import recordings_folder  # noqa: E402
from robot_model import load_robot  # noqa: E402
from user_error_scenes import REAL, SIMULATED, simulated  # noqa: E402
from user_errors import MISTAKES, RIGHT, is_absorbed, judged  # noqa: E402
from workbench.core.errors import InputError  # noqa: E402
from workbench.fitting.calibration_plans.plans import geometry  # noqa: E402
from workbench.fitting.plausibility import check_plausibility  # noqa: E402
from workbench.jobs.robot.calibrate import calibrate  # noqa: E402

PAGE, DATA = ROOT / "docs" / "user-errors.md", ROOT / "docs" / "user-errors.json"
SOUND = "no mistake"
HEAD = """# Detection of mistakes in recordings of arms

This page shows which mistakes in a recording `calibrate` detects, such as a wrong unit or a swapped column. Each
row is a mistake, each column a recording into which it was introduced. `python tools/user_errors_page.py` writes
this page; `tests/test_user_errors.py` runs the same test. The checks were developed on these recordings and
mistakes: the detection rate on others may be lower.

![A joint in radians is refused](images/user-errors.svg)

- **stopped**: `calibrate` refuses the recording, and its message names the cause.
- **warned**: a warning names the cause.
- **either**: stopped or warned; the message names two causes that explain the data equally well, one of them correct.
- other cause: stopped or warned, but the message names another cause.
- unnamed: a warning states that the recording does not fit, and what to check.
- calibration: the plausibility check reports nothing; the calibration warns or excludes samples.
- **silent**: neither the plausibility check nor the calibration reports anything.
- absorbed: the mistake cannot be detected: base, tool and plausible geometry, or the parameter named below the
  table, absorb it, and the recording fits as well as the correct one.
- –: the mistake cannot be made in this recording.

"""


def outcomes_of(recording) -> dict[str, str]:
    """Outcome of the sound recording and of every mistake in it."""
    found = check_plausibility(load_robot(recording.robot), recording)
    outcomes = {SOUND: "nothing" if not found else f"false alarm ({found[0].cause})"}
    for mistake in MISTAKES:
        outcomes[mistake.name] = _outcome(mistake, recording)
        print(f"{recording.name}: {mistake.name}: {outcomes[mistake.name]}", flush=True)
    return outcomes


def _outcome(mistake, recording) -> str:
    made = mistake.make(recording) if recording.measures in mistake.kinds else None
    if made is None:
        return "–"
    if mistake.absorbed(made):
        return "absorbed"
    outcome = judged(mistake, made)
    if outcome == "silent" and is_absorbed(recording, made):
        return "absorbed"
    return _calibrated(made) if outcome == "silent" else outcome


def _calibrated(recording) -> str:
    """Whether a calibration of base, tool and geometry says anything."""
    try:
        found = calibrate(recording, [geometry(load_robot(recording.robot))])
    except InputError:
        return "calibration"
    return "calibration" if found.warnings or found.suspects else "silent"


def page(outcomes: dict[str, dict[str, str]]) -> str:
    """The page from the outcomes by recording."""
    names = list(outcomes)
    lines = ["| mistake | " + " | ".join(names) + " |", "|---" * (len(names) + 1) + "|"]
    for row in (SOUND, *(mistake.name for mistake in MISTAKES)):
        cells = [_cell(outcomes[name].get(row, "–")) for name in names]
        lines.append(f"| {row} | " + " | ".join(cells) + " |")
    return HEAD + summary(outcomes) + "\n".join(lines) + "\n" + _footnotes()


def _cell(outcome) -> str:
    return f"**{outcome}**" if outcome in (*RIGHT, "silent") else outcome


def summary(outcomes) -> str:
    """How many mistakes were stopped or warned about with the right cause."""
    every = [o for by_name in outcomes.values() for row, o in by_name.items() if row != SOUND]
    judged_ones = [o for o in every if o not in ("–", "absorbed")]
    right = sum(o in RIGHT for o in judged_ones)
    silent = sum(o == "silent" for o in judged_ones)
    false = sum(by_name[SOUND] != "nothing" for by_name in outcomes.values())
    share = 100 * right / max(len(judged_ones), 1)
    return (
        f"Of {len(judged_ones)} mistakes that can be detected, {right} ({share:.0f} %) were stopped or warned about "
        f"with the right cause, and {silent} passed silently. Warnings on the {len(outcomes)} sound recordings: "
        f"{false}.\n\n"
    )


def _footnotes() -> str:
    reasons = {m.name: m.absorbed(None) for m in MISTAKES if m.absorbed(None)}
    return "".join(f"\nNot detectable: {name}; {why}.\n" for name, why in reasons.items())


def _recordings(wanted):
    for name in wanted:
        if name in SIMULATED:
            yield name, simulated(name)
        elif (recordings_folder() / name).is_dir():
            yield name, REAL[name](recordings_folder() / name)
        else:
            print(f"{name} is not in {recordings_folder()}: its last outcomes are kept")


def main() -> int:
    """Run the bench on the named recordings and write data and page."""
    every = (*SIMULATED, *REAL)
    kept = json.loads(DATA.read_text(encoding="utf-8")) if DATA.is_file() else {}
    for name, recording in _recordings(sys.argv[1:] or every):
        kept[name] = outcomes_of(recording)
        kept = {name: kept[name] for name in every if name in kept}
        DATA.write_text(json.dumps(kept, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
        PAGE.write_text(page(kept), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
