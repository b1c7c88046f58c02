"""Text and image of docs/gallery/poses-and-compensation.md, from the figures of gallery_use."""

import textwrap
from pathlib import Path

import numpy as np

from gallery_use import CHOSEN, DRAWS, EXPORTS, NOISE, POSES, TASKS, USE, rms

_TEXT = """# Which poses to measure, and what a calibration is for

*This page and its numbers are written by `python tools/gallery.py poses-and-compensation`. The arm is that of
[Ye et al.](unified-kinematic-compliance.md), Sensors 2024, 24, 2559, by MuJoCo's statics with the 53 parameters that
the paper prints; a tracker measures one reflector with {noise} mm a coordinate.*

## Before measuring

300 poses that the arm can take. Which {chosen} of them are worth a tracker's time?

```sh
{poses}
```

{first}
| criterion | gain over random sets of {chosen} |
|---|---|
{gains}

D counts the volume of what stays uncertain, a parameter at a time: (det)^(1/F).

### For the work of one cell

`--criterion task` makes the predicted error small at given poses: here those of a cell of some 100 mm. Candidates cost
nothing, as they are only computed, so there may be thousands of them.

```sh
{tasks}
```

The first of these two choices says

```
{anywhere}
```

and the second

```
{upright}
```

The last row of each is a bound: the error is convex in the shares of time that candidates get, and the tangent plane at
the best shares lies below every set of {chosen} (the equivalence theorem of optimal design). What is chosen is within
{slack:.1f} % of it in every row below, so that no better search could save more than that.

Measured, with an arm whose lengths and angles alone are wrong: true error in the cell, and in a box of 190 by 400 by
240 mm in its place (`cell` without `--cell`), mm RMS over {draws} draws of the noise and of the random sets, ± the
standard error of that; in brackets what was predicted.

| candidates | tasks | {chosen} for the tasks | {twice} at random | lower bound for any {chosen} | better in |
|---|---|---|---|---|---|
{sets}

![Error in the cell by set of poses, and an arm before and after correction](poses-and-compensation.png)

By what is predicted {chosen} chosen poses are better than {twice} random ones in {where}; measured,
in {clearly} by more than two standard errors. The choice therefore replaces twice as many measurements
if candidates differ in their information on the tasks: in position and orientation, and in large numbers.
The wider the tasks, the less it saves. With the tool always upright the candidates are too similar, and
no search would help: relative to {twice} at random, the bound is {short}.
`--repeats` lets one pose be measured several times, which pays where candidates are few and the noise of each
measurement is its own. A single draw may go either way, since the noise of one calibration is luck; what is predicted
is the RMS over draws.

## After measuring

```sh
{use}
```

{corrected}
`corrected.csv` holds the readings to send instead, how far each target is moved, the inverse-kinematics residual (a
hundredth of a micrometre), and 1 sigma of the place that is left uncertain. A target that is out of reach, or whose
correction is refused as implausible, gets no readings, and the exit status is then 1. Sent to 100 other targets, over
{arms} arms calibrated on 200 samples each (RMS of the true error, mm):

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


def page(said, answers, gains, pools, cases) -> str:
    """The page's text; pools: name -> a `gallery_use.Pool` in the cell and one in the box; cases: a `Used` an arm."""
    after = rms([rms(c.after) for c in cases])
    held_out = rms([case.held_out for case in cases])
    free = rms([case.free for case in cases])
    printed = [
        " ".join(said[c].split("\n")[:-2]).replace("  ", " ") for c in EXPORTS if " export " in c
    ]
    kept = [text.strip() for text in dict.fromkeys(printed) if text.strip()]
    return _TEXT.format(
        noise=NOISE,
        chosen=CHOSEN,
        draws=DRAWS,
        arms=len(cases),
        floor=NOISE * np.sqrt(3),
        poses="\n".join(POSES),
        tasks="\n".join(TASKS),
        use="\n".join(USE),
        exports="\n".join(EXPORTS),
        twice=2 * CHOSEN,
        left="\n".join(line for text in kept for line in textwrap.wrap(text, 116)),
        first=_first(answers),
        corrected=_corrected(answers["corrected"]),
        gains="\n".join(f"| {name} | {gain:.2f} × |" for name, gain in gains),
        before=rms([rms(c.before) for c in cases]),
        after=after,
        ratio=after / held_out,
        worst=max(rms(c.after) / c.held_out for c in cases),
        free=after / free,
        **_pools(said, pools),
        sigma=rms([c.sigma for c in cases]),
    )


def _pools(said, pools) -> dict:
    """Text on the sets that are chosen for tasks."""
    every = [
        (name, tasks, pool)
        for name, both in pools.items()
        for tasks, pool in zip(("cell", "box"), both)
    ]
    predicted = [pool.chosen.predicted() for *_, pool in every]
    beaten = [error for error in predicted if error["chosen_mm"] < error["random_twice_mm"]]
    clearly = [
        pool for *_, pool in every if _clearly(*list(pool.errors.values())[:: len(pool.errors) - 1])
    ]
    over = [
        f"{error['bound_mm'] / error['random_twice_mm']:.3f} in the {tasks}"
        for (name, tasks, _), error in zip(every, predicted)
        if name.endswith("upright")
    ]
    return {
        "sets": "\n".join(_row(*row) for row in every),
        "where": f"{len(beaten)} of the {len(every)} rows",
        "clearly": str(len(clearly)),
        "anywhere": _predicted(said[TASKS[-2]]),
        "upright": _predicted(said[TASKS[-1]]),
        "short": " and ".join(over),
        "slack": 100 * max(error["chosen_mm"] / error["bound_mm"] - 1 for error in predicted),
    }


def _row(name, tasks, pool) -> str:
    predicted, errors = pool.chosen.predicted(), list(pool.errors.values())
    mine, twice = errors[0], errors[-1]
    cells = [
        f"{rms(e):.4f} ± {spread(e):.4f} ({predicted[key]:.4f})"
        for e, key in ((mine, "chosen_mm"), (twice, "random_twice_mm"))
    ]
    wins = f"{int((mine < twice).sum())} of {len(mine)}"
    return f"| {name} | {tasks} | {' | '.join(cells)} | {predicted['bound_mm']:.4f} | {wins} |"


def _clearly(mine, twice) -> bool:
    """Whether the first RMS is below the second by more than two standard errors of the difference."""
    return rms(twice) - rms(mine) > 2 * np.hypot(spread(mine), spread(twice))


def spread(values) -> float:
    """Standard error of the RMS of some values."""
    return float(np.std(values**2, ddof=1) / np.sqrt(len(values)) / 2 / rms(values))


def _predicted(text: str) -> str:
    """What the command says of the predicted error."""
    lines = [line.rstrip() for line in text.splitlines()]
    first = next(i for i, line in enumerate(lines) if line.startswith("Predicted"))
    last = next(
        i
        for i, line in enumerate(lines)
        if line.startswith(("Excluded candidates", "Not identifiable", "All parameters"))
    )
    return "\n".join(line for line in lines[first:last] if line)


def _first(answers) -> str:
    chosen = answers["chosen"]
    return (
        f"It is {chosen['gain_over_random']:.2f} times better than the median of 200 random sets, and names what "
        f"even it leaves open,\n{len(chosen['undetermined'])} directions here. Scenes do as well as recordings; "
        "balls that the sensor cannot see (`--stand-off`,\n`--field`, `--cap`), limits and collisions are left "
        "out.\n"
    )


def _corrected(answer) -> str:
    moved = answer["correction_rms_mm"]
    return (
        f"{answer['reached']} of {answer['count']} targets are corrected, by {moved:.2f} mm RMS "
        f"at the flange; 1 sigma there is {answer['sigma_rms_mm']:.3f} mm.\n"
    )


def draw_image(pools, case, path: Path) -> None:
    """Left: true error in the cell by set, of two kinds of candidates; right: one arm's targets before and after."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, (left, middle, right) = pyplot.subplots(
        1, 3, figsize=(13, 3.6), layout="constrained", width_ratios=(1, 1, 1.2)
    )
    top = 1.2e3 * max(values.max() for pool in pools for values in pool.errors.values())
    for axes, pool, title in zip(
        (left, middle), pools, ("3000 candidates anywhere", "300 with the tool upright")
    ):
        _boxes(axes, pool, top)
        axes.set_title(title, fontsize=10)
    left.set_ylabel("true error in the cell by draw, µm")
    edges = np.geomspace(1, 1e3 * case.before.max() * 1.1, 40)
    right.hist(case.before * 1e3, edges, color="#b9bec4", label="sent as programmed")
    right.hist(case.after * 1e3, edges, color="#1f83c4", label="sent corrected")
    right.axvline(case.held_out * 1e3, color="#d9730d", ls="--", label="held-out RMS, with noise")
    right.set(xscale="log", xlabel="true error, µm", ylabel="targets of 100")
    right.legend(frameon=False, fontsize=8)
    for axes in (left, middle, right):
        axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=110)


def _boxes(axes, pool, top) -> None:
    """Of every set the errors by draw, and the least that could be predicted of as many chosen."""
    values = [v * 1e3 for v in pool.errors.values()]
    boxes = axes.boxplot(
        values, patch_artist=True, widths=0.6, medianprops={"color": "black"}, flierprops={"ms": 3}
    )
    for box, colour in zip(boxes["boxes"], ("#1f83c4", "#7fb6dc", "#b9bec4", "#8a9097")):
        box.set_facecolor(colour)
    bound = 1e3 * pool.chosen.predicted()["bound_mm"]
    axes.axhline(bound, color="#d9730d", ls="--", label=f"least RMS that any {CHOSEN} could have")
    axes.legend(frameon=False, fontsize=8, loc="upper left")
    axes.set_xticklabels([name.replace(" ", "\n", 1) for name in pool.errors], fontsize=8)
    axes.set_ylim(0, top)
