"""Charts on pages of docs/: each is computed from runs of the workbench or from the tables of the page."""

import csv
import re
import shutil
from collections.abc import Callable
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pandas
from matplotlib.figure import Figure

import workbench

DOCS = Path(__file__).resolve().parents[1] / "docs"
IMAGES = DOCS / "images"
GEOMETRY = """[[stage]]
name = "geometry"
why = "lengths, twists and zero offsets differ from the data sheet"
free = ["base.*", "tool.*", "joint-*.*"]
earn = false
"""
BLUE, ORANGE, GREY = "#1565c0", "#e07b00", "#90a4ae"


def axes_of(width: float, height: float):
    """A figure and its axes in the style of the site; sizes in inches."""
    figure = Figure(figsize=(width, height), facecolor="white", layout="constrained")
    axes = figure.add_subplot()
    axes.spines[["top", "right"]].set_visible(False)
    return figure, axes


def save(figure, name: str) -> None:
    """The figure as docs/images/NAME.png."""
    figure.savefig(IMAGES / f"{name}.png", dpi=110)


@cache
def calibrated():
    """The example `elastic-arm`, calibrated with the default plan."""
    return workbench.calibrate(workbench.load_example("elastic-arm"))


def plan_stages() -> None:
    """Held-out error of each stage of the default plan, and whether it was retained."""
    stages = calibrated().answer["stages"]
    names = [stage["name"] for stage in stages]
    errors = [stage["held_out_rms_mm"] for stage in stages]
    colours = [BLUE if stage["earned"] else GREY for stage in stages]
    figure, axes = axes_of(7.5, 2.9)
    bars = axes.barh(names, errors, color=colours)
    axes.bar_label(bars, [f"{value:.3f}" for value in errors], padding=4)
    axes.invert_yaxis()
    axes.set(xlabel="held-out RMS error (mm)", xlim=(0, 1.15 * max(errors)))
    axes.set_title("elastic-arm: retained stages blue, tested and not retained grey", size=10.5)
    save(figure, "plan-stages")


def held_out() -> None:
    """Error of the fit and held-out error against the number of samples, geometry alone."""
    recording = workbench.load_example("elastic-arm")
    counts = [20, 30, 45, 70, 110, 180, 300]
    fit, out = zip(*(_geometry_errors(recording, count) for count in counts))
    figure, axes = axes_of(7.5, 3.3)
    axes.loglog(counts, out, "o-", color=ORANGE, label="held-out samples")
    axes.loglog(counts, fit, "o-", color=BLUE, label="fitted samples")
    axes.set_xticks(counts, [str(count) for count in counts])
    axes.minorticks_off()
    axes.set(xlabel="number of samples", ylabel="RMS error (mm)")
    axes.set_yticks([0.05, 0.1, 0.2], ["0.05", "0.1", "0.2"])
    axes.set_title("elastic-arm, 36 parameters of the geometry", size=10.5)
    axes.legend(frameon=False)
    save(figure, "held-out-error")


def _geometry_errors(recording, count: int) -> tuple[float, float]:
    rows = np.linspace(0, recording.n - 1, count).round().astype(int)
    made = _calibrated_geometry(lambda samples: samples.iloc[rows], folds=5)
    return made.fit.rms_mm, made.held_out.rms_mm


def _calibrated_geometry(change: Callable[[pandas.DataFrame], pandas.DataFrame], folds: int):
    """Calibration of the geometry of `elastic-arm` with a change of its samples."""
    with TemporaryDirectory() as folder:
        place = Path(folder) / "recording"
        shutil.copytree(workbench.load_example("elastic-arm").folder, place)
        samples = pandas.read_csv(place / "samples.csv")
        change(samples).to_csv(place / "samples.csv", index=False)
        plan = Path(folder) / "plan.toml"
        plan.write_text(GEOMETRY, encoding="utf-8")
        return workbench.calibrate(place, plan=plan, folds=folds)


def uncertainty() -> None:
    """Errors of parameters over their stated standard uncertainty, in simulated recordings of known geometry."""
    pulls = np.concatenate([_pulls(seed) for seed in range(40)])
    figure, axes = axes_of(7.5, 3)
    grid = np.linspace(-4, 4, 200)
    axes.hist(
        pulls, np.linspace(-4, 4, 33), density=True, color=BLUE, alpha=0.6, label="parameters"
    )
    normal = np.exp(-(grid**2) / 2) / np.sqrt(2 * np.pi)
    axes.plot(grid, normal, color=ORANGE, label="standard normal distribution")
    axes.set(xlabel="error of the estimate / stated standard uncertainty", ylabel="density")
    inside = (np.abs(pulls) < 1).mean()
    axes.set_title(
        f"40 simulated recordings: {inside:.0%} within one standard uncertainty", size=10.5
    )
    axes.legend(frameon=False)
    save(figure, "uncertainty")


def _pulls(seed: int) -> np.ndarray:
    """(k,) of the geometry parameters that a simulated recording of a nominal arm determines."""
    reflectors = [[30.0, -40.0, 100.0], [-50.0, 20.0, 80.0], [10.0, 60.0, 130.0]]
    scene = {"robot": "abb_irb120", "measures": "external-point", "samples": 60, "seed": seed}
    recording = _simulated({**scene, "sigma_mm": 0.05, "reflectors": reflectors})
    with TemporaryDirectory() as folder:
        plan = Path(folder) / "plan.toml"
        plan.write_text(GEOMETRY, encoding="utf-8")
        table = workbench.calibrate(recording, plan=plan, folds=2).parameters.to_frame()
    known = table[(table["status"] == "estimated") & table["where"].str.startswith("joint")]
    return (known["deviation"] / known["std"]).to_numpy(float)


def excluded() -> None:
    """Errors of the samples when three measured positions are wrong, and the samples that the fit names."""
    made = _calibrated_geometry(_with_wrong_positions, folds=10)
    table = made.residuals.to_frame()
    size = np.linalg.norm(table.filter(regex="^fit_._mm"), axis=1)
    named = np.isin(table["sample"], made.answer["suspect_samples"])
    figure, axes = axes_of(7.5, 3)
    axes.semilogy(table["sample"][~named], size[~named], ".", color=BLUE)
    axes.semilogy(table["sample"][named], size[named], "o", color=ORANGE, label="suspect_samples")
    axes.set(xlabel="sample", ylabel="error of the fit (mm)")
    axes.set_title("elastic-arm with three wrong positions: samples 41, 151 and 236", size=10.5)
    axes.legend(frameon=False)
    save(figure, "excluded-samples")


def _with_wrong_positions(samples: pandas.DataFrame) -> pandas.DataFrame:
    wrong = samples.copy()
    errors = [[0.9, 0, 0], [0, -1.4, 0], [0.7, 0.7, 0.7]]
    wrong.loc[[40, 150, 235], ["x_mm", "y_mm", "z_mm"]] += np.array(errors)
    return wrong


def corrections() -> None:
    """Correction of each target and its standard uncertainty."""
    recording = workbench.load_example("elastic-arm")
    frame = {f"q{k + 1}_deg": np.rad2deg(q) for k, q in enumerate(recording.joints[:30].T)}
    frame |= {name: value[:30] for name, value in recording.covariates.items()}
    made = calibrated().compensate(pandas.DataFrame(frame)).table("corrected")
    number = np.arange(1, len(made) + 1)
    figure, axes = axes_of(7.5, 3)
    axes.bar(number, made["correction_mm"], color=BLUE, label="correction_mm")
    axes.bar(number, made["sigma_mm"], color=ORANGE, label="sigma_mm")
    axes.set(yscale="log", xlabel="target", ylabel="mm", ylim=(0.01, 20))
    axes.set_title("elastic-arm: correction of 30 targets and its standard uncertainty", size=10.5)
    axes.legend(frameon=False, ncols=2, loc="upper right")
    save(figure, "corrections")


def effect_of_a_load() -> None:
    """Displacement of the reflector by the effect that docs/how-to/add-an-effect.md defines, against payload.

    The noise has the same seed with and without the effect and cancels in the difference.
    """
    from robot_model.effects import CATALOGUE

    CATALOGUE["payload-bump"] = _effect_of_the_page()
    effect = {"effect": "payload-bump", "where": "joint-3", "values": {"per_kg": 1e-4}}
    scene = {
        "robot": "abb_irb120",
        "measures": "external-point",
        "samples": 200,
        "seed": 6,
        "payload_kg": [0.0, 3.0],
        "reflectors": [[30.0, -40.0, 100.0]],
    }
    plain = _simulated(scene)
    moved = np.linalg.norm(_simulated({**scene, "effect": [effect]}).points - plain.points, axis=1)
    figure, axes = axes_of(7.5, 3)
    reach = np.linalg.norm(plain.points[:, :2], axis=1)
    dots = axes.scatter(plain.covariates["payload_kg"], moved, c=reach, s=14, cmap="viridis")
    figure.colorbar(dots, label="distance from axis 1 (mm)")
    axes.set(xlabel="payload (kg)", ylabel="displacement (mm)", ylim=(0, None))
    axes.set_title("payload-bump at joint 3, 0.0001 rad/kg: 200 simulated poses", size=10.5)
    save(figure, "effect-of-a-load")


def _effect_of_the_page():
    """The class of the first block of code of the page."""
    from workbench.core.effect import Effect

    text = (DOCS / "how-to" / "add-an-effect.md").read_text(encoding="utf-8")
    code = re.search(r"```python\n(.*?)```", text, re.DOTALL)[1]
    names = {"Effect": Effect}
    exec(compile(code, "add-an-effect.md", "exec"), names)
    return names["PayloadBump"]


def _simulated(scene: dict):
    import tomli_w

    from workbench.jobs.robot.simulate import simulate

    with TemporaryDirectory() as folder:
        file = Path(folder) / "scene.toml"
        file.write_text(tomli_w.dumps(scene), encoding="utf-8")
        return simulate(file)


def real_recordings() -> None:
    """Held-out errors on real arms, from the table of the page."""
    text = (DOCS / "reference" / "real-recordings.md").read_text(encoding="utf-8")
    found = re.findall(r"^\| `([\w:]+)`[^|]*\|([^|]+)\|([^|]+)\|([^|]+)\|", text, re.MULTILINE)
    rows = [(name, [_number(cell) for cell in cells]) for name, *cells in found]
    rows = [(name, values) for name, values in rows if None not in values]
    rows = list({name: (name, values) for name, values in reversed(rows)}.values())[::-1]
    figure, axes = axes_of(8.5, 3.6)
    kinds = ("base and tool only", "geometry", "result")
    for shift, (kind, colour) in enumerate(zip(kinds, (GREY, ORANGE, BLUE))):
        heights = [values[shift] for _, values in rows]
        axes.bar(np.arange(len(rows)) + 0.27 * (shift - 1), heights, 0.26, label=kind, color=colour)
    axes.set_xticks(range(len(rows)), [name.replace(":", ":\n") for name, _ in rows], size=8)
    axes.set(yscale="log", ylabel="held-out RMS 3-D error (mm)")
    axes.legend(frameon=False)
    save(figure, "real-recordings")


def _number(cell: str) -> float | None:
    found = re.search(r"\d+\.\d+", cell)
    return float(found[0]) if found else None


def benchmarks() -> None:
    """Time of the peer over ours, from the table of the page; 1 is equal."""
    text = (DOCS / "reference" / "benchmarks.md").read_text(encoding="utf-8")
    found = re.findall(
        r"^\| ([^|]+) \| [\d.]+ ms[^|]*\|[^|]+\| ([\d.]+)[^|]*\|", text, re.MULTILINE
    )
    names = [name.strip() for name, _ in found]
    ratios = np.array([float(ratio) for _, ratio in found])
    figure, axes = axes_of(8.5, 4.6)
    axes.barh(names, ratios, color=np.where(ratios < 1, ORANGE, BLUE))
    axes.axvline(1, color=GREY)
    axes.invert_yaxis()
    axes.tick_params(axis="y", labelsize=8)
    axes.set(xscale="log", xlabel="processor time of the peer / processor time of this project")
    save(figure, "benchmarks")


def differences() -> None:
    """Noise factor that was found over the planted one, and right attributions by planted kind."""
    rows = _csv("differences.csv")
    planted = np.array([float(row["factor"]) for row in rows])
    found = np.array([float(row["found_factor"]) for row in rows])
    figure, axes = axes_of(5.4, 3.6)
    span = np.array([0.9 * planted.min(), 1.1 * planted.max()])
    axes.fill_between(span, 0.9 * span, 1.1 * span, color=GREY, alpha=0.3, label="within 10 %")
    axes.plot(planted, found, "o", color=BLUE, ms=5, label="scene")
    axes.set(xlabel="planted noise factor", ylabel="noise factor that was found")
    axes.legend(frameon=False)
    save(figure, "differences")


def compensation() -> None:
    """Error after compensation against the predicted uncertainty."""
    rows = _csv("compensation.csv")
    before, after, predicted = (
        np.array([float(row[name]) for row in rows]) for name in ("before", "after", "predicted")
    )
    figure, axes = axes_of(6.2, 3.8)
    span = np.array([0.8 * predicted.min(), 1.3 * predicted.max()])
    axes.loglog(span, span, color=GREY, label="error = predicted uncertainty")
    axes.loglog(predicted, before, "o", color=ORANGE, ms=4, label="before compensation")
    axes.loglog(predicted, after, "o", color=BLUE, ms=5, label="after compensation")
    axes.set(xlabel="predicted RMS uncertainty (mm)", ylabel="RMS error of the true arm (mm)")
    axes.legend(frameon=False)
    save(figure, "compensation")


def _csv(name: str) -> list[dict]:
    with (DOCS / "studies" / name).open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def diagnosis() -> None:
    """The summary image of a diagnosis of `elastic-arm`."""
    with TemporaryDirectory() as folder:
        run = Path(folder) / "run"
        workbench.diagnose(workbench.load_example("elastic-arm"), out=run)
        (IMAGES / "diagnosis.png").write_bytes((run / "summary.png").read_bytes())


CHARTS: dict[str, Callable[[], None]] = {
    "plan-stages": plan_stages,
    "held-out-error": held_out,
    "uncertainty": uncertainty,
    "excluded-samples": excluded,
    "corrections": corrections,
    "effect-of-a-load": effect_of_a_load,
    "real-recordings": real_recordings,
    "benchmarks": benchmarks,
    "differences": differences,
    "compensation": compensation,
    "diagnosis": diagnosis,
}
