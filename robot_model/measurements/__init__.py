"""Kinds of measurement: one file each; a kind closes the chain between world and flange.

A kind is a frozen dataclass made from a `datasets.recording.Recording` by `of(recording)`, with

- `parameters()`: what it adds to the chain (hand-eye, reflectors), keys at `tool` or `sensor`;
- `close(frames, values, deltas)`: a `Closure`, the residual and how motions reach it;
- `start(frames)`: base pose (6,) and own values in closed form, no guess needed;
- `place`, "tool" or "sensor": where on the flange it sits; `grounded`: True where nothing but the
  arm itself says where the base is, so that there is no base pose (6,) but (0,);
- `at(samples)`: the same for some of the samples;
- `columns(residual)`: what the model predicts, as columns of samples.csv;
- `poses_per_sample`, where it is not 1: number of arm poses that make one sample (2 for a measured length);
- `numbers`, `targets(values)`, `sigma(recording)`: which target, where it is nominally, how sure.

The first three of the m components are a position in mm; a kind with fewer has only lengths. A kind
that must look at the poses before it can number its parameters has `oriented(frames)`.
"""

from importlib import import_module

from datasets.recording import OTHER
from robot_model.measurements.distance import paired, second_ends
from workbench.core.errors import InputError

KINDS = {
    "ball-centre": "BallCentre",
    "external-point": "ExternalPoint",
    "external-pose": "ExternalPose",
    "partial-pose": "PartialPose",
    "touch-point": "TouchPoint",
    "laser-spot": "LaserSpot",
    "plane-touch": "PlaneTouch",
    "ball-surface": "BallSurface",
    "distance": "Distance",
}

_IN_MEMORY = {"ball-scan": "BallScan"}
"""Kinds that are made of others, and that no file holds."""


def samples_of(recording):
    """The rows of a recording that a calibration takes, one a sample: those of the tool, and of a pair its first.

    A row that is an exact copy of an earlier one is left out, and the recording's `warnings` name it.
    Raises InputError where a pair is not whole.
    """
    moving = recording.select(recording.moving)
    samples = paired(moving) if recording.measures == "distance" else moving
    return samples.without_duplicates()


def end_recordings(recording) -> tuple:
    """Recordings with one arm pose per sample: the recording itself, or first and second ends of measured lengths."""
    if recording.measures != "distance":
        return (recording,)
    if OTHER + "sample" not in recording.columns:  # `samples_of` was not asked
        raise InputError(
            f"recording '{recording.name}', key measures: lengths between two rows are not taken by this command, "
            "found 'distance'; use `workbench calibrate`, `compare`, `identifiability` or `poses`"
        )
    return recording, second_ends(recording)


_OTHER_COMMAND = {
    "target-pose": "`workbench handeye`",
    "board-images": "`workbench camera` or `workbench handeye`",
}
"""What takes a recording that says nothing about the joints."""


def check_measures(recording) -> None:
    """Raise InputError for a recording of a kind that does not calibrate an arm, with the command that takes it."""
    if recording.measures in {**KINDS, **_IN_MEMORY}:
        return
    other = _OTHER_COMMAND.get(recording.measures)
    remedy = f"; use {other} for this recording" if other else ""
    raise InputError(
        f"recording.toml of '{recording.name}', key measures: '{recording.measures}' cannot be calibrated as an arm; "
        f"expected one of {', '.join(KINDS)}{remedy}"
    )


def measurement_of(recording):
    """The measurement that `recording.measures` names; InputError for one that is not known here."""
    check_measures(recording)
    module = import_module("robot_model.measurements." + recording.measures.replace("-", "_"))
    return getattr(module, {**KINDS, **_IN_MEMORY}[recording.measures]).of(recording)
