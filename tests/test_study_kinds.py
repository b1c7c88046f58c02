"""Each kind of study says what is true of its world: compliance, sensor, uncertainty, design; and its page."""

from functools import partial

import numpy as np
import pytest

import study_scenes as scenes
from workbench.machine import processes
from workbench.studies import resampling, robots, tables
from workbench.studies.engine import carry_out, given, parts_of
from workbench.studies.runs import row_of, seed_of
from workbench.studies.spec import read_study, study_names
from workbench.studies.study import Finished, read
from workbench.studies.summary import summary
from workbench.studies.variation import values_of, with_values


def finished(study, place, runs=None):
    """The study done here, in this process, with as many runs."""
    from concurrent.futures import ThreadPoolExecutor

    if runs:
        study = study.model_copy(
            update={"vary": study.vary.model_copy(update={"runs": runs, "method": "random"})}
        )
    (place / tables.PARTS_FOLDER).mkdir(parents=True)
    with ThreadPoolExecutor(1) as pool:
        done = carry_out(study, place, partial(given, pool), 1, lambda done, total: None)
    tables.put_together(place, len(parts_of(study)))
    return Finished("study", study, place, done)


def test_error_without_calibration_is_the_sag_alone_and_grows_with_compliance(tmp_path):
    study = read(scenes.written(tmp_path))[0]
    rows = [row_of(study, run) for run in (1, 2)]
    for row in rows:
        # one joint is compliant: the error is proportional to its compliance, and half of it with the joint twice as stiff
        assert row["joint-2_twice_as_stiff_test_mm"] == pytest.approx(
            row["uncalibrated_test_mm"] / 2, rel=1e-3
        )


def test_the_joint_to_stiffen_is_the_one_that_carries_the_arm(tmp_path):
    made = finished(read("compliance-joints")[0], tmp_path / "made", 120)
    found = summary(made)
    left = {row["joint"]: row["error_left"] for row in found["stiffen"]}
    assert min(left, key=left.get) == "joint-2" and left["joint-4"] > 0.9 and left["joint-2"] < 0.8
    assert found["sentences"][0].startswith("Joint 2 is the joint to stiffen")
    shares = {row["parameter"]: row["first"] for row in found["sensitivity"]["indices"]}
    assert max(shares, key=shares.get) == "joint_2"


def test_compliance_in_the_model_removes_what_geometry_cannot(tmp_path):
    row = row_of(read("compliance-error")[0], 1)
    for load in (0, 1, 2, 3):
        assert (
            row[f"nominal_test_{load}kg_mm"]
            > row[f"geometry_test_{load}kg_mm"]
            > 5 * row[f"joint-compliance_test_{load}kg_mm"]
        )
    assert row["joint-compliance_compensated_mm"] < 0.2 * row["programmed_mm"]
    assert row["joint-compliance_compensated_mm"] < row["geometry_compensated_mm"]


def test_saltelli_indices_are_those_of_an_additive_outcome(tmp_path):
    study = read("compliance-joints")[0]
    study = study.model_copy(update={"vary": study.vary.model_copy(update={"runs": 6 * 256})})
    axes = study.vary.parameter
    rows = []
    for run in range(1, 6 * 256 + 1):
        values = values_of(study, run)
        unit = [(values[axis.name] - axis.low) / (axis.high - axis.low) for axis in axes]
        rows.append(
            {
                "run": run,
                **values,
                "uncalibrated_tasks_mm": float(np.dot(unit, [4, 2, 1, 0])),
                "outcome": "done",
            }
        )
    (tmp_path / tables.PARTS_FOLDER).mkdir()
    tables.write_part(tmp_path, 0, rows)
    tables.put_together(tmp_path, 1)
    from workbench.studies.summary import sensitivity

    found = sensitivity(Finished("made", study, tmp_path, None), tables.column_names(tmp_path))
    first = [row["first"] for row in found["indices"]]
    assert np.abs(np.array(first) - np.array([16, 4, 1, 0]) / 21).max() < 0.03
    assert all(
        row["total"] == pytest.approx(one, abs=0.05) for row, one in zip(found["indices"], first)
    )


def test_poses_are_drawn_whole_and_with_replacement():
    recording = resampling.original("elastic-arm")
    made = resampling.by_poses(recording, None, np.random.default_rng(1))
    drawn = len(np.unique(made.poses)) / len(np.unique(recording.poses))
    assert abs(drawn - (1 - np.exp(-1))) < 0.08  # the share that a bootstrap sees
    assert len(np.unique(made.sample_ids)) == made.n
    per_pose = np.bincount(recording.poses)
    assert made.n == pytest.approx(per_pose.mean() * len(per_pose), rel=0.2)


@pytest.mark.long
def test_stated_sigmas_hold_for_new_noise(tmp_path):
    study = read("uncertainty-noise")[0]
    found = summary(finished(study, tmp_path / "made", 150))
    shares = np.array([row["within_2"] for row in found["coverage"]])
    # 1,200 or more draws, those of one run not independent: 95 % within three sigmas of a single parameter's 150
    assert len(shares) >= 5 and abs(shares.mean() - 0.95) < 3 * np.sqrt(0.95 * 0.05 / 150)
    assert all(0.8 < row["ratio"] < 1.2 for row in found["coverage"])


@pytest.mark.slow
def test_more_poses_and_better_chosen_ones_leave_less_error():
    study = read("design-poses")[0]

    def median(**wanted):
        study_of = with_values(study, wanted)
        rows = [
            robots.errors_row(robots.calibrations(study_of, world.measured), world.tests)
            for world in (robots.world(study_of, seed) for seed in range(8))
        ]
        return np.median([row["joint-compliance_test_mm"] for row in rows])

    few, many, chosen = (
        median(poses=20, choice="random"),
        median(poses=110, choice="random"),
        median(poses=20, choice="D"),
    )
    assert many < 0.7 * few and chosen < few


@pytest.mark.slow
def test_a_known_scanner_errs_more_in_noise_and_its_page_is_made(tmp_path):
    from workbench.report.study.page import page

    study = read("sensor-field")[0]
    own = with_values(
        study, {"range_mm": 128.0, "blur_px": 0.8, "speckle": 0.0, "read_noise_e": 5.0}
    )
    loud = with_values(
        study, {"range_mm": 128.0, "blur_px": 0.8, "speckle": 0.4, "read_noise_e": 150.0}
    )
    from workbench.studies.sensors import figures

    quiet, noisy = (figures(one, 5) for one in (own, loud))
    assert quiet["balls_found"] == noisy["balls_found"] == 1
    assert quiet["form_rms_mm"] < noisy["form_rms_mm"] and quiet["centre_rms_mm"] < 0.01
    assert quiet["sigma_mm"] < noisy["sigma_mm"] and abs(quiet["range_mean_mm"] - 128) < 1
    made = finished(study, tmp_path / "made", 4)
    whole = page(made, summary(made))
    assert {"outcome", "sensor", "figures", "made"} <= {section.name for section in whole.sections}


def test_pages_of_every_kind_have_their_sections(tmp_path):
    from workbench.report.page import write_sheet
    from workbench.report.study.page import page

    made = finished(read("compliance-joints")[0], tmp_path / "joints", 90)
    found = summary(made)
    whole = page(made, found)
    assert [section.name for section in whole.sections] == [
        "outcome",
        "compliance",
        "sensitivity",
        "figures",
        "made",
    ]
    text = write_sheet(whole, made.path).read_text(encoding="utf-8")
    assert "joint to stiffen" in text and "joint_2" in text and "table.parquet" in text


def test_studies_that_come_along_can_start():
    for name in study_names():
        study, _ = read(name)
        assert seed_of(study, 1) != seed_of(study, 2) or study.vary.same_noise
    assert processes.cores() >= 1 and len(study_names()) == len(
        {read_study(name).title for name in study_names()}
    )
