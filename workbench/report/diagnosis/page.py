"""Page of a diagnosis: unmodelled effects, their places, the validation, and the minimal detectable biases."""

from workbench.explanation.planning.scenes import SCENE
from workbench.explanation.result import (
    AMBIGUOUS,
    CONSISTENT,
    EXPLAINED,
    UNEXPLAINED,
    Diagnosis,
    Term,
)
from workbench.explanation.sentences import words as said
from workbench.report.diagnosis import figures as figures
from workbench.report.diagnosis import turntable
from workbench.report.diagnosis.chain import chain
from workbench.report.diagnosis.detectable import detectable
from workbench.report.diagnosis.differences import three_parts
from workbench.report.diagnosis.terms import before_and_after
from workbench.report.provenance import flat
from workbench.report.sections import Page, Section, facts, figure, note, pair, table, words
from workbench.report.sensor.scanner import rejected_points
from workbench.report.text import counted, p_value, rounded, sentence, with_labels

VERDICTS = {
    CONSISTENT: "These data show no unmodelled effect",
    EXPLAINED: "The unmodelled effects are identified",
    AMBIGUOUS: "Unmodelled effects are found, but some have alternative explanations",
    UNEXPLAINED: "There is structure that no effect of the catalogue explains",
}
_OF_TWO_POSES = (
    " A length has two poses of the arm: angles and other quantities of a pose are their means."
)
_PASSED = {True: "passed", False: "failed", None: "cannot tell"}


def page(diagnosis: Diagnosis) -> Page:
    """The whole page."""
    proof = diagnosis.proof
    unit = diagnosis.unit
    numbers = (
        ("held-out RMS, with the findings", rounded(proof.after), unit),
        ("held-out RMS, before", rounded(proof.before), unit),
        (f"noise, {proof.noise_from}", rounded(proof.noise), unit),
        *_rotation_numbers(proof),
        ("findings", str(len(diagnosis.terms)), ""),
    )
    sections = (
        Section("findings", "Findings", tuple(_findings(diagnosis))),
        Section("place", "Place in the measuring chain", tuple(_place(diagnosis))),
        *(
            [Section("against", "Parts of the difference", tuple(_difference(diagnosis)))]
            if diagnosis.shares
            else []
        ),
        *([turntable.section(diagnosis.turntable)] if diagnosis.turntable else []),
        Section("proof", "Validation", tuple(_validation(diagnosis))),
        *_term_by_term(diagnosis),
        Section("residuals", "Residuals before and after", tuple(_residuals(diagnosis))),
        *(
            [Section("doubt", "Alternative explanations", tuple(_alternatives(diagnosis)))]
            if diagnosis.terms
            else []
        ),
        Section("visible", "Minimal detectable biases", tuple(detectable(diagnosis))),
        Section("next", "Next experiment", tuple(_next(diagnosis))),
        Section(
            "provenance",
            "Provenance",
            (facts(flat(diagnosis.provenance)),),
        ),
    )
    files = (
        "residuals.csv",
        "smallest-visible.csv",
        *([SCENE] if diagnosis.experiment.scene else []),
    )
    return Page(
        f"Diagnosis · {diagnosis.title}",
        VERDICTS[diagnosis.verdict],
        numbers,
        tuple(_lead(diagnosis)),
        sections,
        files=files,
        caption=_error_name(diagnosis),
    )


def _error_name(diagnosis: Diagnosis) -> str:
    if diagnosis.unit != "mm":
        return "RMS distance in the image"
    if diagnosis.measures == "ball-surface":
        return "RMS radial distance of the points of a scan"
    is_number = diagnosis.views is not None and not diagnosis.views.has_direction
    return "RMS of the residual" if is_number else "RMS of the 3-D distance"


def _term_by_term(diagnosis: Diagnosis) -> list[Section]:
    """The section on the models from the simulation to the corrected one; none where there is only one."""
    if diagnosis.views is None or len(diagnosis.views.steps) < 2:
        return []
    return [Section("terms", "Before and after, term by term", tuple(before_and_after(diagnosis)))]


def _rotation_numbers(proof) -> tuple[tuple[str, str, str], ...]:
    if proof.angles_rms is None:
        return ()
    before, after = proof.angles_rms
    return ("orientation held out, after", rounded(after), "deg"), (
        "orientation, before",
        rounded(before),
        "deg",
    )


def _lead(diagnosis: Diagnosis):
    proof = diagnosis.proof
    scheme = f" ({proof.scheme})" if proof.scheme else ""
    errors = said.errors(proof.before, proof.after, proof.noise, proof.noise_from, diagnosis.unit)
    yield (
        f"{errors} These are {counted(diagnosis.samples, 'sample')} predicted in {proof.folds} "
        f"folds{scheme}. The complete "
        "search is repeated inside every fold; repeats of one pose are never on both sides."
    )
    yield f"The baseline: {diagnosis.baseline}."
    for warning in diagnosis.warnings:
        yield f"Warning: {warning.rstrip('.')}."


def _findings(diagnosis: Diagnosis):
    if not diagnosis.terms:
        yield words(
            "No term reduces the held-out error significantly."
            if diagnosis.verdict == UNEXPLAINED
            else "No term is missing."
        )
    for term in diagnosis.terms:
        yield words(term.statement)
    if diagnosis.terms:
        yield table(
            [
                "term",
                "where",
                "p",
                "probability",
                f"size ({diagnosis.unit} RMS)",
                "t held out",
                "reselected",
            ],
            [_row(term) for term in diagnosis.terms],
            left=2,
        )
    if figures.with_evidence(diagnosis):
        yield figure(
            "sizes",
            figures.evidence(diagnosis),
            "Chi-square that each term explains conditional on the others, its size, and t of its held-out gain.",
        )
    if diagnosis.refused:
        yield note("Found but not retained", [term.statement for term in diagnosis.refused])
    if diagnosis.outliers:
        shown = ", ".join(map(str, diagnosis.outliers[:20])) + (
            " ..." if len(diagnosis.outliers) > 20 else ""
        )
        yield note("Outliers", [f"Excluded from the numbers: samples {shown}."])


def _row(term: Term):
    found = term.finding
    name = with_labels(found.effect + (f", {found.label}" if found.label else ""))
    reselected = f"{term.reselected_folds} of {term.searched_folds}" if term.searched_folds else "–"
    return (
        name,
        said.place(found.where),
        p_value(found.p_value),
        f"{found.probability:.2f}",
        rounded(term.size),
        rounded(term.t, 2),
        reselected,
    )


def _place(diagnosis: Diagnosis):
    significant = [located for located in diagnosis.located if located.p_value < 0.01]
    if not significant:
        yield words(
            "No place stands out: at no place of the chain does a smooth function of the recorded covariates "
            "explain a significant share of the model discrepancy."
        )
    yield figure(
        "chain",
        chain(diagnosis),
        "The measuring chain from base to measured point. Area and colour: share of the baseline's model "
        "discrepancy that a smooth function of one or two covariates explains at that place. Labels: findings. "
        "Confounded neighbouring places share the same part.",
    )
    if significant:
        rows = [
            (
                said.place(located.where),
                located.port,
                said.listed([said.covariate(c) for c in located.depends_on]),
                f"{100 * located.share:.0f} %",
                p_value(located.p_value),
            )
            for located in significant[:12]
        ]
        yield table(
            ["place", "port", "depends on", "share of the discrepancy", "p of the complete search"],
            rows,
            left=3,
        )
    remaining = [located for located in diagnosis.remainder if located.p_value < 0.01]
    if remaining and diagnosis.terms:
        first = remaining[0]
        covariates = said.listed([said.covariate(c) for c in first.depends_on])
        yield words(
            f"Some structure remains with these findings: a function of {covariates} at {said.place(first.where)} "
            f"explains {100 * first.share:.0f} % of the remaining discrepancy."
        )
    if diagnosis.fixed:
        yield words(diagnosis.fixed.sentence)
    if diagnosis.laser_line is not None:
        yield from rejected_points(diagnosis.laser_line.rejected, diagnosis.laser_line.size)


def _difference(diagnosis: Diagnosis):
    shares = diagnosis.shares
    yield words(
        f"The mean squared distance between {shares.reference} and the recording, "
        f"{rounded(shares.total_mm2)} mm², is the sum of three parts: parameter values that are not calibrated, "
        "noise, and structure that no parameter values of the reference explain. Only the last part points to "
        "unmodelled effects."
    )
    yield figure(
        "shares",
        figures.shares(shares),
        "Shares of the mean squared distance, on a logarithmic axis.",
    )
    if shares.moved:
        rows = [
            (m["name"], rounded(m["before"]), rounded(m["after"]), m["unit"]) for m in shares.moved
        ]
        yield table(["parameter", "reference", "this recording", "unit"], rows)
    yield from three_parts(diagnosis)


def _validation(diagnosis: Diagnosis):
    proof = diagnosis.proof
    unit = diagnosis.unit
    yield words(
        "Nested cross-validation repeats the complete search without a part of the samples; the findings must predict "
        "this part better. A term is retained only if the held-out error rises significantly without it, conditional "
        "on all others (t > 2.5 over poses for an arm, t > 2 over board poses and balls for a sensor; errors are "
        "weighted as in the fit, which limits the influence of outliers). "
        "In a permutation or circular-shift control of its cause, a term must not reduce the error. "
        f"The gain of all terms together is {proof.t:.1f} times its standard error."
    )
    yield _scheme_table(proof.schemes, unit)
    yield figure(
        "heldout", figures.held_out(diagnosis), "Share of samples whose held-out error is smaller."
    )
    if proof.angles is not None:
        yield figure(
            "heldout-rotation",
            figures.held_out_rotation(diagnosis),
            "Share of samples whose held-out rotation error is smaller.",
        )
    controls = [
        _control(term, control)
        for term in (*diagnosis.terms, *diagnosis.refused)
        for control in term.controls
    ]
    if controls:
        yield table(["term", "control", "remaining gain", "p", "", ""], controls, left=2)
    if proof.lack:
        yield _lack_of_fit(proof.lack, unit)


def _scheme_table(schemes, unit: str) -> dict:
    """Held-out errors and the test of the gain, one row a scheme of folds."""
    rows = [
        (
            s["folds_by"],
            s["folds"],
            rounded(s["before"]),
            rounded(s["after"]) if s.get("nested", True) else "not repeated",
            rounded(s["after_same_terms"]),
            f"{s['t']:.1f}",
            "yes" if s.get("judges", True) else "no",
        )
        for s in schemes
    ]
    return table(
        [
            "folds",
            "number",
            f"before ({unit})",
            f"after, nested search ({unit})",
            f"after, the terms above ({unit})",
            "t",
            "used for selection",
        ],
        rows,
    )


def _lack_of_fit(lack, unit):
    rows = [
        (
            name,
            rounded(row["f"]),
            p_value(row["p_value"]),
            rounded(row["means_rms"]),
            rounded(row["pure_error_rms"]),
        )
        for name, row in lack.items()
    ]
    return table(
        ["lack of fit", "F", "p", f"means over repeats ({unit})", f"pure error ({unit})"], rows
    )


def _control(term: Term, control):
    if control.share is None:
        share = "–"
    else:
        share = f"{100 * control.share:.1f} %"
    return (
        term.title,
        control.kind,
        share,
        p_value(control.p_value),
        _PASSED[control.passed],
        control.why,
    )


def _residuals(diagnosis: Diagnosis):
    if diagnosis.views is None:
        return
    yield words(
        f"Predicted minus measured, in {diagnosis.unit}, all samples, fitted: of the baseline, and with the findings."
        + (_OF_TWO_POSES if diagnosis.measures == "distance" else "")
    )
    space = figures.space if diagnosis.views.links is not None else figures.image
    yield pair(
        *(
            figure(f"space-{stage}", space(diagnosis, stage), text)
            for stage, text in (
                ("before", "Baseline."),
                ("after", "With the findings, on the same scale."),
            )
        )
    )
    for k, (name, drawn) in enumerate(figures.residual_panels(diagnosis)):
        yield figure(
            f"over-{k}",
            drawn,
            f"Over {figures.covariate_name(name)}: before grey, after blue. Lines are means of bins of equal count.",
        )


def _alternatives(diagnosis: Diagnosis):
    doubtful = [term for term in diagnosis.terms if term.finding.alternatives]
    if not doubtful:
        yield words(
            "No term has an alternative explanation: each has a probability of at least 95 %."
        )
    for term in doubtful:
        rows = [
            (
                with_labels(f"{term.finding.effect} {term.finding.label}".strip()),
                said.place(term.finding.where),
                f"{term.finding.probability:.2f}",
                "100 %",
                "",
            )
        ]
        rows += [
            (
                with_labels(f"{alternative.effect} {alternative.label}".strip()),
                said.place(alternative.where),
                f"{alternative.probability:.2f}",
                f"{100 * alternative.squared_correlation:.0f} %",
                alternative.missing_covariate
                and f"needs {alternative.missing_covariate}, not recorded"
                or alternative.why,
            )
            for alternative in term.finding.alternatives[:8]
        ]
        head = [
            f"alternatives to {term.title}",
            "where",
            "probability",
            "share of the signature",
            "",
        ]
        yield table(head, rows, left=2, last_is_text=True)
    if diagnosis.not_recorded:
        yield note(
            "Not recorded",
            [
                f"{sentence(said.covariate(name))} Some of the findings above depend on it."
                for name in diagnosis.not_recorded
            ],
        )


def _next(diagnosis: Diagnosis):
    plan = diagnosis.experiment
    yield words(plan.sentence)
    if plan.rows:
        rows = [
            (
                row["plan"],
                row["samples"],
                f"{row['apart_now_sigma']:.1f}",
                f"{row['apart_then_sigma']:.1f}",
                rounded(row["gain_per_sample"], 2),
                f"{row['samples_needed']:,.0f}",
            )
            for row in plan.rows
        ]
        yield table(
            [
                "recording",
                "additional samples",
                "separation now (σ)",
                "separation then (σ)",
                "σ² per sample",
                "samples needed",
            ],
            rows,
        )
    if plan.scene:
        yield words(
            f"{SCENE} in the folder of this page describes this recording as a scene. "
            f"To simulate it, run workbench simulate {SCENE}."
        )
