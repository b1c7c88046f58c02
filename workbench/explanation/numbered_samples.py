"""Statements and labels of a diagnosis in which instants lie between samples, by the numbers of the recording."""

from dataclasses import replace

import numpy as np

from robot_model.effects.steps import TargetShift
from workbench.diagnosis.linear.problem import Finding
from workbench.explanation.final_model import FinalModel
from workbench.explanation.result import Diagnosis, Term, with_statements
from workbench.explanation.sentences import statements, words


def with_sentences(diagnosis: Diagnosis, last: FinalModel) -> Diagnosis:
    """With the statement of each term, in which samples are counted as the recording counts them."""
    point = words.TIPS.get(diagnosis.measures, "the measured point")
    order = diagnosis.found.before.order
    sentences, numbered = [], {"terms": [], "refused": []}
    for name, terms in numbered.items():
        for term in getattr(diagnosis, name):
            text = statements.statement(term, point, diagnosis.unit)
            samples = _own_samples(last.bench.chain, term)
            numbers = order[samples], last.ids[samples]
            sentences.append(statements.with_sample_numbers(text, *numbers))
            terms.append(with_numbered_label(term, *numbers))
    planned = statements.instants_in_brackets(diagnosis.experiment.sentence, order, last.ids)
    experiment = replace(diagnosis.experiment, sentence=planned)
    fresh = replace(
        diagnosis,
        terms=tuple(numbered["terms"]),
        refused=tuple(numbered["refused"]),
        experiment=experiment,
    )
    return with_statements(fresh, sentences)


def with_numbered_label(term: Term, order: np.ndarray, ids: np.ndarray) -> Term:
    """The term, its own label and those of its alternatives with the numbers of samples."""

    def number(described):
        label = statements.with_sample_numbers(described.label, order, ids)
        return described if label == described.label else replace(described, label=label)

    finding: Finding = number(term.finding)
    alternatives = tuple(number(alternative) for alternative in finding.alternatives)
    return replace(term, finding=replace(finding, alternatives=alternatives))


def _own_samples(chain, term: Term) -> np.ndarray | slice:
    """The samples between which a term may begin: (n,) bool of the target that moved, all where it is no target."""
    moved = [e for e in term.finding.effects if isinstance(e, TargetShift)]
    if moved:
        return moved[0].is_observed(chain.state)
    return slice(None)


__all__ = ["with_numbered_label", "with_sentences"]
