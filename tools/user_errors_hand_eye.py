"""Write docs/user-errors-hand-eye.md: what `workbench handeye` makes of mistakes planted into right recordings.

Run from anywhere: `python tools/user_errors_hand_eye.py`. Takes some ten minutes on an idle machine.
Real recordings take part where they are present.
"""

import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "user-errors-hand-eye.md"
_LONGEST = 260
INTRODUCTION = """# Detection of mistakes in hand-eye recordings

This page shows which mistakes in a hand-eye recording `workbench handeye` detects. It compares the scatter of the
estimated board pose with the scatter that the corner noise causes. The corner noise is estimated from each image
alone, without the robot. If the scatter is significantly larger, alternatives are fitted: each common mistake is
reversed, images are assigned to other poses, a scale of the flange positions is estimated, and a motion of the
camera or of the board between two images is tested. A cause is reported only if its alternative fits nearly within
the noise and the recorded data do not. If the mistake is certain, the recording is refused (exit status 2);
With `--trust-data` the refusal becomes a warning.

![Inverted flange poses are refused](images/user-errors-hand-eye.svg)

The table is computed by `tests/hand_eye_user_errors.py`. The recordings are rendered, with a known sensor
pose, or real (`handeye_open3dv`, with the result of the correct recording as reference). This page is written by
`python tools/user_errors_hand_eye.py`. For mistakes in recordings of robot arms see [user-errors.md](user-errors.md).

- **refused**, **warned**: the message names the right cause. A mistake is refused if the estimated board pose has
  more scatter than an arm that was never calibrated makes (1 mm, and 0.2 % of the distance from flange to board), else
  warned of, and the verdict is then not passed (exit status 1). The same mistake, such as a board square
  × 1.05, may be refused in a recording with other poses.
- *refused, other cause*, *warned, other cause*: the message names something else.
- harmless: the result is correct despite the mistake (within 3 mm and 0.5 deg).
- SILENT: a wrong result without a warning.
- –: the mistake cannot be made in this recording.

"""


def main() -> None:
    """Run the bench and write the page."""
    sys.path[:0] = [str(ROOT), str(ROOT / "tests")]
    import hand_eye_recordings as recordings
    from hand_eye_user_errors import MISTAKES, outcome, outcomes

    found, right_ones = {}, {}
    for name in (*recordings.SCENES, *recordings.REAL):
        try:
            right = recordings.made(name) if name in recordings.SCENES else recordings.real(name)
        except ValueError as problem:
            print(f"left out: {problem}")
            continue
        right_ones[name] = outcome(right, right)
        found[name] = outcomes(right, name)
        print(f"{name}: {len(found[name])} mistakes")
    PAGE.write_text(INTRODUCTION + page(MISTAKES, found, right_ones), encoding="utf-8")


def page(mistakes, found, right_ones) -> str:
    """The tables, and one sentence per mistake."""
    names = list(found)
    lines = [f"| mistake | {' | '.join(names)} |", "|---" * (len(names) + 1) + "|"]
    untouched = " | ".join(word(right_ones[name]) for name in names)
    lines.append(f"| none | {untouched} |")
    for mistake in mistakes:
        cells = [word(found[name].get(mistake)) for name in names]
        lines.append(f"| {mistake} | {' | '.join(cells)} |")
    return (
        "\n".join(
            [*lines, "", *summary(found), "", "## What is said", "", *sentences(mistakes, found)]
        )
        + "\n"
    )


def word(one) -> str:
    """One cell."""
    if one is None:
        return "–"
    if one.what in ("refused", "warned"):
        return f"**{one.what}**" if one.named else f"*{one.what}, other cause*"
    return {"harmless": "harmless", "silent": "SILENT"}[one.what]


def summary(found) -> list[str]:
    """Counts over all recordings."""
    every = [one for rows in found.values() for one in rows.values()]
    counted = [one for one in every if one.what != "harmless"]
    named = sum(one.named for one in counted)
    silent = sum(one.what == "silent" for one in counted)
    return [
        f"{len(every)} planted mistakes, {len(every) - len(counted)} of them harmless. Of the other {len(counted)}, "
        f"{named} ({100 * named / len(counted):.1f} %) are stopped or warned of with the right cause; {silent} pass "
        "silently with a wrong result."
    ]


def sentences(mistakes, found) -> list[str]:
    """The message of the first recording, shortened."""
    lines = []
    for mistake in mistakes:
        rows = [one[mistake] for one in found.values() if mistake in one and one[mistake].sentence]
        if rows:
            said = rows[0].sentence
            short = said if len(said) <= _LONGEST else f"{said[:_LONGEST].rsplit(' ', 1)[0]} …"
            lines.append(f"- {mistake}: “{short}”")
    return lines


if __name__ == "__main__":
    main()
