"""Text and picture of docs/gallery/poses-and-compensation.md, from the figures of gallery_use."""

import textwrap
from pathlib import Path

import numpy as np

from gallery_use import CHOSEN, DRAWS, EXPORTS, NOISE, POSES, USE, rms

_TEXT = """# Which poses to measure, and what a calibration is for

*This page and its numbers are written by `python tools/gallery_use.py`. The arm is that of
[Ye et al.](unified-kinematic-compliance.md), Sensors 2024, 24, 2559, by MuJoCo's statics with the 53 parameters that
the paper prints; a tracker measures one reflector with {noise} mm a coordinate.*

## Before measuring

300 poses that the arm can take, and a cell of some 100 mm in which its work will be. Which {chosen} of the 300 are
worth a tracker's time?

```sh
{poses}
```

{first}
| criterion | gain over random sets of {chosen} | processor seconds |
|---|---|---|
{gains}

D counts the volume of what stays uncertain, a parameter at a time: (det)^(1/F). `--criterion task` makes the predicted
error small at given poses. Measured so, with an arm whose lengths and angles alone are wrong: true error at 60 poses
of the cell, and of a box of 190 by 400 by 240 mm in its place (`cell` without `--cell`), RMS over {draws} draws of the
noise and of the random sets:

| set | cell, mm | box, mm |
|---|---|---|
{sets}

![Error in the cell by set of poses, and an arm before and after correction](poses-and-compensation.png)

The set for the cell is below random sets of twice its size in {wins} of {draws} draws, for the box in {wider_wins}.
Against as many random poses the choice pays; twice as many random ones it does not reliably replace on this arm.

## After measuring

```sh
{use}
```

{corrected}
`corrected.csv` holds the readings to send instead, how far each target is moved, what the inversion leaves (a
hundredth of a micrometre), and 1 sigma of the place that is left uncertain. A target out of reach gets no readings,
and the exit status is then 1. Sent to 100 other targets, over {arms} arms calibrated on 200 samples each (RMS of the
true error, mm):

| before | after | after / held-out error | after / held-out error without noise | sigma, predicted |
|---|---|---|---|---|
| {before:.3f} | {after:.4f} | {ratio:.2f} × (at most {worst:.2f}) | {free:.2f} × | {sigma:.4f} |

The held-out error holds the tracker's noise ({floor:.4f} mm), which the arm does not have. Without it, held-out and
corrected error are the same thing measured twice.

## For other programs

```sh
{exports}
```

Each file is read back and compared before it is kept: poses to 1e-6 mm, coefficients to 1e-9. What a format cannot say
is said instead:

```
{left}
```

A camera that is calibrated here always has a third radial term, which Kalibr's `radtan` lacks: it gets the nearest
camera without one, and is refused where that is off by more than 0.1 px. Nothing is written from a calibration that did
not converge, whose recording was in doubt, or that is no better than the nominal arm on unseen samples, unless
`--force` is given.
"""


def page(said, answers, gains, both, cases) -> str:
    """The page's text; both: errors in the cell and in the box; cases: a `gallery_use.Used` an arm."""
    errors, wider = both
    after = rms([rms(c.after) for c in cases])
    told, free = (rms([getattr(c, name) for c in cases]) for name in ("told", "free"))
    wins = [int((e[f"{CHOSEN} for the cell"] < e[f"{2 * CHOSEN} at random"]).sum()) for e in both]
    told_out = [" ".join(said[c].split("\n")[:-2]).replace("  ", " ") for c in EXPORTS if " export " in c]
    kept = [text.strip() for text in dict.fromkeys(told_out) if text.strip()]
    return _TEXT.format(
        noise=NOISE, chosen=CHOSEN, draws=DRAWS, arms=len(cases), floor=NOISE * np.sqrt(3),
        poses="\n".join(POSES), use="\n".join(USE), exports="\n".join(EXPORTS),
        left="\n".join(line for text in kept for line in textwrap.wrap(text, 116)),
        first=_first(answers), corrected=_corrected(answers["corrected"]),
        gains="\n".join(f"| {name} | {gain:.2f} × | {seconds:.1f} |" for name, gain, seconds in gains),
        sets="\n".join(f"| {name} | {rms(values):.4f} | {rms(wider[name]):.4f} |" for name, values in errors.items()),
        wins=wins[0], wider_wins=wins[1], before=rms([rms(c.before) for c in cases]), after=after,
        ratio=after / told, worst=max(rms(c.after) / c.told for c in cases), free=after / free,
        sigma=rms([c.sigma for c in cases]),
    )  # fmt: skip


def _first(answers) -> str:
    chosen, cell = answers["chosen"], answers["chosen-for-cell"]
    return (f"The first is {chosen['gain_over_random']:.2f} times better than the median of 200 random sets, the "
            f"second {cell['gain_over_random']:.2f} times.\nBoth name what even they leave open, "
            f"{len(chosen['undetermined'])} directions here. Scenes do as well as recordings; balls that\nthe sensor "
            "cannot see (`--stand-off`, `--field`, `--cap`), limits and collisions are left out.\n")  # fmt: skip


def _corrected(answer) -> str:
    moved = answer["correction_rms_mm"]
    return (f"{answer['reached']} of {answer['count']} targets are corrected, by {moved:.2f} mm RMS "
            f"at the flange; 1 sigma there is {answer['sigma_rms_mm']:.3f} mm.\n")  # fmt: skip


def picture(errors, case, path: Path) -> None:
    """Left: true error in the cell by set; right: one arm's targets before and after."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, (left, right) = pyplot.subplots(1, 2, figsize=(10, 3.6), layout="constrained")
    colours = ("#1f83c4", "#7fb6dc", "#b9bec4", "#8a9097")
    values = [v * 1e3 for v in errors.values()]
    boxes = left.boxplot(values, patch_artist=True, widths=0.6, medianprops={"color": "black"})
    for box, colour in zip(boxes["boxes"], colours):
        box.set_facecolor(colour)
    left.set_xticklabels([name.replace(" ", "\n", 1) for name in errors])
    left.set(ylabel="true error in the cell, µm RMS", ylim=(0, None))
    edges = np.geomspace(1, 1e3 * case.before.max() * 1.1, 40)
    right.hist(case.before * 1e3, edges, color="#b9bec4", label="sent as programmed")
    right.hist(case.after * 1e3, edges, color="#1f83c4", label="sent corrected")
    right.axvline(case.told * 1e3, color="#d9730d", ls="--", label="held-out RMS, with noise")
    right.set(xscale="log", xlabel="true error, µm", ylabel="targets of 100")
    right.legend(frameon=False, fontsize=8)
    for axes in (left, right):
        axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=110)
