"""Sections of the gallery page `unified` with the paper's statistics and figures: scanner, joint space, errors."""

from dataclasses import replace
from pathlib import Path

import numpy as np

import datasets
from datasets.makers import ye
from gallery_ye import EXPERIMENT, MODELS, NOISE, PAGE, PAPER, WIDE
from gallery_ye_scanner import EDGES_UM, RADII, deviations
from workbench.jobs.robot.calibrate import calibrate

_NAMES = {1: "first experiment", 2: "second, narrow box", WIDE: "second, wide box"}
_COLOURS = ("#777777", "#0072b2", "#d55e00", "#009e73")
_AXES = "xyz"
_BALL_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7")


def texts(made: dict, errors: dict, found: dict) -> dict:
    """What the page's text needs of these sections, by the name of its place there."""
    scanned = measured_by_the_scanner(found)
    centres = np.concatenate([rows["error_mm"] for rows in found["balls"].values()])
    forms = np.concatenate([rows["form_mm"] for rows in found["balls"].values()])
    return {
        "corner": found["scanner"]["corner_px"],
        "plane": found["scanner"]["planes_mm"],
        "form": np.sqrt(np.mean(forms**2)),
        "form_std": forms.std(ddof=1),
        "repeatability": repeatability(found),
        "spread": spread(made),
        "statistics": statistics(errors),
        "scanned": ", ".join(f"{rms:.4f} ({model})" for model, rms in scanned.items()),
        "share": PAPER[EXPERIMENT[1]]["check_mm"]["all"]["rms"] / rms_distance(centres.T),
    }


def recordings(folder: Path) -> dict:
    """Experiment -> recording that the page's commands wrote into a folder."""
    names = {1: "balls", 2: "tracker", WIDE: "tracker-wide"}
    return {number: datasets.read(folder / name) for number, name in names.items()}


def held_out_errors(made: dict) -> dict:
    """Experiment -> model -> (3, n) mm, errors of the samples that the first 100 do not fit."""
    return {k: _errors_of(recording) for k, recording in made.items()}


def _errors_of(recording) -> dict[str, np.ndarray]:
    ids = recording.sample_ids
    split = dict(fit_samples=ids[:100], test_samples=ids[100:])
    return {
        model: calibrate(recording, Path(plan), **split).held_out_residual[:3, 100:]
        for plan, model in MODELS.items()
    }


def measured_by_the_scanner(found: dict) -> dict[str, float]:
    """Model -> held-out RMS, mm, where the ball centres have the errors of the rendered scans instead of the noise."""
    recording = ye.ye_first_experiment(200, 1, 0.0).recording()
    errors = {ball: iter(rows["error_mm"]) for ball, rows in found["balls"].items()}
    added = np.array([next(errors[int(ball)]) for ball in recording.columns["ball"]])
    columns = dict(recording.columns)
    for axis, error in zip(_AXES, added.T):
        columns[f"{axis}_mm"] = columns[f"{axis}_mm"] + error
    sigma = float(np.sqrt((added**2).mean()))
    made = replace(recording, columns=columns, sigma_mm=sigma, name="balls")
    return {model: rms_distance(error) for model, error in _errors_of(made).items()}


def rms_distance(errors: np.ndarray) -> float:
    """RMS of the 3-D distances of errors (3, n)."""
    return float(np.sqrt((errors**2).sum(0).mean()))


def statistics(errors: dict) -> str:
    """RMS, standard deviation, mean and largest 3-D error of each model, published and reached: Tables 5 and 8."""
    lines = [
        "| experiment | model | RMS | Std | Avg | Max | published: RMS | Std | Avg | Max |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for k, models in errors.items():
        table = PAPER[EXPERIMENT[2 if k == WIDE else k]]["check_mm"]
        for model, error in models.items():
            distance = np.linalg.norm(error, axis=0)
            own = (rms_distance(error), distance.std(), distance.mean(), distance.max())
            printed = [table[model][key] for key in ("rms", "std", "mean", "max")]
            cells = " | ".join(f"{value:.4f}" for value in (*own, *printed))
            lines.append(f"| {_NAMES[k]} | {model} | {cells} |")
    return "\n".join(lines)


def spread(made: dict) -> str:
    """Range and standard deviation of each joint's readings, deg."""
    lines = [
        "| recording | samples | " + " | ".join(f"joint {j}" for j in range(1, 7)) + " |",
        "|---|---|" + "---|" * 6,
    ]
    for k, recording in made.items():
        degrees = np.rad2deg(recording.joints)
        ranges = [f"{np.ptp(column):.0f} ({column.std():.0f})" for column in degrees.T]
        lines.append(f"| {_NAMES[k]} | {recording.n} | {' | '.join(ranges)} |")
    return "\n".join(lines)


def repeatability(found: dict) -> str:
    """Standard deviation of each ball's centre per axis and in space, um, its form, and the stated uncertainty."""
    lines = [
        "| ball | certified radius, mm | scans | std x, µm | y | z | in space | stated, in space "
        "| mean error, in space | form RMS | radius error, mean ± std |",
        "|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    for (ball, rows), deviation in zip(found["balls"].items(), deviations(found["balls"])):
        stated = 1e3 * np.sqrt((np.array(rows["std_mm"]) ** 2).sum(1).mean())
        offset = 1e3 * np.linalg.norm(np.mean(rows["error_mm"], axis=0))
        form = 1e3 * np.sqrt(np.mean(np.square(rows["form_mm"])))
        mean, std = radius_errors(rows)
        cells = [f"{value:.2f}" for value in (*deviation, stated, offset)]
        lines.append(
            f"| {ball} | {RADII[int(ball)]:.3f} | {len(rows['form_mm'])} | {' | '.join(cells)} | {form:.1f} "
            f"| {mean:+.1f} ± {std:.1f} |"
        )
    return "\n".join(lines)


def radius_errors(rows: dict) -> tuple[float, float]:
    """Mean and standard deviation, um, of the radius errors of all points of a ball, from their histogram."""
    counts = np.sum(rows["histogram"], axis=0)
    middles = (EDGES_UM[1:] + EDGES_UM[:-1]) / 2
    mean = np.average(middles, weights=counts)
    return float(mean), float(np.sqrt(np.average((middles - mean) ** 2, weights=counts)))


def draw_all(made: dict, errors: dict, found: dict) -> None:
    """The images next to the page."""
    draw_scanner(found, PAGE.with_name("unified-scanner.png"))
    draw_joints(made, PAGE.with_name("unified-joints.png"))
    for k, name in ((1, "unified-errors.png"), (WIDE, "unified-errors-tracker.png")):
        draw_errors(errors[k], NOISE[2 if k == WIDE else k], PAGE.with_name(name))


def draw_scanner(found: dict, path: Path) -> None:
    """Left: centre errors of each ball per axis, scan by scan; right: radius errors of all points (Figure 10)."""
    figure, (left, right) = _subplots(1, 2, (10, 3.8))
    middles = (EDGES_UM[1:] + EDGES_UM[:-1]) / 2
    for colour, (ball, rows) in zip(_BALL_COLOURS, found["balls"].items()):
        errors = 1e3 * np.array(rows["error_mm"])
        places = int(ball) - 2.5 + np.random.default_rng(0).uniform(-0.3, 0.3, len(errors))
        for axis in range(3):
            label = f"ball {ball}" if axis == 0 else None
            left.plot(5 * axis + places, errors[:, axis], ".", color=colour, ms=4, label=label)
        counts = np.sum(rows["histogram"], axis=0)
        right.step(middles, counts / counts.sum(), where="mid", color=colour, label=f"ball {ball}")
    left.set_xticks([0, 5, 10], list(_AXES))
    left.set(xlabel="coordinate in the camera frame", ylabel="error of the ball centre (µm)")
    right.set(xlabel="radius error of a point (µm)", ylabel="share of the points")
    left.legend(frameon=False, fontsize=8, ncols=4, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    figure.savefig(path, dpi=110)


def draw_joints(made: dict, path: Path) -> None:
    """Spread of the samples in joint space: joints 1 to 3 above, 4 to 6 below (Figure 14), the third as colour."""
    figure, axes = _subplots(2, len(made), (11, 6.5))
    for column, (k, recording) in enumerate(made.items()):
        degrees = np.rad2deg(recording.joints)
        chosen = degrees[:: max(1, len(degrees) // 1500)]
        for row, first in enumerate((0, 3)):
            x, y, colour = chosen[:, first : first + 3].T
            one = axes[row, column]
            shown = one.scatter(x, y, c=colour, s=4)
            one.set(xlabel=f"joint {first + 1} (deg)", ylabel=f"joint {first + 2} (deg)")
            figure.colorbar(shown, ax=one, label=f"joint {first + 3} (deg)")
        axes[0, column].set_title(_NAMES[k], fontsize=10)
    figure.savefig(path, dpi=110)


def draw_errors(errors: dict[str, np.ndarray], noise_mm: float, path: Path) -> None:
    """The panels of Figures 11 and 15: errors by sample, their distribution, by direction, and as violins."""
    figure, axes = _subplots(2, 2, (10, 7))
    distances = {model: np.linalg.norm(error, axis=0) for model, error in errors.items()}
    edges = np.linspace(0, max(one.max() for one in distances.values()), 40)
    for colour, (model, distance) in zip(_COLOURS, distances.items()):
        if model in ("MDH", "all"):
            chosen = distance[:: max(1, len(distance) // 400)]
            axes[0, 0].plot(np.arange(1, len(chosen) + 1), chosen, ".", color=colour, label=model)
        axes[0, 1].hist(distance, edges, histtype="step", color=colour, label=model)
        axes[1, 0].plot(list(_AXES), errors[model].std(1), "o-", color=colour, label=model)
    axes[1, 0].axhline(noise_mm, color="black", ls=":", label="noise")
    axes[1, 1].violinplot(list(distances.values()), showmeans=True)
    axes[1, 1].set_xticks(range(1, len(distances) + 1), list(distances))
    axes[0, 0].set(xlabel="held-out sample", ylabel="3-D error (mm)")
    axes[0, 1].set(xlabel="3-D error (mm)", ylabel="number of samples")
    axes[1, 0].set(
        xlabel="coordinate", ylabel="standard deviation of the error (mm)", ylim=(0, None)
    )
    axes[1, 1].set(xlabel="model", ylabel="3-D error (mm)", ylim=(0, None))
    for one in axes.flat[:3]:
        one.legend(frameon=False, fontsize=8)
    figure.savefig(path, dpi=110)


def _subplots(rows: int, columns: int, size: tuple[float, float]):
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    return pyplot.subplots(rows, columns, figsize=size, layout="constrained")
