"""Writes docs/catalogue.md and its images: the residual that each effect leaves in a fit without it.

`python tools/catalogue_page.py` writes the page; `--check` tests whether its text is up to date (else status 1). Each
entry is computed: an ideal recording is simulated, the effect is added, the baseline is fitted without it.
"""

import sys
from pathlib import Path

import catalogue_robot
import catalogue_sensor
from catalogue_entries import ORTHOGONAL_SIGMA, Entry
from catalogue_images import draw
from workbench.explanation.sentences.words import law, length

ROOT = Path(__file__).parents[1]
PAGE, IMAGES = ROOT / "docs" / "catalogue.md", ROOT / "docs" / "catalogue"
HEAD = f"""# Residuals of each effect

This page shows the residual that each effect causes if the model does not contain it. For each effect a recording
without noise is simulated (`python tools/catalogue_page.py` writes this page). The effect is added at the size
whose residual is {ORTHOGONAL_SIGMA:g} σ (at most 40 times its typical size), and the baseline is fitted without it:
geometry, base and tool of an ABB IRB 120 with 240 random poses, loads of 0-2 kg, both directions of approach and 12
K of warming; for the scanner, camera, mirror and board poses from a rendered recording. The image shows the
residual.

- *Orthogonal to the baseline* is the share of the squared effect that the baseline does not absorb. The baseline
  absorbs the remainder, mostly in link lengths.
- *Confounded with* names effects with a similar residual in these poses, and the share that each explains.
- *Separated by* is the next measurement that `workbench diagnose` proposes for an effect so small that it is hardly
  distinguishable from the confounded ones.

"""


def page(images: bool) -> str:
    """The whole page; with `images` these are drawn, too."""
    robot = [_section(entry, images) for entry in catalogue_robot.entries()]
    sensor = [_section(entry, images, "sensor-") for entry in catalogue_sensor.entries()]
    left_out = "\n".join(f"- `{name}`: {why}." for name, why in catalogue_robot.NOT_SEEN.items())
    more = "\n".join(f"- `{name}`: {why}." for name, why in catalogue_sensor.NOT_SEEN.items())
    return (
        f"{HEAD}## Effects of the arm and the instrument\n\n{''.join(robot)}\n"
        f"Effects without an entry:\n\n{left_out}\n\n"
        f"## Effects of the scanner\n\n{''.join(sensor)}\nEffects without an entry:\n\n{more}\n"
    )


def _section(entry: Entry, images: bool, prefix: str = "") -> str:
    file = f"{prefix}{entry.name}.png"
    if images:
        draw(entry, IMAGES / file)
    confounded = (
        ", ".join(f"{name} ({100 * share:.0f} %)" for name, share in entry.confounded)
        or "no other effect in these poses"
    )
    numbers = "; ".join(entry.values[:3]) + (
        f"; and {len(entry.values) - 3} more" if len(entry.values) > 3 else ""
    )
    size, left = (length(value, entry.unit) for value in (entry.size, entry.left))
    share = 100 * entry.orthogonal_share
    return f"""### {entry.name}

{law(entry.kind.effect, entry.where, kind=entry.kind)}: `{entry.kind.equation}`.

![{entry.name}](catalogue/{file})

- Here at {entry.where}: {numbers}.
- Size {size} RMS, residual {left} RMS: {share:.2g} % of its square is orthogonal to the baseline.
- Confounded with: {confounded}.
- Separated by: {entry.separates}

"""


def main() -> int:
    """Write or check; the exit status."""
    if "--check" not in sys.argv:
        IMAGES.mkdir(parents=True, exist_ok=True)
        PAGE.write_text(page(True), encoding="utf-8")
        return 0
    fresh = PAGE.is_file() and PAGE.read_text(encoding="utf-8") == page(False)
    state = "is up to date" if fresh else "is stale: run python tools/catalogue_page.py"
    print(f"docs/catalogue.md {state}")
    return 0 if fresh else 1


if __name__ == "__main__":
    sys.exit(main())
