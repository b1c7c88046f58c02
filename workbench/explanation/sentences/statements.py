"""One paragraph on each finding: what it is, how large, how it was validated, and what else explains these poses."""

import re
from collections.abc import Sequence

import numpy as np

from robot_model.effects.friction import ReadingLattice
from sensors.effects.laser import GhostLine
from sensors.effects.optics import Blooming
from workbench.core.common_effects import NoiseLaw
from workbench.core.least_squares.adjustment_tests import p_text
from workbench.diagnosis.levels import LISTED_PROBABILITY
from workbench.diagnosis.linear.hypotheses import Hypothesis
from workbench.diagnosis.linear.problem import Alternative, Finding, Found
from workbench.diagnosis.noise.random_effect_findings import LAST_MOVE_LABEL
from workbench.diagnosis.robot.derived import DEFLECTION
from workbench.diagnosis.robot.mass_responses import LABEL as ESTIMATED_MOMENTS
from workbench.diagnosis.scanner.image_jitter import EFFECT as JITTER
from workbench.diagnosis.scanner.random_focal_length import LABEL as RANDOM_FOCAL_LENGTH
from workbench.diagnosis.search.constant_load import UNSTATED_LOAD
from workbench.diagnosis.search.findings import SAME_FUNCTION
from workbench.explanation.noise.heavy_tails import EFFECT as HEAVY_TAILED
from workbench.explanation.noise.hidden_harmonics import WHY as LIKE_NOISE
from workbench.explanation.result import Term
from workbench.explanation.sentences.words import (
    covariate,
    figures,
    law,
    length,
    listed,
    measured,
    place,
)

BY_POSE = (
    "the residual is larger than the scatter of repeats of one pose, without a place or a covariate"
)
NOT_LOCATED = "not located: no smooth function of one or two covariates at any place is significant"
NEIGHBOURS = "alike at neighbouring values of "
LINE_STRUCTURE = "laser line: "
UNCONFIRMED = "found in the first search, not confirmed by cross-validation"
_OF_DATA = ("outliers", NoiseLaw.effect, "encoder-quantisation", ReadingLattice.effect)
_EITHER = "with temperature, or with time where none was recorded"
_INSTANT = re.compile(r"after (?:row )?(?P<value>\d+(?:\.\d+)?(?:e[+-]?\d+)?)(?P<unit> s)?\b")
_IN_BRACKETS = re.compile(rf" \({_INSTANT.pattern}\)")
_MAX_ALTERNATIVES = 3  # alternatives that are listed
_CLEAR = 0.95  # probability from which on no alternative is listed


def with_sample_numbers(text: str, order: np.ndarray, ids: np.ndarray) -> str:
    """A statement whose instants name the samples before and after: "between samples 96 and 97".

    order (n,): clock of the samples, s or the number of the row from 0; ids (n,): their numbers.
    """
    rank = np.argsort(order, kind="stable")

    def name(found: re.Match) -> str:
        later = int(np.searchsorted(order[rank], float(found["value"])))
        if not 0 < later < len(rank):
            return found[0]
        interval = f"between samples {ids[rank[later - 1]]:g} and {ids[rank[later]]:g}"
        if found["unit"]:
            return f"at {found['value']} s, {interval}"
        return interval

    return _INSTANT.sub(name, text)


def instants_in_brackets(text: str, order: np.ndarray, ids: np.ndarray) -> str:
    """`with_sample_numbers` of what stands in brackets alone: "zero-shift (between samples 29 and 30) at joint 3"."""
    return _IN_BRACKETS.sub(lambda found: with_sample_numbers(found[0], order, ids), text)


def statement(term: Term, tip: str, unit: str) -> str:
    """One paragraph on one finding. tip: what the displacement is of ('the ball')."""
    found = term.finding
    sentences = [_cause(term, tip, unit), _masses(found), _places(found), _validated(term, unit)]
    sentences += [f"Alarm: {alarm}." for alarm in found.alarms]
    # what a refused term may be called instead is of no use
    sentences.append(_uncertainty(found) if term.kept else f"Reason: {term.reason}.")
    return " ".join(sentence for sentence in sentences if sentence)


def _cause(term: Term, tip: str, unit: str) -> str:
    found = term.finding
    if term.share is not None:
        return _of_structure(term)
    if found.effect == "stated-noise":
        return _of_stated_noise(term)
    if found.effect == HEAVY_TAILED:
        return _of_heavy_tails(term)
    if found.effect == JITTER:
        return _of_jitter(term)
    if found.effect == GhostLine.effect and not found.effects:
        return _of_ghost_line(term)
    if found.label == RANDOM_FOCAL_LENGTH:
        return _of_focal_length(term)
    if found.label == NOT_LOCATED and _unconfirmed(found):
        text = f"The residual contains structure that is not explained ({p_text(found.p_value)}), most likely at"
        return f"{text} {place(found.where)}.{_unconfirmed(found)}"
    if found.label.startswith(NEIGHBOURS):
        return (
            "The residual is larger than the stated noise and contains structure that no effect of the catalogue "
            f"explains, most likely at {place(found.where)}: it is {found.label} ({p_text(found.p_value)}), which "
            "noise of no size is."
        )
    if found.label.startswith(LINE_STRUCTURE):
        return _of_laser_line(found)
    if found.effect == "unknown" and found.label in (BY_POSE, NOT_LOCATED):
        return (
            "The residual contains structure that no effect of the catalogue explains: "
            f"{found.label} ({p_text(found.p_value)})."
        )
    if found.effect in _OF_DATA or (
        found.effect == "unknown" and not found.effects and not found.depends_on
    ):
        return _of_data(found)
    size = _size(term, tip, unit)
    if found.effect == "unknown":
        depends = _depends(found) or "no recorded covariate"
        text = (
            f"{place(found.where).capitalize()} has an error that depends on {depends}, and no tested effect of the "
            "catalogue describes it as well"
        )
        return f"{text}{': ' + size if size else ''}."
    return _of_law(term, size)


def _masses(found: Finding) -> str:
    """Why the first moments of the links had to be estimated, although masses are stated; "" where they were not."""
    if not found.label.startswith(ESTIMATED_MOMENTS):
        return _unstated_load(found)
    return (
        "The stated masses do not explain this deflection: masses or centres of mass in the robot file are wrong, or "
        "the tool carries a load that is not recorded. To distinguish them, weigh the tool with its load, or measure "
        "some of the poses again with a known additional load."
    )


def _unstated_load(found: Finding) -> str:
    """That the compliance holds without a load that is not recorded, where the poses do not exclude one; else ""."""
    load = next((a for a in found.alternatives if a.why == UNSTATED_LOAD), None)
    if load is None:
        return ""
    masses = f" ({load.detail})" if load.detail else ""
    return (
        f"If the tool carried a load that is not recorded{masses}, the compliance would be smaller: these poses do not "
        "distinguish the two. Weigh the tool with its load, or measure some of the poses again with a known additional "
        "load."
    )


def _places(found: Finding) -> str:
    """The places that no pose distinguishes from that of a function without a law; "" where there are none."""
    others = [
        place(alternative.where)
        for alternative in found.alternatives
        if alternative.why == SAME_FUNCTION
    ]
    if not others:
        return ""
    all_places = [place(found.where), *others]
    return (
        f"No pose distinguishes {listed(all_places)} as its place: a function of {_depends(found)} at one of them is "
        "also one at the other."
    )


def _depends(found: Finding) -> str:
    return listed([covariate(name) for name in found.depends_on])


def _size(term: Term, tip: str, unit: str) -> str:
    """RMS displacement by a term; of a deflection of unknown mean, which the geometry absorbs, its variation."""
    if term.size is None:
        return ""
    has_deflection = any(row["name"] == DEFLECTION for row in term.parameters)
    kind = "RMS about its mean" if has_deflection else "RMS"
    return f"{length(term.size, unit)} {kind} {f'at {tip}' if unit == 'mm' else 'in the image'}"


def _of_law(term: Term, size: str) -> str:
    """A law of the catalogue with its parameters."""
    found = term.finding
    kind = type(found.effects[0]) if found.effects else None
    sentence = law(found.effect, found.where, label_of(found), kind)
    numbers = figures(term.parameters) if term.parameters else ""
    numbers = _IN_BRACKETS.sub("", numbers)  # the law states the instant once
    warms_up = any(getattr(effect, "time_constant_s", 0) for effect in found.effects)
    by_time = warms_up or any(row["unit"].endswith("/h") for row in term.parameters)
    sentence = sentence.replace(
        _EITHER, "with time (no temperature was recorded)" if by_time else "with temperature"
    )
    if numbers or size:
        return f"{sentence}: {', '.join(filter(None, (numbers, size)))}."
    return f"{sentence}."


def _of_structure(term: Term) -> str:
    """Structure that is not explained, and the function that explains the largest share of it."""
    found = term.finding
    function = f"A smooth function of {_depends(found)} at {place(found.where)} explains"
    share = f"{100 * term.share:.0f} %"
    if term.remainder:
        text = f"Structure remains that no retained effect explains. {function} {share} of it."
        return text + _unconfirmed(found)
    return (
        f"The residual contains structure that is not explained. {function} {share} of the residual, but no model "
        f"that was fitted to some of the poses predicts the others.{_unconfirmed(found)}"
    )


def label_of(found: Finding) -> str:
    """The label of a finding, an option that was estimated with its standard deviation and unit."""
    option = found.option
    if option is None or option.word.format(option.value) != found.label:
        return found.label
    text = option.word.replace(f"{{:g}} {option.unit}", "{}").replace("{:g}", "{}")
    return text.format(measured(option.value, option.std, option.unit))


def _unconfirmed(found: Finding) -> str:
    """The most probable effect at the place of an unknown, if it was found there and not retained; else ""."""
    for alternative in found.alternatives:
        if alternative.why == UNCONFIRMED:
            label = f" ({alternative.label})" if alternative.label else ""
            return (
                f" The most probable cause there is {alternative.effect}{label}, with a probability "
                f"of {_probability(alternative)} in "
                "the first search. Cross-validation did not confirm it, so it is not corrected."
            )
    return ""


def _of_jitter(term: Term) -> str:
    """Standard deviation of random displacements of whole stripes, possible causes, and what to do."""
    row = term.parameters[0]
    return (
        f"Whole stripes are displaced at random from image to image by {row['value']:.2g} ± {row['std']:.1g} px "
        "(1 sigma): jitter or vibration of the mirror or the arm, or irregular timing. No recorded covariate predicts "
        "it, so no correction can remove it. Average several sweeps, let the arm settle, or record what changes "
        "between images."
    )


def _of_focal_length(term: Term) -> str:
    """Standard deviation of the focal length between images, possible causes, and what to do."""
    row = term.parameters[0]
    return (
        f"The focal length differs at random from image to image by {100 * row['value']:.2g} ± "
        f"{100 * row['std']:.1g} % (1 sigma), which displaces corners by {row['size_px']:.2g} px RMS: the lens is "
        "focused again between images, or it is loose. No recorded covariate and no law of camera, window or board "
        "predicts it, so no correction can remove it. Lock focus and zoom, and take the images again."
    )


def _of_laser_line(found: Finding) -> str:
    """Anomaly of the laser line in the images, its dependence, and what to do."""
    label = found.label.removeprefix(LINE_STRUCTURE)
    if found.effect == Blooming.effect:
        return (
            f"The laser line shows blooming or overexposure: {label}. It depends on {_depends(found)}. No fitted law "
            "predicts it on held-out board poses, so it is not corrected. Expose less, so that no pixel is full, and "
            "take the images again."
        )
    depends = f" and depends on {_depends(found)}" if found.depends_on else ""
    return (
        f"The laser line has structure that no effect of the catalogue explains: {label}. It belongs to "
        f"{place(found.where)}{depends}. The warning says what to look for."
    )


def _of_ghost_line(term: Term) -> str:
    """Brightness and distance of a second line, what makes it, and what to do."""
    share, offset, offset_mm = term.parameters
    brightness = f"{100 * share['value']:.0f} ± {100 * share['std']:.1g} %"
    distance = measured(offset_mm["value"], offset_mm["std"], "mm")
    return (
        f"The profile of the laser line is that of two lines: a second one with {brightness} of the brightness, "
        f"{measured(offset['value'], offset['std'], 'px')} from the first ({distance} along the normal of the light "
        f"plane). It moves the centre by {term.size:.2g} px; light planes and scans are displaced alike as long as the "
        "line looks alike. Look for a reflection in a cover glass, a filter or the mirror, and tilt or remove it."
    )


def _of_stated_noise(term: Term) -> str:
    """The factor by which the stated noise is wrong, why that matters and what to do."""
    row = next(iter(term.parameters), None)
    if row:
        factor = f"{row['value']:.2f} ± {row['std']:.2f} times"
    else:
        factor = "not"
    source = term.finding.label.rpartition(", ")[2]
    harmonics = [a for a in term.finding.alternatives if a.why == LIKE_NOISE]
    if harmonics:
        joints = listed([place(harmonic.where) for harmonic in harmonics])
        return (
            f"The residual is larger than the stated noise: {source} the standard deviation is {factor} the stated "
            "sigma. Either the stated noise is wrong, or further joints have transmission errors as well: harmonics "
            f"of a high order at {joints} look like noise in so few poses. Do not correct sigma_mm before this is "
            "decided. Measure one of these joints at a time in small steps, more poses, or repeats of one pose, which "
            "show the noise alone."
        )
    return (
        f"The recording states the wrong noise: {source} the standard deviation is {factor} the stated sigma. "
        "All results below use the noise that was found. Correct sigma_mm in the recording: calibration and "
        "tolerances rely on it."
    )


def _of_heavy_tails(term: Term) -> str:
    """The degrees of freedom, the RMS, what that does to the results, and what to do."""
    degrees, factor = term.parameters
    return (
        "The noise has heavier tails than a Gaussian: a Student's t distribution with "
        f"{degrees['value']:.2g} ± {degrees['std']:.1g} degrees of freedom describes it. Its RMS is "
        f"{factor['value']:.2f} ± {factor['std']:.2f} times the stated sigma, mostly by few samples, to which all fits "
        "give less weight. All results below use the RMS that was found. Look for what disturbs single samples: "
        "reflections, air, an arm that had not settled."
    )


def _of_data(found: Finding) -> str:
    """Sentence on a fault of the data or a random effect, which no parameter describes."""
    if found.effect == "outliers":
        return f"{found.label} samples come from another process: they lie farther off than the others' spread allows."
    if found.effect == NoiseLaw.effect:
        depends = listed([covariate(name) for name in found.depends_on])
        return f"The noise is not the same everywhere: its spread goes with {depends}."
    if found.effect == ReadingLattice.effect:
        return f"The readings of {place(found.where)} are rounded, {found.label}."
    if found.effect == "encoder-quantisation":
        return f"The reading of {place(found.where)} is rounded to counts."
    if found.label == LAST_MOVE_LABEL:
        return (
            "The joints were read at differing moments before the arm stood still: the residuals point back along the "
            "last moves, by another share of them each time."
        )
    sentence = (
        f"{_with_random_error(found.where)} a random error from sample to sample, which depends on no recorded "
        "covariate: the residuals have the directions in which such an error moves the measured point."
    )
    could = [
        f"{alternative.effect} at {place(alternative.where)} with {covariate(alternative.missing_covariate)}"
        for alternative in found.alternatives
        if alternative.missing_covariate
    ]
    return sentence + (
        f" It may be {listed(could, 'or')}, none of which this recording holds." if could else ""
    )


def _with_random_error(where: str) -> str:
    if where == "time":
        return "The instant at which the joints are read has"
    return f"{place(where).capitalize()} has"


def _validated(term: Term, unit: str) -> str:
    """The held-out gain and in how many folds the search finds the term again."""
    if term.gain is None:
        return ""
    verb = "reduces" if term.gain > 0 else "increases"
    t = f" (t = {term.t:.1f})" if term.t is not None else ""
    text = f"It {verb} the held-out RMS error by {length(abs(term.gain), unit)}{t}"
    if term.t is not None and term.t * term.gain <= 0:  # few large errors against many small ones
        text = f"It does not change the held-out RMS error significantly{t}"
    if term.searched_folds:
        text += f" and is reselected in {term.reselected_folds} of {term.searched_folds} folds"
    return f"{text}."


def _uncertainty(found: Finding) -> str:
    """The probability of a name that is not certain, and those of the most probable other ones."""
    others = [
        alternative
        for alternative in found.alternatives
        if alternative.why not in (UNCONFIRMED, SAME_FUNCTION, UNSTATED_LOAD)
    ]
    if not others or found.probability >= _CLEAR:
        return ""
    likely = [
        alternative for alternative in others if alternative.probability >= LISTED_PROBABILITY
    ] or others[:1]
    likely = sorted(likely, key=lambda alternative: -alternative.probability)
    texts = [_other(alternative) for alternative in likely[:_MAX_ALTERNATIVES]]
    unlisted_count = len(likely) - _MAX_ALTERNATIVES
    if unlisted_count > 0:
        texts.append(
            f"{unlisted_count} {'others are' if unlisted_count > 1 else 'other is'} less probable"
        )
    if likely[0].probability - found.probability > LISTED_PROBABILITY:
        own_probability = (
            f"this effect, which the model contains, has a probability {_of_probability(found)}"
        )
        texts = [texts[0], own_probability, *texts[1:]]
        return f"In these poses another cause is more probable: {'; '.join(texts)}."
    return (
        f"In these poses the name is not certain. This effect has a probability {_of_probability(found)}; "
        f"{'; '.join(texts)}."
    )


def _other(alternative) -> str:
    """An alternative with its probability."""
    label = f" ({alternative.label})" if alternative.label else ""
    name = "an unnamed effect" if alternative.effect == "unknown" else alternative.effect
    missing = ""
    if alternative.missing_covariate:
        missing = f" if {covariate(alternative.missing_covariate)} changed, which this recording does not hold"
    return f"{name} at {place(alternative.where)}{label} {_probability(alternative)}{missing}"


def _of_probability(finding) -> str:
    text = _probability(finding)
    return text if text.startswith("below") else f"of {text}"


def _probability(finding) -> str:
    if finding.probability >= 0.005:
        return f"{finding.probability:.2f}"
    return "below 0.01"


def first_terms(terms: Sequence[Hypothesis]) -> str:
    """The first terms of a search, long before it ends."""
    names = dict.fromkeys(f"{term.effect} at {place(term.where)}" for term in terms)
    return f"First terms of the search, still refined: {listed(list(names))}."


def preliminary(found: Found) -> str:
    """Sentence on the findings of the first search, before validation: each by its most probable name."""
    names = [
        f"{named.effect} at {place(named.where)} ({_probability(named)})"
        for named in map(_most_probable_name, found.findings)
    ]
    if not names:
        return "First result, not yet validated: no unmodelled effect was found."
    return (
        f"First result with probabilities, not yet validated: {listed(names)}. Cross-validation may reject some of "
        "them."
    )


def _most_probable_name(finding: Finding) -> Finding | Alternative:
    """The finding, or the alternative that is more probable; one that needs a missing covariate is none."""
    others = [other for other in finding.alternatives if not other.missing_covariate]
    return max((finding, *others), key=lambda named: named.probability)


def provisional_keys(sentence: str, effects: Sequence[Hypothesis | Finding]) -> dict:
    """Keys of the first result, which is not validated; a term of a search that goes on has no probability yet."""
    rows = []
    for found in effects:
        row = {"effect": found.effect, "where": found.where, "label": found.label}
        if isinstance(found, Finding):
            row["probability"] = found.probability
        rows.append(row)
    return {"provisional": True, "statement": sentence, "effects": rows}
