"""Text and image of docs/gallery/poses-and-compensation.md, from the figures of gallery_use."""

import textwrap
from pathlib import Path

import numpy as np

from gallery_use import CHOSEN, DRAWS, EXPORTS, NOISE, POSES, TASKS, USE, rms

_TEXT = """# Choosing measurement poses, and correcting a robot program

*`python tools/gallery.py poses-and-compensation` writes this page and its numbers. The arm is that of [Ye et
al.](unified-kinematic-compliance.md), Sensors 2024, 24, 2559, simulated with MuJoCo statics and the 53 parameters of
the paper. A tracker measures one reflector with a noise of {noise} mm per coordinate.*

## Before measuring

The arm can take 300 poses. Which {chosen} of them should be measured?

```sh
{poses}
```

{first}
| criterion | gain over random sets of {chosen} |
|---|---|
{gains}

D is the volume of the confidence ellipsoid per parameter: (det)^(1/F).

### Poses for one task

`--criterion task` minimises the predicted error at given poses, here those of a cell of about 100 mm. Candidates are
only computed, so that thousands of them are possible.

```sh
{tasks}
```

Output of the first of these two commands:

```
{anywhere}
```

and of the second:

```
{upright}
```

The last row of each is a lower bound. The error is a convex function of the measurement time of each candidate, and
the tangent plane at the optimum is below every set of {chosen} (equivalence theorem of optimal design). In every row
below the selected poses are within {slack:.1f} % of the bound, so that a better search could not gain more than this.

The next table contains true errors of an arm with errors of lengths and angles only: in the cell, and in a box of 190
x 400 x 240 mm at the same position (`cell` without `--cell`). They are RMS values in mm over {draws} draws of the
noise and of the random sets, ± the standard error; predicted values are in brackets.

| candidates | tasks | {chosen} for the tasks | {twice} at random | lower bound for any {chosen} | better in |
|---|---|---|---|---|---|
{sets}

![Error in the cell by set of poses, and an arm before and after correction](poses-and-compensation.png)

According to the prediction, {chosen} selected poses are better than {twice} random ones in {where}; the measured
difference exceeds two standard errors in {clearly} of them. The selection therefore replaces twice as many
measurements if the candidates are numerous and differ in position and orientation. The benefit is smaller for a wider
range of tasks. If the tool is always upright, the candidates are too similar, and no search would help: the ratio of
the bound to {twice} random poses is {short}. `--repeats` permits repeated measurements of one pose. This is useful
with few candidates and independent noise of each measurement. The result of a single recording can deviate in both
directions, because of its noise; the prediction is the RMS over recordings.

## After measuring

```sh
{use}
```

{corrected}
`corrected.csv` contains the readings to send, the correction of each target, the inverse-kinematics residual (0.01
µm), and the standard uncertainty of the position. A target that is out of reach or whose correction is implausible has
no readings, and the exit status is then 1. The following errors are those of 100 other targets, over {arms} arms that
were calibrated with 200 samples each (RMS of the true error, mm):

| before | after | after / held-out error | after / held-out error without noise | sigma, predicted |
|---|---|---|---|---|
| {before:.3f} | {after:.4f} | {ratio:.2f} × (at most {worst:.2f}) | {free:.2f} × | {sigma:.4f} |

The held-out error contains the noise of the tracker ({floor:.4f} mm), which is not an error of the arm. Without this
noise, held-out error and error after correction are equal.

## Export to other programs

```sh
{exports}
```

Each file is read back and compared with the model: poses to 1e-6 mm, coefficients to 1e-9. The command states what a
format cannot contain:

```
{left}
```

A camera of `workbench camera` always has a third radial coefficient, which Kalibr's `radtan` lacks. The export fits
the nearest camera without it, and refuses if the difference exceeds 0.1 px. Without `--force`, a calibration is not
exported if it did not converge, if its recording is implausible, or if it is not better than the nominal arm on
held-out samples.
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
        f"The selected poses are {chosen['gain_over_random']:.2f} times better than the median of 200 random sets. "
        f"The command\nlists {len(chosen['undetermined'])} combinations of parameters that are not identifiable with "
        "them. It accepts scenes as well as\nrecordings. It excludes poses beyond the joint limits, with collisions, "
        "or in which the sensor does not see the ball\n(`--stand-off`, `--field`, `--cap`).\n"
    )


def _corrected(answer) -> str:
    moved = answer["correction_rms_mm"]
    return (
        f"{answer['reached']} of {answer['count']} targets are corrected, by {moved:.2f} mm RMS "
        f"at the flange, with a standard uncertainty of {answer['sigma_rms_mm']:.3f} mm.\n"
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
