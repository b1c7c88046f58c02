"""Sentences of the plausibility checks."""

import numpy as np

from workbench.fitting.plausibility.hypotheses.corrections import listed

__all__ = [
    "change_point_sentence",
    "correction_sentence",
    "deviation_sentence",
    "far_parameters",
    "fit_words",
    "listed",
]

_SHOWN = 4
_FLANGE_TARGET = "the target on the flange"


def fit_words(fit) -> str:
    """'12.3 mm' or '12.3 mm and 45 deg': RMS misfit of the best 90 % of the rows."""
    position = f"{fit.position_mm:.3g} mm"
    if np.isnan(fit.rotation_deg):
        return position
    return f"{position} and {fit.rotation_deg:.2g} deg"


def change_point_sentence(named, change) -> str:
    """Sentence on a change point: moved object, instant, distance, and what to do."""
    if change.moved_object == _FLANGE_TARGET:
        remedy = (
            f"if the reflector was remounted, give it another number in column reflector from sample {change.after} "
            "on, which uses all rows; otherwise find the jump"
        )
    else:
        remedy = "find the jump"
    if change.is_load:
        event = f"{change.moved_object} has changed (its deflection moves the"
        remedy = f"record the load (column payload_kg), {remedy}"
    else:
        event = f"{change.moved_object} has moved (the"
    others = ""
    if change.others:
        others = f"; these poses do not distinguish it from {' or '.join(change.others)}"
    return (
        f"{named}, samples {change.before} and {change.after}: between them {event} measured points by about "
        f"{change.shift_mm:.3g} mm){others}; no single model fits both parts; {remedy} with `workbench diagnose`, "
        "calibrate the parts separately, or measure again."
    )


def correction_sentence(recording, recorded, explanation, others) -> str:
    """Why a correction is needed: how the data fit with and without it.

    recorded: fit of the data as they are. others: corrections that explain the data as well.
    """
    correction, fit = explanation.correction, explanation.fit
    as_well = f" (equally well explained: {others[0].claim})" if others else ""
    file = (
        "" if correction.subject.startswith(("artefact.csv", "robot file")) else "samples.csv of "
    )
    return (
        f"{file}recording '{recording.name}', {correction.subject}: expected measurements that belong to the joint "
        f"readings, found that base, tool and plausible geometry errors fit them to {fit_words(recorded)} as recorded, "
        f"but to {fit_words(fit)} if {correction.claim}{as_well}; {correction.remedy}."
    )


def deviation_sentence(recording, fit, limit) -> str | None:
    """Geometry parameters that are many prior standard deviations from the robot file, or None."""
    rows = far_parameters(fit, limit)
    if not rows:
        return None
    return (
        f"robot file of recording '{recording.name}': the data fit only with {listed(rows)}, far more than the errors "
        "of a data sheet; check these numbers of the robot file and the zero position of the arm."
    )


def far_parameters(fit, limit) -> tuple[str, ...]:
    """At most four geometry parameters more than `limit` prior standard deviations from the robot file, in words."""
    keys = np.array(fit.parameters.keys)[fit.parameters.mask]
    deviating = np.flatnonzero(np.abs(fit.deviations) > limit)
    ordered = deviating[np.argsort(-np.abs(fit.deviations[deviating]))][:_SHOWN]
    return tuple(_deviation(fit.parameters, keys[k]) for k in ordered)


def _deviation(parameters, key) -> str:
    row = parameters.table[parameters.index[key]]
    value, nominal = parameters[key], row.null
    if row.unit == "rad":
        return f"{key.partition('.')[2]} = {np.rad2deg(value):.4g} deg instead of {np.rad2deg(nominal):.4g}"
    return f"{key.partition('.')[2]} = {value:.5g} mm instead of {nominal:.5g}"
