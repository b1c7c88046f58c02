"""Result of a diagnosis: validated findings, refused terms, and the JSON of the contract."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace

import numpy as np

from workbench.core.model import NOISE
from workbench.diagnosis.levels import UNMODELLED_LEVEL
from workbench.diagnosis.linear.problem import Found, Located
from workbench.diagnosis.validation.terms import Control, Proof, Term
from workbench.explanation.comparison.reference import Shares
from workbench.explanation.minimal_detectable_bias import DetectableBias
from workbench.fitting.verdicts.diagnosis_verdict import NOISE_LEVELS
from workbench.jobs.sensor.turntables import turntable_json

CONSISTENT, EXPLAINED, AMBIGUOUS, UNEXPLAINED = (
    "consistent",
    "explained",
    "ambiguous",
    "unexplained",
)
_MIN_REMAINDER = 1 / 3


@dataclass(frozen=True)
class Experiment:
    """The recording that would separate an ambiguity group: `sentence`, the `rows` compared, and the `scene` (TOML).

    `poses`: sample numbers to be measured again, or joint readings of new poses (k, J) in file units.
    """

    sentence: str
    rows: tuple[Mapping, ...] = ()
    scene: Mapping | None = None
    poses: np.ndarray | None = None
    robot: Mapping | None = None


@dataclass(frozen=True)
class Step:
    """A model on the way from the simulation to the corrected one: `name`, `residual` (3, n) mm at the recording."""

    name: str
    residual: np.ndarray

    @property
    def rms(self) -> float:
        """RMS of the 3-D distances, mm, ignoring nan."""
        return float(np.sqrt(np.nanmean((self.residual**2).sum(0))))


@dataclass(frozen=True)
class Views:
    """Data of the figures of the page. n samples; residuals (c, n) in `unit`, predicted minus measured.

    `points` (3, n) mm in the robot's root frame or (2, n) px in the image; `names` of the residual's components;
    `chain`: places of the measuring chain in order; `covariates` name -> (n,).
    """

    before: np.ndarray
    after: np.ndarray
    points: np.ndarray
    covariates: Mapping[str, np.ndarray]
    chain: tuple[str, ...]
    sample: np.ndarray
    links: np.ndarray | None = None
    names: tuple[str, ...] = ("x", "y", "z")
    rotation: tuple[np.ndarray, np.ndarray] | None = (
        None  # before and after (k, n) rad, of the orientation
    )
    steps: tuple[Step, ...] = ()  # of a robot: simulation, baseline, and each term added
    rounding: np.ndarray | None = (
        None  # (m, n) mm, 1 sigma by the rounding of readings, where found
    )

    @property
    def has_direction(self) -> bool:
        """Whether a residual is a vector; that of a length or of the touch of a plane is one number."""
        return len(self.before) > 1


@dataclass(frozen=True)
class Diagnosis:
    """The answer of `workbench diagnose`; `unit` "mm" or "px" of all errors and sizes."""

    recording: str
    title: str
    measures: str
    samples: int
    baseline: str
    unit: str
    verdict: str
    terms: tuple[Term, ...]
    refused: tuple[Term, ...]
    located: tuple[Located, ...]
    remainder: tuple[Located, ...]
    proof: Proof
    detectable: tuple[DetectableBias, ...]
    experiment: Experiment
    found: Found
    views: Views | None = None
    shares: Shares | None = None
    outliers: tuple[int, ...] = ()
    not_recorded: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    provenance: Mapping[str, str] = field(default_factory=dict)
    fixed: object = None  # fixed.FixedPoints, where the recording holds reflectors that do not move
    by_kind: Sequence[Mapping] = ()  # of a sensor: rows of `sensor_errors.errors_by_kind`
    balls: Mapping | None = None  # of a sensor: `sensor_errors.ball_centres`
    differences: object = None  # differences.Differences, where a simulation or solution was named
    given: tuple = ()  # effects that the baseline holds
    robot_keys: Mapping | None = None  # of the reference's robot; None: that of the recording
    correlation: object = None  # SerialCorrelation of the noise, where nothing else is left
    turntable: object = None  # TurntableCalibration, where a board stood on a turntable
    laser_line: object = None  # sensor_errors.LaserLine, of a scanner whose line has a doubt

    def as_json(self) -> dict:
        """The answer as the JSON object that `diagnose --json` writes."""
        return {
            "command": "diagnose",
            "recording": self.recording,
            "measures": self.measures,
            "samples": self.samples,
            "baseline": self.baseline,
            "verdict": self.verdict,
            "unit": self.unit,
            "effects": [_effect(term, self.unit) for term in self.terms],
            "located": [_located(located, self.unit) for located in self.located],
            "held_out": _held_out(self.proof, self.unit)
            | ({"by_kind": [dict(row) for row in self.by_kind]} if self.by_kind else {}),
            "ball_centres": None if self.balls is None else dict(self.balls),
            "turntable": self._turntable(),
            "laser_line": self.laser_line and self.laser_line.as_json(),
            "smallest_visible": [
                _detectable_json(detectable, self.unit) for detectable in self.detectable
            ],
            "next_experiment": self.experiment.sentence,
            "experiments": [dict(row) for row in self.experiment.rows],
            "refused": [
                _effect(term, self.unit) | {"reason": term.reason} for term in self.refused
            ],
            "left": [_located(located, self.unit) for located in self.remainder],
            "p_anything_missing": self.found.p_first,
            "p_anything_left": self.found.p_remainder,
            "outliers": list(self.outliers),
            "not_recorded": list(self.not_recorded),
            "against": self.shares.as_json() if self.shares else None,
            "differences": self._differences(),
            "fixed_reflectors": self.fixed.as_json() if self.fixed else None,
            "serial_correlation": asdict(self.correlation) if self.correlation else None,
            "warnings": list(self.warnings),
            "provenance": dict(self.provenance),
        }

    def _turntable(self) -> dict | None:
        turntable = turntable_json(self.turntable)
        return turntable and turntable | {"statements": list(self.turntable.sentences)}

    def _differences(self) -> dict | None:
        if self.differences is None:
            return None
        physics = [t for t in self.terms if t.finding.effect not in NOISE_LEVELS]
        return self.differences.as_json([_effect(term, self.unit) for term in physics])


def verdict_of(
    terms,
    first_p: float,
    left: bool = False,
    is_placed: bool = True,
) -> str:
    """The word of the contract.

    `unexplained` where a kept term has no name, where nothing was kept though structure is there, or where much is
    `left`, see `has_unexplained_structure`; `ambiguous` where a kept term is less than certain and has
    alternatives. Findings on the noise explain no structure, and next to them alone the recording is `consistent`.
    is_placed: whether structure that nothing explains holds a share of the residual at some place, or a refused
    term is significant; without either there is nothing to explain.
    """
    structure = [term for term in terms if term.finding.where != NOISE]
    if any(term.finding.effect == "unknown" for term in terms):
        return UNEXPLAINED
    if not structure and first_p < UNMODELLED_LEVEL and is_placed:
        return UNEXPLAINED
    if terms and left:
        return UNEXPLAINED
    if not structure:
        return CONSISTENT
    if all(term.is_certain for term in terms):
        return EXPLAINED
    return AMBIGUOUS


def has_unexplained_structure(proof: Proof, p_remainder: float, is_above: bool = False) -> bool:
    """Whether structure is left, and the remainder is above the noise or more than a third of what there was.

    is_above: whether the residual of the final model is significantly above the noise. Where it is not, or no noise is
    known, more than a third of what the held-out error had unexplained (`Proof.unexplained`) counts.
    """
    if p_remainder >= UNMODELLED_LEVEL:
        return False
    before, after = proof.unexplained
    return is_above or after > _MIN_REMAINDER * before


def with_statements(diagnosis: Diagnosis, statements) -> Diagnosis:
    """The diagnosis with a statement for each of its terms, then of those refused."""
    texts = iter(statements)
    fresh = [
        tuple(replace(term, statement=next(texts)) for term in terms)
        for terms in (diagnosis.terms, diagnosis.refused)
    ]
    return replace(diagnosis, terms=fresh[0], refused=fresh[1])


def _effect(term: Term, unit: str) -> dict:
    found = term.finding
    return {
        "effect": found.effect,
        "where": found.where,
        "variant": found.label,
        "p_value": found.p_value,
        "probability": min(found.probability, 1.0),
        "alternatives": [_alternative(alternative) for alternative in found.alternatives],
        "parameters": [dict(row) for row in term.parameters],
        "depends_on": list(found.depends_on),
        "options": options_of(found.effects),
        "instant": asdict(found.instant) if found.instant else None,
        "estimated_option": _option(found.option) if found.option else None,
        "spectrum": _spectrum(term),
        f"size_{unit}": term.size,
        "t": term.t,
        "t_searched_anew": term.t_nested,
        f"held_out_gain_{unit}": term.gain,
        "reselected": {"folds": term.reselected_folds, "of": term.searched_folds},
        "found_again": {
            "folds": term.reselected_folds,
            "of": term.searched_folds,
        },  # the same, by its older name
        "controls": [_control(control) for control in term.controls],
        "alarms": list(found.alarms),
        "statement": term.statement,
    }


def _option(option) -> dict:
    return {key: getattr(option, key) for key in ("name", "value", "std", "unit")}


def _spectrum(term: Term) -> dict | None:
    """Cycles of a joint's error curve, largest first, and the share of the curve that repeats; None of all others."""
    row = next((row for row in term.parameters if "cycles" in row), None)
    if row is None:
        return None
    per = "revolution" if row["unit"] == "rad" else "mm"
    names = ("order", "amplitude", "per_motor_revolution")
    return {
        "order_unit": f"cycles per {per}",
        "amplitude_unit": row["unit"],
        "cycles": [dict(zip(names, cycle)) for cycle in row["cycles"]],
        "periodic_share": row["periodic_share"],
        "curve_rms": row["curve_rms"],
        "reading_scale": _scale(row.get("reading_scale")),
    }


def _scale(scale: tuple[float, float] | None) -> dict | None:
    """Factor of a reading whose error is a straight line, with its standard deviation."""
    if scale is None:
        return None
    return dict(zip(("factor", "std"), scale))


def options_of(effects) -> dict:
    """Options of an effect in addition to its place, as JSON: order, joint, instant, seat, width ..."""
    options = {}
    for effect in effects:
        inner = getattr(effect, "inner", effect)  # a law with jointly estimated masses is that law
        options |= {
            name: value
            for name, value in inner.options.items()
            if isinstance(value, str | bool | int | float) or name == "names"
        }
        options |= {"masses_found": True} if inner is not effect else {}
    return options


def _alternative(alternative) -> dict:
    return {
        "effect": alternative.effect,
        "where": alternative.where,
        "variant": alternative.label,
        "why": alternative.why,
        "probability": min(alternative.probability, 1.0),
        "alike": alternative.squared_correlation,
        "not_recorded": alternative.missing_covariate,
    }


def _control(control: Control) -> dict:
    return {
        "control": control.kind,
        "share_of_gain_left": control.share,
        "p_value": control.p_value,
        "passed": control.passed,
        "trials": control.trials,
        "why": control.why,
    }


def _located(located: Located, unit: str) -> dict:
    return {
        "where": located.where,
        "port": located.port,
        "depends_on": list(located.depends_on),
        "share_of_mismatch": located.share,
        "p_value": located.p_value,
    }


def _held_out(proof: Proof, unit: str) -> dict:
    return {
        f"before_{unit}": proof.before,
        f"after_{unit}": proof.after,
        f"noise_{unit}": proof.noise,
        f"expected_{unit}": proof.expected,
        "folds": proof.folds,
        "scheme": proof.scheme,
        "noise_from": proof.noise_from,
        "t": proof.t,
        f"after_same_terms_{unit}": proof.fixed,
        "schemes": [dict(row) for row in proof.schemes],
        "lack_of_fit": dict(proof.lack) if proof.lack else None,
        **_angles(proof),
    }


def _angles(proof: Proof) -> dict:
    if proof.angles_rms is None:
        return {}
    before, after = proof.angles_rms
    return {"before_deg": before, "after_deg": after}


def _detectable_json(detectable: DetectableBias, unit: str) -> dict:
    return {
        "effect": detectable.effect,
        "where": detectable.where,
        "variant": detectable.label,
        f"size_{unit}": detectable.size,
        f"surviving_{unit}": detectable.orthogonal_size,
        "survives": detectable.orthogonal_share,
        "parameter": detectable.parameter,
        "unit": detectable.unit,
        f"separable_{unit}": detectable.separable,
        "separable_parameter": detectable.separable_parameter,
        "twin": {"effect": detectable.alternative, "where": detectable.alternative_where}
        if detectable.alternative
        else None,
    }
