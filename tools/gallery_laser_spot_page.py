"""Text and image of docs/gallery/laser-spot.md, from the figures of gallery_laser_spot."""

from pathlib import Path

import numpy as np

import gallery_laser_spot as figures
from datasets import papers
from datasets.makers import liu
from robot_model import load_robot

_TEXT = """# Calibration with a laser and a position-sensitive detector (Liu 2014)

Liu, Shi & Ding, IEEE CYBER 2014, 365. A laser on the flange points at a position-sensitive detector. The arm is moved
until the spot is at the centre of the detector, from several directions. All these beams intersect at one point. The
detector is then rotated about a fixed centre, and the measurement is repeated: the intersection points lie on a
sphere. Points, sphere and beam are unknown; only joint readings are recorded. `python tools/gallery.py laser-spot`
writes this page. The recordings are simulated by `datasets/makers/liu.py`, which shares no code with the calibration.

```sh
python -m datasets.makers.liu beams --beams 12 --sigma 0.02
workbench calibrate beams --out beams-result
python -m datasets.makers.liu one-detector --beams 40 --positions 1 --sigma 0.02
workbench calibrate one-detector --out one-detector-result
```

![Intersections of the beams after the fit of each objective, and singular values of both objectives](laser-spot.png)

## Beams without errors: table 3

Seven detector positions with six beams each. The simulated arm has the parameter errors of the column "actual".

{table}

| | published | here |
|---|---|---|
| eq. 6 alone: distance of the beams of one position | {published:.0f} mm RMS, table 2 | {spread6:.2f} mm RMS |
| eq. 6 alone: final value of the objective | "all on a sphere" | {end6:.0e} mm² (from {start6:.0f}) |
| eq. 7: distance of the beams of one position | zero | {spread7:.0e} mm |
| ours: largest difference from the actual errors above | | {off:.0e} mm or deg |

- **Equation 6** requires that the seven mean points lie on one sphere. These are M - 4 = 3 conditions. The rank of its
  Jacobian is {rank6} of 22, so that 19 directions are not identifiable. No condition requires that the beams of one
  position intersect.
- **Equation 7** adds this condition. Its rank is {rank7} of 22. The other four directions do not move any beam: the
  scale of the arm, d2 against d3 (parallel axes), and a6 and alpha6 (along and about the beam). These parameters keep
  their start values. In the paper's table a6 and alpha6 are correct because their actual errors were zero. Its value
  of -0.05 for d3 is identifiable only because of the 0.05 deg between the axes and the absence of noise. The table
  above uses the true scale, and contains d2 + d3 as one parameter.
- **Ours** minimises the distance of each beam from its point; beam, points and sphere are estimated.

## Beams with a noise of 0.02 mm

Equation 7 becomes smaller if the arm shrinks. With noise the estimate therefore collapses: with six beams for each
position, a2 becomes {gone:.0f} mm instead of 270 mm. Equation 7 needs a fixed a2 (as below) and a known beam; ours
needs neither. RMS distance of beams without errors from the best point, at 30 other positions; nominal
arm {nominal:.3f} mm:

| recording | eq. 7, a2 fixed, 84 beams | ours, 84 beams | ours, 42 beams |
|---|---|---|---|
{compared}

With six beams for each position, RMS of five recordings: eq. 7 with 42 beams {six[0]:.4f}, ours with
42 {six[1]:.4f}, ours with 21 {six[2]:.4f} mm. 21 beams are 42 conditions for about forty unknowns.

Here the centres of the detector are distributed evenly over the part of the sphere that faces the arm. Two of the
points in table 2 of the paper are only 9 mm apart. Spheres through four such points are poorly determined:
equation 7 did not converge with them even without noise (distance 0.13 mm after 300 steps); ours did.

## One detector that is not rotated

The same command accepts one point without a sphere. With 40 beams and 0.02 mm noise the error at the same 30 positions
is {single:.4f} mm; the held-out error is {held:.3f} mm (0.028 mm is the noise of two directions).

## Parameters that are not identifiable

Output of the program:

{words}
"""


def page(exact, first, second) -> str:
    """The page; first, second: fits of eq. 6 and eq. 7 on the exact recording."""
    mine, new = figures.ours(exact.recording()), figures.unseen()
    geometry = figures.found(mine)[0]
    off = figures.errors_found(exact, geometry) - figures.errors_found(
        exact, exact.truth["geometry"]
    )
    one = figures.ours(liu.irb120(40, 1, 0.02).recording())
    return _TEXT.format(
        table=figures.table_3(exact, [first.geometry, second.geometry, geometry]),
        published=_published_spread(),
        spread6=first.spread,
        end6=first.end,
        start6=first.start,
        rank6=first.rank,
        spread7=second.spread,
        rank7=second.rank,
        off=np.abs(figures.shown(off)).max(),
        gone=figures.fit(liu.irb120(6, 7, 0.02), True).geometry[1, 2],
        nominal=figures.beam_error(new, load_robot(new.robot).geometry),
        compared=_compared(),
        six=np.sqrt((figures.compared(beams=6) ** 2).mean(0)),
        single=figures.beam_error(new, *figures.found(one)),
        held=one.held_out["rms_mm"],
        words="\n".join(f"- {sentence}" for sentence in mine.solution.all_known.sentences()),
    )


def _published_spread() -> float:
    """mm RMS of table 2's crossings about the means of their places."""
    table = papers.load("liu-2014")["table_2"]
    off = np.array(table["intersections_mm"]) - np.array(table["means_mm"])[:, None]
    return float(np.sqrt((off**2).sum(2).mean()))


def _compared() -> str:
    rows = figures.compared()
    lines = [f"| {k} | {a:.4f} | {b:.4f} | {c:.4f} |" for k, (a, b, c) in enumerate(rows, 1)]
    a, b, c = np.sqrt((rows**2).mean(0))
    return "\n".join([*lines, f"| RMS of all | {a:.4f} | {b:.4f} | {c:.4f} |"])


def draw_image(first, second, path: Path) -> None:
    """Crossings after eq. 6 and after eq. 7, seen along the arm, and the singular values of both."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, (left, middle, right) = pyplot.subplots(1, 3, figsize=(12, 3.8), layout="constrained")
    for axes, fit, name in (
        (left, first, "eq. 6: means on a sphere"),
        (middle, second, "eq. 7: and beams that meet"),
    ):
        for k, crossings in enumerate(fit.crossings):
            axes.plot(crossings[:, 1], crossings[:, 2], "o", ms=3, color=f"C{k}")
            axes.plot(*fit.means[k, 1:], "x", color=f"C{k}", ms=9)
        axes.set(
            title=f"{name}\ncrossings {fit.spread:.1g} mm apart (rms)",
            xlabel="y, mm",
            ylabel="z, mm (dots: crossings, x: means)",
        )
        axes.set_aspect("equal")
    for fit, name in ((first, "eq. 6"), (second, "eq. 7")):
        right.semilogy(
            np.arange(1, 23),
            np.maximum(fit.singular / fit.singular[0], 1e-13),
            "o-",
            ms=4,
            label=f"{name}: {fit.rank} of 22",
        )
    right.axhline(1e-6, color="grey", ls=":")
    right.set(
        title="what each objective sees", xlabel="direction", ylabel="singular value / largest"
    )
    right.legend(frameon=False)
    figure.savefig(path, dpi=110)
