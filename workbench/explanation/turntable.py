"""The turntable of a scanner in a diagnosis: its angle law is tested on the images of a board that stands on it."""

from dataclasses import replace

from workbench.explanation.result import CONSISTENT, EXPLAINED, Diagnosis
from workbench.jobs.sensor.turntables import turntable_of_images

_NEXT = (
    "`workbench scan` corrects every scan by the angle law. A random error of the positions stays, and is part of the "
    "covariance of each ball centre; more images of the board on the table make the law more certain."
)


def with_turntable(diagnosis: Diagnosis, recording, progress) -> Diagnosis:
    """The diagnosis with the turntable of the recording, unchanged where there is none.

    An error of the angles is explained by its own law: F-tests retain its terms, and the leave-one-out error states
    what they gain. Raises InputError where the board does not turn with the table.
    """
    table = turntable_of_images(recording, progress)
    if table is None:
        return diagnosis
    if not table.has_step_error:
        return replace(diagnosis, turntable=table)
    verdict = EXPLAINED if diagnosis.verdict == CONSISTENT else diagnosis.verdict
    experiment = diagnosis.experiment
    if diagnosis.verdict == CONSISTENT:
        experiment = replace(experiment, sentence=_NEXT)
    return replace(diagnosis, turntable=table, verdict=verdict, experiment=experiment)
