"""The page of a diagnosis: what was left out, where it sits, the proof, and what these data could not have shown."""

import numpy as np

from workbench.diagnosis import words as said
from workbench.diagnosis.planning.scenes import SCENE
from workbench.diagnosis.result import (
    AMBIGUOUS,
    CONSISTENT,
    EXPLAINED,
    UNEXPLAINED,
    Diagnosis,
    Term,
)
from workbench.report.diagnosis import figures as figures
from workbench.report.diagnosis.chain import chain
from workbench.report.sections import Page, Section, facts, figure, note, pair, table, words
from workbench.report.text import counted, rounded, sentence

VERDICTS = {
    CONSISTENT: "Nothing is missing that these data can show",
    EXPLAINED: "What was missing has a name",
    AMBIGUOUS: "What was missing is known, but not every name is certain",
    UNEXPLAINED: "There is structure that nothing in the catalogue makes",
}
_SMALLEST = 40
_PASSED = {True: "passed", False: "failed", None: "cannot tell"}


def page(made: Diagnosis) -> Page:
    """The whole page."""
    proof, unit = made.proof, made.unit
    numbers = (
        ("held out, with what was found", rounded(proof.after), unit),
        ("held out, before", rounded(proof.before), unit),
        (f"noise, {proof.noise_from}", rounded(proof.noise), unit),
        *_rotation_numbers(proof),
        ("findings", str(len(made.terms)), ""),
    )
    sections = (
        Section("findings", "What was left out", tuple(_findings(made))),
        Section("place", "Where it sits", tuple(_place(made))),
        *(
            [Section("against", "Three differences, told apart", tuple(_against(made)))]
            if made.shares
            else []
        ),
        Section("proof", "Proof", tuple(_proof(made))),
        Section("residuals", "Residuals before and after", tuple(_residuals(made))),
        *(
            [Section("doubt", "What it might be instead", tuple(_doubt(made)))]
            if made.terms
            else []
        ),
        Section("visible", "What these data could have shown", tuple(_visible(made))),
        Section("next", "The next experiment", tuple(_next(made))),
        Section(
            "provenance",
            "Provenance",
            (facts([(k.replace("_", " "), v) for k, v in made.provenance.items()]),),
        ),
    )
    files = ("residuals.csv", "smallest-visible.csv", *([SCENE] if made.experiment.scene else []))
    return Page(
        f"Diagnosis · {made.title}",
        VERDICTS[made.verdict],
        numbers,
        tuple(_lead(made)),
        sections,
        files=files,
        caption="RMS of the 3-D distance" if unit == "mm" else "RMS distance in the image",
    )


def _rotation_numbers(proof) -> tuple[tuple[str, str, str], ...]:
    if proof.angles_rms is None:
        return ()
    before, after = proof.angles_rms
    return ("orientation held out, after", rounded(after), "deg"), (
        "orientation, before",
        rounded(before),
        "deg",
    )


def _lead(made: Diagnosis):
    proof = made.proof
    scheme = f" ({proof.scheme})" if proof.scheme else ""
    errors = said.errors(proof.before, proof.after, proof.noise, proof.noise_from, made.unit)
    yield (
        f"{errors} These are {counted(made.samples, 'sample')} predicted in {proof.folds} folds{scheme}. The complete "
        "search is repeated inside every fold; repeats of one pose are never on both sides."
    )
    yield f"The baseline: {made.baseline}." + (
        f" {' '.join(made.warnings)}" if made.warnings else ""
    )


def _findings(made: Diagnosis):
    if not made.terms:
        yield words(
            "No term was found whose gain is real on samples that no step had seen."
            if made.verdict == UNEXPLAINED
            else "No term is missing."
        )
    for term in made.terms:
        yield words(term.statement)
    if made.terms:
        yield table(
            [
                "term",
                "where",
                "p",
                "probability",
                f"size ({made.unit} RMS)",
                "t held out",
                "found again",
            ],
            [_row(term) for term in made.terms],
            left=2,
        )
    if figures.with_evidence(made):
        yield figure(
            "sizes",
            figures.evidence(made),
            "Chi-square that each term explains beside the others, its "
            "size, and t of its held-out gain.",
        )
    if made.refused:
        yield note("Found and not kept", [term.statement for term in made.refused])
    if made.outliers:
        shown = ", ".join(map(str, made.outliers[:20])) + (
            " ..." if len(made.outliers) > 20 else ""
        )
        yield note("Samples from another process", [f"Left out of the figures: {shown}."])


def _row(term: Term):
    found = term.finding
    name = found.effect + (f", {found.label}" if found.label else "")
    again = f"{term.again} of {term.chances}" if term.chances else "–"
    return (
        name,
        said.place(found.where),
        rounded(found.p_value, 2),
        f"{found.probability:.2f}",
        rounded(term.size),
        rounded(term.t, 2),
        again,
    )


def _place(made: Diagnosis):
    told = [one for one in made.located if one.p_value < 0.01]
    if not told:
        yield words(
            "No place stands out: no smooth function of anything that was recorded explains a share of the "
            "mismatch beyond chance, anywhere along the chain."
        )
    yield figure(
        "chain",
        chain(made),
        "The measuring chain from base to measured point. Area and colour: share of the "
        "baseline's mismatch that a smooth function of one or two covariates makes at that place. Named: what "
        "was found. Neighbouring places share what they cannot be told apart by.",
    )
    if told:
        rows = [
            (
                said.place(one.where),
                one.port,
                said.listed([said.covariate(c) for c in one.depends_on]),
                f"{100 * one.share:.0f} %",
                rounded(one.p_value, 2),
            )
            for one in told[:12]
        ]
        yield table(
            ["place", "port", "depends on", "share of the mismatch", "p, of the whole search"],
            rows,
            left=3,
        )
    rest = [one for one in made.rest if one.p_value < 0.01]
    if rest and made.terms:
        first = rest[0]
        yield words(
            f"Something is left even so: at {said.place(first.where)}, depending on "
            f"{said.listed([said.covariate(c) for c in first.depends_on])}, it makes {100 * first.share:.0f} % "
            "of what remains."
        )
    if made.fixed:
        yield words(made.fixed.sentence)


def _against(made: Diagnosis):
    shares = made.shares
    yield words(
        f"The mean squared distance between {shares.reference} and the recording, "
        f"{rounded(shares.total_mm2)} mm², is the sum of three: values that are merely not calibrated, noise, and "
        "structure that no value of what the reference holds can make. Only the last is missing physics."
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


def _proof(made: Diagnosis):
    proof, unit = made.proof, made.unit
    yield words(
        "First the whole: searched anew without a part of the samples, what is found must predict that part better. "
        "Then each term: without it, all others in place, the error of samples that were not fitted must be larger by "
        "more than luck (t > 2 over poses; errors count as in the fit, so that a few poses far off do not decide). "
        f"Last, its cause scrambled must gain nothing. Over all terms t = {proof.t:.1f}."
    )
    rows = [
        (
            s["folds_by"],
            s["folds"],
            rounded(s["before"]),
            rounded(s["after"]),
            rounded(s["after_same_terms"]),
            f"{s['t']:.1f}",
            "yes" if s.get("judges", True) else "no",
        )
        for s in proof.schemes
    ]
    yield table(
        [
            "folds",
            "number",
            f"before ({unit})",
            f"after, searched anew ({unit})",
            f"after, the terms above ({unit})",
            "t",
            "can judge the terms",
        ],
        rows,
    )
    yield figure(
        "heldout", figures.held_out(made), "Share of samples whose held-out error is smaller."
    )
    if proof.angles is not None:
        yield figure(
            "heldout-rotation", figures.held_out_rotation(made), "The same of the orientation."
        )
    controls = [
        _control(term, one) for term in (*made.terms, *made.refused) for one in term.controls
    ]
    if controls:
        yield table(["term", "control", "of its gain is left", "p", "", ""], controls, left=2)
    if proof.lack:
        yield _lack_of_fit(proof.lack, unit)


def _lack_of_fit(lack, unit):
    rows = [
        (
            name,
            rounded(row["f"]),
            rounded(row["p_value"], 2),
            rounded(row["means_rms"]),
            rounded(row["pure_error_rms"]),
        )
        for name, row in lack.items()
    ]
    return table(
        ["lack of fit", "F", "p", f"means over repeats ({unit})", f"pure error ({unit})"], rows
    )


def _control(term: Term, one):
    share = "–" if one.share is None else f"{100 * one.share:.1f} %"
    return term.title, one.kind, share, rounded(one.p_value, 2), _PASSED[one.passed], one.why


def _residuals(made: Diagnosis):
    if made.views is None:
        return
    yield words(
        f"Predicted minus measured, in {made.unit}, all samples, fitted. Left with the baseline, right with "
        "what was found."
    )
    space = figures.space if made.views.links is not None else figures.image
    yield pair(
        *(
            figure(f"space-{when}", space(made, when), text)
            for when, text in (
                ("before", "Baseline."),
                ("after", "With what was found, on the same scale."),
            )
        )
    )
    for k, (name, drawn) in enumerate(figures.over(made)):
        yield figure(
            f"over-{k}",
            drawn,
            f"Against {said.covariate(name)}: before grey, after blue; lines are means of "
            "bins of equal count.",
        )


def _doubt(made: Diagnosis):
    doubtful = [term for term in made.terms if term.finding.alternatives]
    if not doubtful:
        yield words(
            "Nothing else explains any of the terms as well: each has at least 95 % of the probability."
        )
    for term in doubtful:
        rows = [
            (
                f"{term.finding.effect} {term.finding.label}".strip(),
                said.place(term.finding.where),
                f"{term.finding.probability:.2f}",
                "100 %",
                "",
            )
        ]
        rows += [
            (
                f"{one.effect} {one.label}".strip(),
                said.place(one.where),
                f"{one.probability:.2f}",
                f"{100 * one.alike:.0f} %",
                one.missing and f"needs {one.missing}, not recorded" or one.why,
            )
            for one in term.finding.alternatives[:8]
        ]
        head = [
            f"instead of {term.title}",
            "where",
            "probability",
            "of the signature that it makes",
            "",
        ]
        yield table(head, rows, left=2)
    if made.not_recorded:
        yield note(
            "Not recorded",
            [
                f"{sentence(said.covariate(name))} Some of the names above depend on it."
                for name in made.not_recorded
            ],
        )


def _visible(made: Diagnosis):
    unit = made.unit
    yield words(
        "How large each effect would have had to be. Size: RMS displacement of the measured point that it makes by "
        "itself; visible: found with 95 % power at a false-alarm rate of 1 % for all together; survives: how much of "
        "its square the fitted baseline does not swallow; told apart: named with 95 % probability beside its nearest "
        "twin."
    )
    order = sorted(made.visible, key=lambda one: one.size if one.size is not None else np.inf)
    rows = [
        (
            f"{one.effect}{f', {one.label}' if one.label else ''}",
            said.place(one.where),
            rounded(one.size, 2),
            _parameter(one),
            f"{100 * one.survives:.1f} %",
            rounded(one.separable, 2),
            f"{one.twin} at {said.place(one.twin_where)}" if one.twin else "–",
        )
        for one in order[:_SMALLEST]
    ]
    yield table(
        [
            "effect",
            "where",
            f"visible from ({unit})",
            "that is",
            "survives",
            f"told apart from ({unit})",
            "twin",
        ],
        rows,
        left=2,
    )
    if len(order) > _SMALLEST:
        yield words(
            f"The other {len(order) - _SMALLEST} stand in smallest-visible.csv.", quiet=True
        )


def _parameter(one) -> str:
    return "–" if one.parameter is None else said.measured(one.parameter, None, one.unit)


def _next(made: Diagnosis):
    plan = made.experiment
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
                "samples more",
                "apart now (σ)",
                "apart then (σ)",
                "σ² a sample",
                "samples needed",
            ],
            rows,
        )
    if plan.scene:
        yield words(
            f"{SCENE} beside this page is that recording as a scene: workbench simulate {SCENE} tries it."
        )
