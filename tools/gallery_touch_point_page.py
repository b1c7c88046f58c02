"""Text and image of docs/gallery/touch-point.md, from the figures of gallery_touch_point."""

from pathlib import Path

import numpy as np
from scipy.stats import wilcoxon

import gallery_touch_point as figures
from datasets.makers import gubankov

_TEXT = """# Calibration by touching points, with no instrument

Gubankov & Yukhimets, Sensors 2022, 22, 3376. A sharp tip on the flange is driven to a few fixed points with many
orientations. Nobody measures where the points are: the joint readings are all there is. This page is written by
`python tools/gallery.py touch-point`; its recordings are made from the paper's tables by plain matrix products that
share no code with the calibration (datasets/makers/gubankov.py (`datasets/makers/gubankov.py`), which also says
which minus signs the copy had lost and how they were restored).

```sh
python -m datasets.makers.gubankov touches --driving-error 0.16
workbench calibrate touches --out touches-result
python -m datasets.makers.gubankov touches-ur10e --arm ur10e --driving-error 0.16
workbench calibrate touches-ur10e --out touches-ur10e-result
```

![size of the arm and error at places not touched](touch-point.png)

## RV-2FB, series of 21, 21, 18 and 11 touches

{rv2fb}

*Ours*: the touched points are unknowns, each touch is weighed by how well it was driven. Touches say nothing about the
arm's size, so one length is held while all else is solved, and then the whole is brought to the size that all nominal
lengths together want most. *Their method*: eq. 7, 12-17 with theta1 and d1 as printed, that is, unchanged.

- **Without driving errors** both are exact but for one number, the arm's size: with it removed, ours is at
  {exact:.0e} mm. What is left before is luck: the deviations of this arm happen to add up to almost the nominal size
  ({size:+.1e}). The published 0.016 mm is this luck, not the accuracy of a method.
- **With driving errors** the paper's 0.16 mm is on the touched points themselves. At places not touched ours
  leaves {error:.3f} mm RMS over 100 recordings ({times:.1f} × less), worst recording {worst:.3f}; single places
  reach further, see the maxima above. The height of the whole (d1) and its turn (theta1) are removed here, because
  nothing in the data holds them. Counted without that ("direct"), 71 touches at one height leave the height of the
  whole as uncertain as the paper's figure, and no better.
- **The pair objective shrinks the arm.** It falls when all lengths fall. Over 100 recordings its main lengths come
  out too small by {shrunk:.1e} (ours: {kept:+.1e}; what the nominal lengths want: {size:+.1e}; paired Wilcoxon
  test that theirs is smaller: p = {p:.0e}; ours has the size of the nominal lengths by
  construction, whatever the noise). That is with the early stop that gives the paper's
  figures; iterated until J falls by less than 0.001 mm² the arm ends at {gone:.0%} of its size. Rejecting pairs farther
  apart than the driving accuracy does not help: it is a matter of the objective.

How far apart the orientations were is not in the paper; the J that it starts from (728) suggests little. It matters
more than the method, and the 80 degrees of all figures above were chosen knowing this table:

{sweep}

With the tool within 25 degrees of straight down neither method gets below 0.16 mm: these touches do not hold more, and
the pair objective shrinks whole arms in spite of its early stop.

## What touches cannot tell, in the program's words

{words}

These sentences come out of the null space of this recording, not out of a list.

## UR10e, three series of 21

Truth: the parameters that the paper identified. {ur_note}

{ur10e}

The two published figures do not go together: J is a sum of squares, so a fall by 39 makes distances fall by
√39 = 6.2 on the whole, not by more than ten. The rows above go together: driving errors of a little over 0.26 mm would
give the published fall of J, and 6.2; up to 0.16 mm, as the paper has elsewhere, distances fall by more than ten and J
by more than a hundred. In every row J ends at what the driving errors leave.

## Against a laser tracker (table 1, real)

{registration}

Centring and the best turn give the published figures to the last digit; ICP finds the same, since with points
300 mm apart the nearest is always the right one.
"""


def page(many: np.ndarray) -> str:
    """The page; many: what `gallery_touch_point.paired` returns."""
    exact = gubankov.rv2fb(0.0)
    answer = figures.ours(exact)
    joints = gubankov.unseen(exact)
    sized = figures.tip_errors(exact, joints, *figures.found(answer))["size"].max()
    pair, further, mine, error = many.T
    return _TEXT.format(
        rv2fb=figures.rv2fb_table(),
        ur10e=figures.ur10e_table(),
        registration=figures.registration_table(),
        sweep=_sweep(),
        words=_words(),
        exact=sized,
        size=figures.size_error(exact, figures.found(answer)[0]),
        error=figures.rms(error),
        times=0.16 / figures.rms(error),
        worst=error.max(),
        shrunk=-pair.mean(),
        kept=mine.mean(),
        p=wilcoxon(pair, mine, alternative="less").pvalue,
        gone=1 + further.mean(),
        ur_note="The tip, the points and the orientations are not in the paper and chosen here.",
    )


def _sweep() -> str:
    lines = [
        "| tool tilts by up to | J at the start, mm² | ours, rms mm | their method, rms mm |",
        "|---|---|---|---|",
    ]
    return "\n".join(
        lines + [f"| {t:g}° | {j:.0f} | {a:.3f} | {b:.3f} |" for t, j, a, b in figures.sweep()]
    )


def _words() -> str:
    known = figures.ours(gubankov.rv2fb(0.16)).solution.all_known
    return "\n".join(
        f"- {sentence}" for sentence in known.sentences() if "touched point" not in sentence[:13]
    )


def draw_image(many: np.ndarray, path: Path) -> None:
    """Left: size errors of both over the recordings; right: errors at places not touched, by tilt of the tool."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    pair, _, mine, error = many.T
    figure, (left, right) = pyplot.subplots(1, 2, figsize=(10, 3.6), layout="constrained")
    edges = np.linspace(min(pair.min(), mine.min()), max(pair.max(), mine.max()), 45) * 1e3
    left.hist(pair * 1e3, edges, color="#c44e52", alpha=0.8, label="pair objective, as published")
    left.hist(mine * 1e3, edges, color="#4c72b0", alpha=0.8, label="touched points as unknowns")
    left.axvline(0, color="black", lw=0.8)
    left.set(xlabel="arm too large by, 1e-3 of its lengths", ylabel="recordings of 100")
    left.legend(frameon=False, fontsize=8)
    right.hist(error, 25, color="#4c72b0", alpha=0.8)
    right.axvline(0.16, color="#c44e52", ls="--", label="paper, at the touched points")
    right.axvline(0.08, color="grey", ls=":", label="half of it")
    right.set(
        xlabel="rms error at places not touched, mm", ylabel="recordings of 100", xlim=(0, None)
    )
    right.legend(frameon=False, fontsize=8)
    figure.savefig(path, dpi=110)
