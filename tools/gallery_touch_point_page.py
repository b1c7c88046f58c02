"""Text and image of docs/gallery/touch-point.md, from the figures of gallery_touch_point."""

from pathlib import Path

import numpy as np
from scipy.stats import wilcoxon

import gallery_touch_point as figures
from datasets.makers import gubankov

_TEXT = """# Calibration by touching points, without an instrument (Gubankov 2022)

Gubankov & Yukhimets, Sensors 2022, 22, 3376. A sharp tip on the flange touches a few fixed points in many
orientations. The positions of the points are unknown; only joint readings are recorded. `python tools/gallery.py
touch-point` writes this page. The recordings are simulated from the tables of the paper by
`datasets/makers/gubankov.py`, which shares no code with the calibration. It also documents which minus signs are
missing in the available copy of the tables, and how they were restored.

```sh
python -m datasets.makers.gubankov touches --driving-error 0.16
workbench calibrate touches --out touches-result
python -m datasets.makers.gubankov touches-ur10e --arm ur10e --driving-error 0.16
workbench calibrate touches-ur10e --out touches-ur10e-result
```

![Scale error of the arm, and error at positions that were not touched](touch-point.png)

## RV-2FB, series of 21, 21, 18 and 11 touches

{rv2fb}

*Ours*: the touched points are estimated, and each touch is weighted by its positioning error. Touches contain no
information on the scale of the arm. One length is therefore fixed during the fit; then all lengths are scaled to agree
best with the nominal lengths. *Their method*: equations 7 and 12 to 17, with theta1 and d1 as printed, that is,
unchanged.

- **Without positioning errors** both methods are exact except for the scale of the arm. After correction of the scale
  our error is {exact:.0e} mm. The error before depends on chance: the parameter errors of this arm nearly keep the
  nominal scale ({size:+.1e}). The published 0.016 mm has the same reason and is not the accuracy of the method.
- **With positioning errors** the 0.16 mm of the paper refer to the touched points. At other positions our error is
  {error:.3f} mm RMS over 100 recordings ({times:.1f} times smaller), {worst:.3f} mm in the worst recording; the table
  contains the maxima. The height of the arm (d1) and its rotation about the vertical (theta1) are removed, because the
  data do not determine them. Without this removal (first rows of each block) the error is about as large as in the
  paper: 71 touches at one height do not determine the height.
- **The pair objective shrinks the arm.** It decreases if all lengths decrease. Over 100 recordings its main lengths
  are too small by {shrunk:.1e} (ours: {kept:+.1e}; scale of the nominal lengths: {size:+.1e}; paired Wilcoxon test
  that theirs is smaller: p = {p:.0e}; ours has the scale of the nominal lengths by construction, for any noise). These
  figures use the early stop that reproduces the figures of the paper. If the iteration continues until J decreases by
  less than 0.001 mm², the arm shrinks to {gone:.0%} of its size. Excluding pairs whose distance exceeds the
  positioning error does not help, since the objective itself is the reason.

The range of orientations is not stated in the paper; its initial J (728) indicates a small range. The range has
more influence than the method. The figures above use 80 degrees; this value was selected with knowledge of the
following table:

{sweep}

If the tool is tilted by at most 25 degrees, both methods have errors above 0.16 mm: these touches contain too little
information, and the pair objective shrinks the arm despite the early stop.

## Parameters that are not identifiable

Output of the program, computed from the null space of this recording:

{words}

## UR10e, three series of 21

Truth: the parameters that the paper identified. {ur_note}

{ur10e}

The two published figures are inconsistent: J is a sum of squares. If it decreases by a factor of 39, distances
decrease by √39 = 6.2 and not by more than ten. The rows above are consistent. Positioning errors slightly above 0.26
mm would result in the published decrease of J, and in 6.2; with up to 0.16 mm, the value that the paper states
elsewhere, distances decrease by more than ten and J by more than a hundred. In every row the final J is that of the
positioning errors.

## Comparison with a laser tracker (table 1, real data)

{registration}

The least-squares rigid transform gives the published figures to the last digit. ICP gives the same result, since the
nearest point is always the correct one if points are 300 mm apart.
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
        "| tool tilts by up to | J at the start, mm² | ours, RMS, mm | their method, RMS, mm |",
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
