"""Text and image of docs/gallery/laser-spot.md, from the figures of gallery_laser_spot."""

from pathlib import Path

import numpy as np

import gallery_laser_spot as figures
from datasets import papers
from datasets.makers import liu
from robot_model import load_robot

_TEXT = """# Calibration by laser beams through the middle of a detector

Liu, Shi & Ding, IEEE CYBER 2014, 365. A laser on the flange shines at a position-sensitive detector; the arm is moved
until the spot is in its middle, from several sides. The detector is then turned about a fixed centre and the same is
done again: beams of one place meet in a point, and the points lie on a sphere. Nobody measures point, sphere or beam.
This page is written by `python tools/gallery.py laser-spot`; its recordings are made by plain matrix products that
share no code with the calibration (datasets/makers/liu.py (`datasets/makers/liu.py`), which also says how the
run-together columns of table 3 were read).

```sh
python -m datasets.makers.liu beams --beams 12 --sigma 0.02
workbench calibrate beams --out beams-result
python -m datasets.makers.liu one-detector --beams 40 --positions 1 --sigma 0.02
workbench calibrate one-detector --out one-detector-result
```

![where beams cross after each objective, and what each objective sees](laser-spot.png)

## Exact beams: table 3

Seven places, six beams each. The arm is off by the paper's "actual" errors.

{table}

| | published | here |
|---|---|---|
| eq. 6 alone: crossings of one place apart | {published:.0f} mm rms, table 2 | {spread6:.2f} mm rms |
| eq. 6 alone: objective at the end | "all on a sphere" | {end6:.0e} mm² (from {start6:.0f}) |
| eq. 7: crossings of one place apart | meet | {spread7:.0e} mm |
| ours: greatest difference from the actual errors shown above | | {off:.0e} mm or deg |

- **Why eq. 6 fails.** It asks that the spheres through any four of the means have one centre, in other words that
  M = 7 points lie on one sphere. However many spheres are drawn, that is M - 4 = 3 conditions: its derivative has
  rank {rank6} of 22. Nineteen directions are free, and it stops at the first of the many arms that put seven means on
  a sphere. Nothing in it asks that beams of one place meet, so they do not.
- **Eq. 7** adds that they meet. Its rank is {rank7} of 22. The four directions that are left move no beam: the arm
  grown as a whole; d2 against d3, on parallel axes; a6 and alpha6, along and about the beam. They stay where they
  start, which is why the paper's table shows a6 and alpha6 right, whose actual error was zero. That it
  prints -0.05 for d3 by itself takes the 0.05 deg between the axes, and exact data. The table is at the true size,
  and d2 + d3 is one number in it.
- **Ours** asks that each beam passes its point at no distance, with beam, points and sphere as unknowns.

## Beams driven to within 0.02 mm

Eq. 7 falls when the arm shrinks, and with noise it does: on the first recording of six beams a place a2 ends at
{gone:.0f} mm of 270. It needs a2 held (below), and the beam known. Ours needs neither. RMS distance of exact beams from
the best point, at 30 places that were not measured; nominal arm {nominal:.3f} mm:

| recording | eq. 7, a2 held, 84 beams | ours, 84 beams | ours, 42 beams |
|---|---|---|---|
{compared}

Half the beams do as well only where half is still enough. The same with six beams a place, rms of five recordings:
eq. 7 on 42 beams {six[0]:.4f}, ours on 42 {six[1]:.4f}, ours on 21 {six[2]:.4f} mm: 42 conditions for some
forty unknowns.

The middles of the detector are spread evenly over the cap of the sphere that faces the arm. With the means of table 2
as middles instead, two of which are 9 mm apart, spheres through four points are so badly determined that eq. 7 did not
converge here even with exact beams (six a place: crossings still 0.13 mm apart after 300 steps); ours did.

## One detector that does not turn

The same command takes it: one point, no sphere. 40 beams of 0.02 mm leave {single:.4f} mm at the same 30 places,
held-out {held:.3f} mm (0.028 is the noise of two directions).

## What beams cannot tell, in the program's words

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
    return "\n".join([*lines, f"| rms of all | {a:.4f} | {b:.4f} | {c:.4f} |"])


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
