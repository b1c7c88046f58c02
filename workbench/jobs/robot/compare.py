"""Several plans on one recording, same splits: what each costs in parameters and reaches on unseen samples."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from workbench.core.distributions import student
from workbench.core.errors import InputError
from workbench.core.text.csv_text import csv_text
from workbench.fitting.calibration_plans.plans import read_plan
from workbench.fitting.cross_validation import blocks, error_summary
from workbench.fitting.verdicts.calibration_verdict import calibration_verdict
from workbench.fitting.verdicts.verdict import Tolerance, Verdict
from workbench.jobs.robot.calibrate import Calibration, calibrate
from workbench.machine.progress import counted

DEFAULT = "default"
_BLOCKS, _LEAST_BLOCKS = 10, 5
_EQUAL = 1e-6  # of the squared error: a hundredth of what a converged fit leaves open
CHOSEN = "not computed: a plan selected its stages on these folds; name --test-samples (in Python test_samples)"
SAME_FIRST = "the plan that the others are compared with"
TOO_FEW_BLOCKS = f"not computed: fewer than {_LEAST_BLOCKS} folds or blocks of test poses"
SAME = "not computed: both predict the same"


@dataclass(frozen=True)
class Comparison:
    """`names` of the plans and their calibrations, first the one that the others are compared with.

    `block` (n,) is the fold, or with test samples the block of consecutive test poses, of each moving
    row that every plan predicted without having fitted it; -1 elsewhere. All held-out figures are of these rows.
    `choosing` says which plans leave out stages by what the folds of the fit samples say.
    """

    recording: object
    names: tuple[str, ...]
    calibrations: tuple[Calibration, ...]
    block: np.ndarray
    tested_apart: bool
    choosing: tuple[bool, ...]

    @property
    def distances(self) -> np.ndarray:
        """(plans, held out) mm, 3-D distances of the held-out rows."""
        return np.stack(
            [_lengths(c.held_out_residual[:, self.block >= 0]) for c in self.calibrations]
        )

    @property
    def angles(self) -> np.ndarray | None:
        """(plans, held out) deg, rotation angles of the held-out rows; None where no orientation is measured."""
        if not self.measures_orientation:
            return None
        angles = [_lengths(c.rotation["held_out"][:, self.block >= 0]) for c in self.calibrations]
        return np.rad2deg(np.stack(angles))

    @property
    def measures_orientation(self) -> bool:
        return "rotation_rms_deg" in self.calibrations[0].held_out

    def rows(self) -> list[dict]:
        """One row a plan: parameters, errors in mm and deg, the ratio to the first plan and the paired tests.

        `ratio` and `p` are of the position, `rotation_ratio` and `rotation_p` of the orientation.
        """
        held_out = [error_summary(self._held_out(c)) for c in self.calibrations]
        return [
            {
                "plan": name,
                **_parameters(calibration),
                "stages": [stage.name for stage in calibration.stages if stage.earned],
                **_fit_rms(calibration),
                **{f"held_out_{k}": v for k, v in parameters_of_calibration.items()},
                **self._std(k),
                "ratio": parameters_of_calibration["rms_mm"] / held_out[0]["rms_mm"],
                **self._paired(k, self.distances),
                **self._rotation_columns(k, parameters_of_calibration, held_out[0]),
                "converged": calibration.solution.converged,
                "noise": calibration.noise.as_json(),
                "verdict": self.verdict(k).as_json(),
            }
            for k, (name, calibration, parameters_of_calibration) in enumerate(
                zip(self.names, self.calibrations, held_out)
            )
        ]

    def _std(self, k: int) -> dict:
        """Standard deviation of the held-out distances (mm), and of the angles (deg) where there are any."""
        columns = {"held_out_std_mm": float(self.distances[k].std())}
        if self.measures_orientation:
            columns["held_out_rotation_std_deg"] = float(self.angles[k].std())
        return columns

    def _held_out(self, calibration) -> np.ndarray:
        """(m, held out) residual of the held-out rows, mm and then rad."""
        rows = [calibration.held_out_residual, calibration.rotation["held_out"]]
        return np.concatenate(rows)[:, self.block >= 0]

    def _rotation_columns(self, k: int, columns: dict, first: dict) -> dict:
        if not self.measures_orientation:
            return {}
        ratio = columns["rotation_rms_deg"] / first["rotation_rms_deg"]
        return {"rotation_ratio": ratio, "rotation_p": self._paired(k, self.angles)["p"]}

    def _paired(self, k: int, errors: np.ndarray | None = None) -> dict:
        """`p` that plan k and the first err alike, two-sided, over folds or blocks; and why there is none.

        errors (plans, held out): as of `falls`.
        Differences of the mean square are compared with their scatter (Student's t). Folds share most of
        what they were fitted on, so their variance is enlarged by 1 + J/(J-1) (Nadeau & Bengio, Machine
        Learning 52, 2003); blocks of test samples, predicted by one fit, are not, and the test is then of
        these two fits on poses like these.
        """
        if k == 0:
            return {"p": None, "test": SAME_FIRST}
        falls = self.falls(k, errors)
        if len(falls) < _LEAST_BLOCKS:
            return {"p": None, "test": TOO_FEW_BLOCKS}
        if not self.tested_apart and (self.choosing[0] or self.choosing[k]):
            return {"p": None, "test": CHOSEN}
        if not falls.any():
            return {"p": None, "test": SAME}
        blocks = "blocks of test poses" if self.tested_apart else "folds"
        return {"p": self._p(falls), "test": f"valid over {len(falls)} {blocks}"}

    def _p(self, falls) -> float:
        count = len(falls)
        enlarged = 1 / count + (0 if self.tested_apart else 1 / (count - 1))
        t = falls.mean() / max(falls.std(ddof=1) * np.sqrt(enlarged), 1e-300)
        return float(2 * student.sf(abs(t), count - 1))

    def falls(self, k: int, errors: np.ndarray | None = None) -> np.ndarray:
        """(blocks,) by which the mean square of plan k lies below that of the first.

        errors (plans, held out): `distances` (the default; then mm^2) or `angles` (deg^2).
        """
        squares = (self.distances if errors is None else errors) ** 2
        block = self.block[self.block >= 0]
        return np.array([(squares[0] - squares[k])[block == b].mean() for b in np.unique(block)])

    def verdict(self, k: int, tolerances: Sequence[Tolerance] = ()) -> Verdict:
        """The held-out error of plan k, on the rows that all plans predict, against noise and tolerances."""
        calibration = self.calibrations[k]
        held_out = calibration.held_out | error_summary(
            calibration.held_out_residual[:, self.block >= 0]
        )
        return calibration_verdict(held_out, calibration.noise, tolerances)

    def best_verdict(self, tolerances: Sequence[Tolerance] = ()) -> Verdict:
        """The verdict on the plan with the smallest held-out error."""
        squares = (self.distances**2).mean(1)
        best = int(squares.argmin())
        verdict = self.verdict(best, tolerances)
        is_equal = len(squares) > 1 and np.allclose(squares, squares[best], rtol=_EQUAL, atol=0)
        subject = (
            "No difference between the plans" if is_equal else f"Best plan, {self.names[best]}"
        )
        return replace(verdict, sentence=f"{subject}: {verdict.sentence}")

    def as_json(self, tolerances: Sequence[Tolerance] = ()) -> dict:
        """The answer of `workbench compare`; the verdict is that of the best plan."""
        first = self.calibrations[0]
        return {
            "command": "compare",
            "recording": self.recording.name,
            "measures": self.recording.measures,
            "samples": first.recording.n,
            "held_out_samples": int((self.block >= 0).sum()),
            "held_out_by": "test samples" if self.tested_apart else "folds of the fit samples",
            "blocks": len(np.unique(self.block[self.block >= 0])),
            "nominal": first.nominal,
            "plans": self.rows(),
            "verdict": self.best_verdict(tolerances).as_json(),
            "warnings": list(first.warnings),
        }


def compare(
    recording,
    plans: Sequence[str],
    fit_samples: Sequence[int] | None = None,
    test_samples: Sequence[int] | None = None,
    folds: int = 10,
    progress: Callable[[str], None] = lambda text: None,
    trust_data: bool = False,
) -> Comparison:
    """Calibrate a recording by each of several plans, all on the same splits.

    plans: names or files of plans, "default" for the default one, each once. The rest as of
    `workbench.jobs.robot.calibrate.calibrate`. Raises InputError.
    """
    _check(plans)
    found = []
    begin = counted(progress, len(plans))
    for name in plans:
        begin(f"plan {name}")
        plan = None if name == DEFAULT else Path(name)
        report = _prefixed(progress, f"plan {name}")
        found.append(
            calibrate(recording, plan, fit_samples, test_samples, folds, report, trust_data)
        )
    block = np.where(np.all([c.fold >= 0 for c in found], 0), found[0].fold, -1)
    is_separated = bool(
        len(np.unique(block[block >= 0])) == 1
        and not (test_samples is None and fit_samples is None)
    )
    if is_separated:
        block[block >= 0] = blocks(found[0].recording.poses[block >= 0], _BLOCKS)
    names = tuple(Path(name).stem for name in plans)
    choosing = tuple(_chooses(name) for name in plans)
    return Comparison(recording, names, tuple(found), block, is_separated, choosing)


def _prefixed(progress: Callable[[str], None], prefix: str) -> Callable[[str], None]:
    return lambda text: progress(f"{prefix}: {text}")


def _check(plans):
    if not plans:
        raise InputError(
            "--plan names no plan, where at least one is expected; name several, or 'default'."
        )
    duplicates = sorted({name for name in plans if list(plans).count(name) > 1})
    if duplicates:
        raise InputError(
            f"--plan names {duplicates[0]} twice, where each plan is expected once; take one of them out."
        )


def _lengths(residual: np.ndarray) -> np.ndarray:
    """(n,) lengths of the columns of a residual (k, n)."""
    return np.sqrt((residual**2).sum(0))


def _fit_rms(calibration) -> dict:
    names = ("rms_mm", "rotation_rms_deg")
    return {f"fit_{name}": calibration.fit[name] for name in names if name in calibration.fit}


def _parameters(calibration) -> dict:
    """Parameters that the retained stages of a plan free, and how many of them are identifiable."""
    retained = [stage for stage in calibration.stages if stage.earned] or list(calibration.stages)
    return {"free": retained[-1].free, "identifiable": calibration.solution.identified}


def _chooses(name: str) -> bool:
    """Whether a plan leaves the choice of its stages to the folds, as the default one does."""
    return name == DEFAULT or any(stage.earn for stage in read_plan(Path(name)))


def save(comparison: Comparison, folder: Path) -> None:
    """Write table.csv, held-out.csv and comparison.png.

    held-out.csv has one column of distances (mm) a plan and, where orientation is measured, one of
    angles, called `<plan>_rotation_deg`.
    """
    rows = [
        {k: "; ".join(v) if isinstance(v, list) else v for k, v in row.items()}
        for row in comparison.rows()
    ]
    (folder / "table.csv").write_text(
        csv_text(list(rows[0]), [row.values() for row in rows]), encoding="utf-8"
    )
    ids = comparison.calibrations[0].recording.sample_ids[comparison.block >= 0]
    errors = comparison.distances
    head = [*comparison.names]
    if comparison.measures_orientation:
        errors = np.concatenate([errors, comparison.angles])
        head += [f"{name}_rotation_deg" for name in comparison.names]
    lines = []
    for i, row in zip(ids, errors.T):
        lines.append([int(i), *(f"{error:.6g}" for error in row)])
    (folder / "held-out.csv").write_text(csv_text(["sample", *head], lines), encoding="utf-8")
    image(comparison).savefig(folder / "comparison.png", dpi=130)


def image(comparison: Comparison):
    """A matplotlib figure: fitted and held-out RMS of every plan, and the share of samples that err by less.

    A second row shows the same of the orientation, where it is measured.
    """
    from matplotlib.figure import Figure

    kinds = [(comparison.distances, "3-D distance", "mm", "")]
    if comparison.measures_orientation:
        kinds.append((comparison.angles, "rotation angle", "deg", "rotation_"))
    figure = Figure(figsize=(11, 4.2 * len(kinds)), facecolor="white", layout="constrained")
    panels = figure.subplots(len(kinds), 2, width_ratios=(1, 1.15), squeeze=False)
    colours = [_COLOURS[k % len(_COLOURS)] for k in range(len(comparison.names))]
    for (bars, shares), (errors, quantity, unit, prefix) in zip(panels, kinds):
        _bars(bars, comparison, colours, (quantity, unit, prefix))
        _shares(shares, zip(comparison.names, errors, colours), f"{quantity}, held out ({unit})")
    for axes in panels.ravel():
        axes.spines[["top", "right"]].set_visible(False)
        axes.grid(alpha=0.25)
        axes.title.set_size(10.5)
    figure.suptitle(comparison.recording.title or comparison.recording.name, size=11.5)
    return figure


def _shares(axes, lines, label: str):
    """Cumulative share of samples over their error; lines: (plan, errors (n,), colour)."""
    for name, errors, colour in lines:
        axes.ecdf(errors, label=name, color=colour, lw=1.8)
    axes.set(xlabel=label, title="share of samples that err by less", xlim=(0, None))
    axes.yaxis.set_major_formatter("{x:.0%}")
    axes.legend(frameon=False, loc="lower right")


_COLOURS = ("#8c8c8c", "#1f83c4", "#12957a", "#b8649f", "#d9730d", "#5b5bd6", "#806000")


def _bars(axes, comparison, colours, kind):
    """Held-out RMS of every plan; kind: (what in words, unit, prefix of the keys) of the errors."""
    quantity, unit, prefix = kind
    rows = comparison.rows()
    place = np.arange(len(comparison.names))
    values = [row[f"held_out_{prefix}rms_{unit}"] for row in rows]
    axes.barh(place, values, color=colours, height=0.62)
    fitted = [row[f"fit_{prefix}rms_{unit}"] for row in rows]
    axes.scatter(fitted, place, marker="|", s=220, color="#222222", label="fitted", zorder=3)
    for row, value, y in zip(rows, values, place):
        text = f"{value:.4f}  ({row[f'{prefix}ratio']:.2f})"
        axes.annotate(text, (value, y), (5, 0), textcoords="offset points", va="center", size=9)
    names = [f"{row['plan']}\n{row['identifiable']} identified" for row in rows]
    axes.set(yticks=place, yticklabels=names, xlim=(0, 1.3 * max(values)))
    axes.set(
        xlabel=f"RMS of the {quantity} ({unit})",
        title="held out, and its ratio to the first plan's",
    )
    axes.invert_yaxis()
    axes.legend(frameon=False, loc="lower right")
