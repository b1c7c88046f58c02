"""Writes docs/catalogue.md and its images: what each effect leaves behind when a fit does not know of it.

`python tools/catalogue_page.py` writes the page; `--check` says whether its text is up to date (status 1). Every entry
is made by the workbench: a perfect recording is simulated, the effect added, the baseline fitted without it.
"""

import sys
from pathlib import Path

import catalogue_robot
import catalogue_sensor
from catalogue_entries import SURVIVING, Entry
from catalogue_images import draw
from workbench.diagnosis.words import law, length

ROOT = Path(__file__).parents[1]
PAGE, IMAGES = ROOT / "docs" / "catalogue.md", ROOT / "docs" / "catalogue"
HEAD = f"""# What each effect leaves behind

Made by `python tools/catalogue_page.py`. For each effect a perfect recording is simulated, the effect is added so large
that {SURVIVING:g} σ survive (at most 40 times what is usual), and the baseline is fitted without it: geometry, base
and tool of an ABB IRB 120 with 240 random poses, loads of 0-2 kg, both sides of approach and 12 K of warming; of the
scanner camera, mirror and poses of the boards, from a rendered recording. The image shows what is left.

- *Survives* is the share of the effect's square that the baseline has not swallowed: the rest hides in wrong lengths.
- *Taken for* names what would make the same image in these poses, and how much of it.
- *Separated by* is what `workbench diagnose` would propose to measure next, for an effect so small that its twins are
  hard to tell.

"""


def page(images: bool) -> str:
    """The whole page; with `images` these are drawn, too."""
    robot = [_section(entry, images) for entry in catalogue_robot.entries()]
    sensor = [_section(entry, images, "sensor-") for entry in catalogue_sensor.entries()]
    left_out = "\n".join(f"- `{name}`: {why}." for name, why in catalogue_robot.NOT_SEEN.items())
    more = "\n".join(f"- `{name}`: {why}." for name, why in catalogue_sensor.NOT_SEEN.items())
    return (
        f"{HEAD}## The robot's\n\n{''.join(robot)}\nWithout an entry:\n\n{left_out}\n\n"
        f"## The scanner's\n\n{''.join(sensor)}\nWithout an entry:\n\n{more}\n"
    )


def _section(entry: Entry, images: bool, prefix: str = "") -> str:
    file = f"{prefix}{entry.name}.png"
    if images:
        draw(entry, IMAGES / file)
    taken = (
        ", ".join(f"{name} ({100 * share:.0f} %)" for name, share in entry.twins)
        or "nothing in these poses"
    )
    numbers = "; ".join(entry.values[:3]) + (
        f"; and {len(entry.values) - 3} more" if len(entry.values) > 3 else ""
    )
    size, left = (length(value, entry.unit) for value in (entry.size, entry.left))
    return f"""### {entry.name}

{law(entry.kind.effect, entry.where, kind=entry.kind)}: `{entry.kind.equation}`.

![{entry.name}](catalogue/{file})

- Here at {entry.where}: {numbers}.
- By itself {size} RMS, of which {left} are left: {100 * entry.survives:.2g} % of its square survives.
- Taken for: {taken}.
- Separated by: {entry.separates}

"""


def main() -> int:
    """Write or check; the exit status."""
    if "--check" not in sys.argv:
        IMAGES.mkdir(parents=True, exist_ok=True)
        PAGE.write_text(page(True), encoding="utf-8")
        return 0
    fresh = PAGE.is_file() and PAGE.read_text(encoding="utf-8") == page(False)
    told = "is up to date" if fresh else "is stale: run python tools/catalogue_page.py"
    print(f"docs/catalogue.md {told}")
    return 0 if fresh else 1


if __name__ == "__main__":
    sys.exit(main())
