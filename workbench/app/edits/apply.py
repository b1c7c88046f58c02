"""Application of the changes of a session to a recording and to a plan."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from workbench.app.data.numbers import rows_of
from workbench.app.edits.changes import ADDED, EFFECTS, IMAGES, POSES, SAMPLES, STAGES, effect_label
from workbench.app.edits.session import Session
from workbench.core.errors import InputError
from workbench.core.solution import Stage


def kept_rows(session: Session, recording) -> np.ndarray:
    """(n,) bool: rows of samples.csv that no change excludes. Raises InputError for samples that do not exist."""
    ids = recording.sample_ids
    samples = session.excluded(SAMPLES)
    poses = session.excluded(POSES)
    rows, missing = _rows_of_items(ids, samples)
    pose_rows, missing_poses = _rows_of_items(ids, poses)
    missing = np.sort(np.append(missing, missing_poses))
    if missing.size:
        raise InputError(
            f"session of recording '{recording.name}': sample {missing[0]} is excluded, but the recording has "
            "no such sample; name the recording that the session was made with"
        )
    is_included = np.ones(len(ids), bool)
    is_included[rows] = False
    if poses:
        labels = recording.poses
        is_excluded = np.zeros(labels.max() + 1, bool)
        is_excluded[labels[pose_rows]] = True
        is_included &= ~is_excluded[labels]
    return is_included


def _rows_of_items(ids: np.ndarray, items: frozenset) -> tuple[np.ndarray, np.ndarray]:
    """Rows of the samples with the numbers `items`, and those numbers that no sample has."""
    numbers = np.fromiter(items, int, len(items))
    rows, is_there = rows_of(ids, numbers)
    return rows[is_there], numbers[~is_there]


def edited_recording(session: Session, recording):
    """The recording without excluded samples, poses and images. Raises InputError.

    Where images belong to samples (column `sample` of images.csv), those of excluded samples are left out too.
    """
    images = session.excluded(IMAGES)
    missing = images - {row["image"] for row in recording.images}
    if missing:
        raise InputError(
            f"session of recording '{recording.name}': image '{min(missing)}' is excluded, but images.csv has no "
            "such image; name the recording that the session was made with"
        )
    is_included = kept_rows(session, recording)
    left_out = set(recording.sample_ids[~is_included].tolist())
    used = [
        k
        for k, row in enumerate(recording.images)
        if row["image"] not in images
        and ("sample" not in row or int(row["sample"]) not in left_out)
    ]
    edited = recording if is_included.all() else recording.select(is_included)
    if not edited.n and recording.n:
        raise InputError(
            f"session of recording '{recording.name}': all {recording.n} samples are excluded; include some of them"
        )
    return replace(edited, images=_chosen(recording.images, used))


def _chosen(images, places: list[int]):
    """The images at some places, in the form in which the recording keeps them."""
    if len(places) == len(images):
        return images
    return (
        [images[k] for k in places]
        if isinstance(images, list | tuple)
        else images[np.array(places, int)]
    )


@dataclass(frozen=True)
class EditedPlan:
    """A plan for `workbench.jobs.robot.calibrate`: called with the chain, it gives the stages that are left.

    session: names stages and effects that are left out or added. Raises InputError when called where a name
    is that of no stage or effect of the plan.
    """

    session: Session

    def __call__(self, chain) -> tuple[Stage, ...]:
        from workbench.fitting.calibration_plans.plans import plan_of_recording, read_plan

        named = self.session.plan
        base = read_plan(Path(named)) if named else plan_of_recording(chain)
        taken_keys = _keys_of(self._kept_additions(), chain)
        return self.edited(base, lambda row: bool(taken_keys & _keys_of([effect_row(row)], chain)))

    def edited(
        self,
        stages: Sequence[Stage],
        is_added: Callable[[tuple[str, str, dict]], bool] = lambda row: False,
    ) -> tuple[Stage, ...]:
        """The stages after all changes.

        is_added: whether an effect of the plan has parameters of an added one. It then stands in the stage of
        added effects alone, since a model holds every parameter once.
        """
        self._check_names(stages)
        excluded = self.session.excluded(STAGES)
        labels = self.session.excluded(EFFECTS)
        edited_stages = []
        for stage in stages:
            rows = kept_effects(stage.effects, labels, is_added)
            if stage.name in excluded or (stage.effects and not rows):
                continue
            choose = stage.choose and KeptChoice(stage.choose, labels, is_added)
            edited_stages.append(replace(stage, effects=rows, choose=choose))
        added = added_stage(self.session.added_effects)
        rows = kept_effects(added.effects, labels)
        if rows and ADDED not in excluded:
            edited_stages.append(replace(added, effects=rows))
        return tuple(edited_stages)

    def _kept_additions(self) -> tuple[dict, ...]:
        """Added effects that are part of the plan: none where their stage or their label is excluded."""
        if ADDED in self.session.excluded(STAGES):
            return ()
        labels = self.session.excluded(EFFECTS)
        return tuple(row for row in self.session.added_effects if not labels_of(row) & labels)

    def _check_names(self, stages: Sequence[Stage]) -> None:
        added = self.session.added_effects
        all_stages = [*stages, added_stage(added)] if added else [*stages]
        names = {stage.name for stage in all_stages}
        rows = [effect_row(row) for stage in all_stages for row in stage.effects]
        labels = {label for row in rows for label in labels_of(row)}
        chosen_later = {stage.name for stage in all_stages if stage.choose is not None}
        for kind, known in ((STAGES, names), (EFFECTS, labels)):
            missing = self.session.excluded(kind) - known
            if kind == EFFECTS:
                missing = {label for label in missing if not _may_choose(chosen_later, label)}
            if missing:
                raise InputError(
                    f"session of recording '{self.session.recording}', {kind}: '{min(missing)}' is excluded, but the "
                    f"plan has {', '.join(sorted(known)[:8]) or 'none'}; remove the change"
                )


@dataclass(frozen=True)
class KeptChoice:
    """The effects that a stage chooses on the samples, without those that a session excludes or adds itself.

    An effect is excluded by its name and place, whatever its options: they follow from the samples, so that another
    fit chooses the same effect with other ones.
    """

    choose: Callable
    labels: frozenset[str]
    is_added: Callable[[tuple[str, str, dict]], bool]

    def __call__(self, model, parameters) -> tuple[tuple[str, str, dict], ...]:
        places = {_place(label) for label in self.labels}
        rows = self.choose(model, parameters)
        remaining = [row for row in rows if _place(effect_label(effect_row(row))) not in places]
        return tuple(row for row in remaining if not self.is_added(row))


def kept_effects(
    rows: Sequence[tuple[str, str, dict]],
    labels: frozenset[str],
    is_added: Callable[[tuple[str, str, dict]], bool] = lambda row: False,
) -> tuple[tuple[str, str, dict], ...]:
    """The rows of effects whose label is not among the excluded `labels`, and which are not added elsewhere."""
    remaining = [row for row in rows if not labels_of(effect_row(row)) & labels]
    return tuple(row for row in remaining if not is_added(row))


def labels_of(row: dict) -> set[str]:
    """Labels that name an effect: with the options of its row, and with all options as solution.json states them."""
    from robot_model.effects import CATALOGUE
    from workbench.core.effect import make_effects

    (effect,) = make_effects(CATALOGUE, added_stage([row]).effects)
    complete = {"effect": row["effect"], "where": row["where"], **effect.options}
    return {effect_label(row), effect_label(complete)}


def _place(label: str) -> str:
    """The label of an effect without its options: "joint-curve at joint-3"."""
    return label.partition(" (")[0]


def _may_choose(stages: set[str], label: str) -> bool:
    """Whether a label names an effect of a stage that chooses its effects on the samples."""
    from robot_model.effects import CATALOGUE

    kind = CATALOGUE.get(label.partition(" at ")[0])
    return kind is not None and kind.stage in stages


def _keys_of(effects: Sequence[dict], chain) -> set[str]:
    """Keys of the parameters that effects bring to a chain."""
    from robot_model.effects import CATALOGUE
    from workbench.core.effect import make_effects

    effects_added = make_effects(CATALOGUE, added_stage(effects).effects)
    return {parameter.key for effect in effects_added for parameter in effect.parameters(chain)}


def effect_row(row: tuple[str, str, dict]) -> dict:
    """A row of `Stage.effects` as a table with the keys effect, where and the options."""
    effect, where, options = row
    return {"effect": effect, "where": where, **options}


def added_stage(effects: Sequence[dict]) -> Stage:
    """One stage with effects that were added by hand or ticked in a diagnosis."""
    rows = []
    for row in effects:
        options = {key: value for key, value in row.items() if key not in ("effect", "where")}
        rows.append((row["effect"], row["where"], options))
    return Stage(ADDED, "effects that were chosen in the app", tuple(rows))
