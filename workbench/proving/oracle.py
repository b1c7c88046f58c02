"""The oracle: a fit with the true effects of a case, and its held-out error.

It runs after unblinding. Oracle and diagnosis use the same models; the share of the oracle's gain therefore measures
the quality of the diagnosis, not that of the models.
"""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from workbench.core.effect import option_types
from workbench.files.runs import replace_file
from workbench.proving import protocol

_FOLDS = 5


def weigh(folder: Path, name: str) -> None:
    """Write the held-out errors of baseline and oracle on an unblinded case, and those on its validation part."""
    exam = protocol.BenchmarkRun(folder)
    truth = protocol.opened(exam, name, protocol.published(exam))
    record = protocol.read_object(exam.answer(name))
    try:
        found = _weighed(exam.recording(name), truth, record["answer"])
    except Exception as error:  # a failed oracle gives a note instead of figures
        found = {"oracle_note": f"{type(error).__name__}: {error}"}
    found["answer_seal"] = protocol.checksum(
        exam.answer(name)
    )  # the case is unblinded: its answer must not change from now on
    replace_file(exam.weighed(name), json.dumps(found, indent=1) + "\n")


def _weighed(recording: Path, truth: Mapping, answer: Mapping | None) -> dict:
    rows = rows_of(truth["effects"])
    if (
        truth["measures"] not in ("ball-centre", "external-point")
        or rows is None
        or "rule" in truth
    ):
        return {}
    import datasets

    found = datasets.read(recording)
    bench = Bench(found, truth["baseline"])
    before = bench.held_out(())
    after = bench.held_out(rows)
    out = {"oracle_before_mm": before, "oracle_after_mm": after}
    if truth.get("part"):
        part = np.isin(found.sample_ids, truth["part"])
        out |= {"part_before_mm": bench.part((), part), "part_oracle_mm": bench.part(rows, part)}
        out["part_after_mm"] = bench.part(claimed_rows(answer), part)
    return {key: None if value is None else float(value) for key, value in out.items()}


class Bench:
    """A recording with a baseline model; effects of the catalogue can be added."""

    def __init__(self, recording, baseline: str):
        from robot_model import load_robot
        from robot_model.effects.elastic import JointCompliance
        from robot_model.system import bind

        self.recording = recording.select(recording.moving)
        self.robot = load_robot(self.recording.robot, "robot")
        self.chain = bind(self.robot, self.recording)
        known = () if baseline == "geometry" else JointCompliance.candidates(self.chain)
        self.baseline = tuple(
            (baseline_variant.effect.effect, baseline_variant.effect.where, {})
            for baseline_variant in known
        )

    def model(self, rows: Sequence[tuple]):
        """Model and start values; base, geometry, tool and all effects are estimated, effects start near zero."""
        from robot_model.effects import CATALOGUE
        from workbench.core.effect import make_effects
        from workbench.core.model import Model
        from workbench.fitting.calibration_plans.plans import geometry, stage_mask

        added = {row[:2] for row in rows}
        baseline_rows = [row for row in self.baseline if row[:2] not in added]
        effects = make_effects(CATALOGUE, [*baseline_rows, *rows])
        model = Model(self.chain, effects)
        mask = stage_mask(model.parameters, geometry(self.robot), (), self.chain)
        mask[len(self.chain.parameters) :] = True
        return model, model.parameters.only(mask).nudged()

    def held_out(self, rows: Sequence[tuple]) -> float:
        """Held-out RMS of 3-D distances, mm; the folds are blocks of consecutive poses."""
        return self.predicted(rows).rms

    def predicted(self, rows: Sequence[tuple]):
        """The `workbench.fitting.cross_validation.HeldOut` of a fit with these effects."""
        from workbench.fitting.cross_validation import blocks, cross_validate

        model, start = self.model(rows)
        return cross_validate(model, start, blocks(self.recording.poses, _FOLDS), "linear")

    def part(self, rows: Sequence[tuple], part: np.ndarray) -> float:
        """RMS of 3-D distances, mm, on the samples `part` (n,) bool after a fit to all others."""
        from workbench.fitting.cross_validation import hold_out

        model, start = self.model(rows)
        return hold_out(model, start, part, ~part, "linear").rms


def rows_of(effects: Sequence[Mapping]) -> tuple[tuple, ...] | None:
    """Catalogue rows of the true effects; None if one of them is not in the catalogue or is a random effect."""
    if any(not _is_modelled(effect["effect"]) for effect in effects) or not effects:
        return None
    return tuple(
        (effect["effect"], effect["where"], _typed(effect["effect"], effect["detail"]))
        for effect in effects
    )


def _is_modelled(effect: str) -> bool:
    """True if the catalogue has an effect of this name and it is not on the noise port."""
    from robot_model.effects import CATALOGUE
    from workbench.core.model import NOISE

    return effect in CATALOGUE and CATALOGUE[effect].port != NOISE


def _typed(effect: str, stated: Mapping) -> dict:
    """The stated values that are options of the effect, with the types of its constructor."""
    from robot_model.effects import CATALOGUE

    taken = option_types(CATALOGUE[effect])
    return {
        name: float(value) if taken[name] is float else value
        for name, value in stated.items()
        if name in taken
    }


def claimed_rows(answer: Mapping | None) -> tuple[tuple, ...]:
    """Catalogue rows of the claims. Claims without their options are dropped."""
    claims = answer["effects"] if answer else ()
    rows = ((c["effect"], c["where"], _options(c)) for c in claims if _is_modelled(c["effect"]))
    return tuple((effect, where, options) for effect, where, options in rows if options is not None)


def _options(claim: Mapping) -> dict | None:
    """Options of the claimed effect; None if the effect has options and the answer states none."""
    from robot_model.effects import CATALOGUE

    stated = claim.get("options")
    if stated:
        return _typed(claim["effect"], stated)
    return None if option_types(CATALOGUE[claim["effect"]]) else {}
