"""Calibration of vision sensors and of the robots that carry them, from recordings.

    import workbench as wb

    recording = wb.load_example("elastic-arm")
    calibration = wb.calibrate(recording)
    calibration.held_out.rms_mm

Every command but `open` is a function of the same name (`_` for `-`; `hand_eye`, `import_data`). Names are
imported when they are first used: `import workbench` loads none of the large libraries.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from numpy import ndarray
from pandas import DataFrame

from workbench.api.functions import load as load
from workbench.api.recordings import Recording as Recording
from workbench.api.recordings import load_example as load_example
from workbench.api.recordings import read as read
from workbench.api.results import Result as Result
from workbench.core.effect import Effect as Effect
from workbench.core.errors import InputError as InputError
from workbench.core.least_squares.solver import Fit as Fit
from workbench.core.model import Model as Model
from workbench.core.parameters import Parameters as Parameters
from workbench.core.solution import Solution as Solution
from workbench.core.solution import Stage as Stage

__version__: str
__all__: list[str]

def calibrate(
    recording: Recording | Path | str | None = None,
    plan: Path | str | None = None,
    from_diagnosis: Result | Path | str | None = None,
    without: Sequence[str] | None = None,
    fit_samples: Sequence[int] | Path | str | None = None,
    test_samples: Sequence[int] | Path | str | None = None,
    folds: int = 10,
    scanner: Path | str | None = None,
    out: Path | str | None = None,
    trust_data: bool = False,
    no_report: bool = False,
    tolerance: Sequence[str] | str | None = None,
    session: Path | str | None = None,
) -> Result:
    r"""Calibrate the arm of a recording: parameters, held-out errors in mm, and a report page.

    For a recording with images of scans, the scanner is calibrated first (without `scanner`), then
    point clouds and ball centres are computed. Rows that `workbench check` names as wrong are left
    out and listed. Exit status 1 if the recording is in doubt, poses that were left out are
    predicted far worse than the noise explains, or a tolerance is not met.

    Args:
        recording: Folder of a recording, or a name of `workbench datasets list`.
        plan: Calibration plan (TOML) instead of the default stages.
        from_diagnosis: Use the corrected model of this run of `workbench diagnose` as the plan.
        without: Omit a term of the model by name, such as joint-3.backlash; * is a wildcard.
        fit_samples: Samples to fit: their numbers, or a file with one number per line.
        test_samples: Samples to hold out: their numbers, or a file with one number per line.
        folds: Number of folds of the cross-validation.
        scanner: Use this calibrated scanner (scanner.toml of `workbench scanner`).
        out: Folder to write; default: a temporary one, which is removed with the result.
        trust_data: Continue with a warning if the recorded data are implausible.
        no_report: Do not write a report page.
        tolerance: Largest accepted error, such as 0.1mm, 0.05deg or 0.3px; `passed` is False if it
            is exceeded. One per unit.
        session: Repeat an edit session of `workbench open` (session.toml); replaces `recording`,
            `plan` and `folds`.

    Returns:
        The answer of the command, with the entries below.

    Raises:
        InputError: the input or the call is wrong; the message states what to correct.

    Entries of the result:

    - `held_out`: 3-D position errors `rms_mm`, `mean_mm`, `p95_mm`, `max_mm` on samples that no fit
      has seen, in the frame of the measurement; `rotation_rms_deg`, ... where poses are measured.
    - `fit`: the same of the samples of the fit.
    - `nominal`: the same of the uncalibrated arm, base and tool fitted.
    - `parameters`: one row for each parameter: `where`, `name`, `value`, `std` (1 sigma) and
      `nominal` in `unit`, `identifiable`, `status`.
    - `stages`: one row for each stage of the plan: `free`, `identifiable`, `rms_mm`,
      `held_out_rms_mm`, `earned`.
    - `noise`: stated and estimated noise of one coordinate, mm.
    - `verdict`: `residual` compared with `noise` and `tolerance` in `unit`; `pass`; `sentence`.

    Method: stages are retained by K-fold cross-validation; parameters that the data do not identify
    are found by a singular value decomposition of the whitened Jacobian.

    Examples:
        >>> calibration = wb.calibrate("elastic-arm", plan="ye-mdh", folds=4)
        >>> calibration.held_out.rms_mm < calibration.nominal.rms_mm
        True
        >>> len(calibration.residuals.to_frame()) == calibration.samples
        True
    """

def calibrate_large(
    recording: Recording | Path | str,
    plan: Path | str | None = None,
    folds: int = 10,
    out: Path | str | None = None,
    tolerance: Sequence[str] | str | None = None,
    trust_data: bool = False,
) -> Result:
    r"""Calibrate an arm from millions of samples (Parquet), with little memory: parameters and held-out
    errors.

    The stages are selected on a subset of the samples; then all samples are fitted.

    Args:
        recording: Folder of a recording whose samples are a samples.parquet.
        plan: Plan: a name or a TOML file.
        folds: Number of folds of the cross-validation.
        out: Folder to write; default: a temporary one, which is removed with the result.
        tolerance: Largest accepted error, such as 0.1mm, 0.05deg or 0.3px; `passed` is False if it
            is exceeded. One per unit.
        trust_data: Continue with a warning if the recorded data are implausible.

    Returns:
        The answer of the command, with the entries below.

    Raises:
        InputError: the input or the call is wrong; the message states what to correct.

    Entries of the result:

    - `held_out`: 3-D position errors `rms_mm`, `mean_mm`, `p95_mm`, `max_mm` on samples that no fit
      has seen, in the frame of the measurement; `rotation_rms_deg`, ... where poses are measured.
    - `fit`: the same of the samples of the fit.
    - `nominal`: the same of the uncalibrated arm, base and tool fitted.
    - `parameters`: one row for each parameter: `where`, `name`, `value`, `std` (1 sigma) and
      `nominal` in `unit`, `identifiable`, `status`.
    - `stages`: one row for each stage of the plan: `free`, `identifiable`, `rms_mm`,
      `held_out_rms_mm`, `earned`.
    - `noise`: stated and estimated noise of one coordinate, mm.
    - `samples_for_stages`: number of samples that selected the stages.
    - `verdict`: `residual` compared with `noise` and `tolerance` in `unit`; `pass`; `sentence`.

    Method: normal equations added up in chunks; stages as by `calibrate`.

    Examples:
        >>> import pathlib
        >>> template = wb.new("external-point", "big", robot="ur10")
        >>> rows = wb.read("big").columns
        >>> import pandas
        >>> pandas.DataFrame(rows).to_parquet("big/samples.parquet")
        >>> described = pathlib.Path("big/recording.toml")
        >>> text = described.read_text().replace("samples.csv", "samples.parquet")
        >>> length = described.write_text(text)
        >>> calibration = wb.calibrate_large("big", folds=4)
        >>> calibration.held_out.rms_mm < calibration.nominal.rms_mm
        True
    """

def camera(
    recording: Recording | Path | str | None = None,
    model: Literal["auto", "brown", "rational", "fisheye"] = "auto",
    out: Path | str | None = None,
    tolerance: Sequence[str] | str | None = None,
    no_report: bool = False,
    session: Path | str | None = None,
) -> Result:
    r"""Calibrate a camera from images of a board: intrinsics, distortion, their uncertainty, and
    reprojection errors.

    Args:
        recording: Folder of a recording with images of a board, or a known name.
        model: Distortion model: brown (k1 k2 p1 p2 k3), rational (also k4 k5 k6), fisheye (k1 to k4
            of the angle), or auto: the one with the smallest error on held-out board poses.
        out: Folder to write; default: a temporary one, which is removed with the result.
        tolerance: Largest accepted error, such as 0.1mm, 0.05deg or 0.3px; `passed` is False if it
            is exceeded. One per unit.
        no_report: Do not write a report page.
        session: Repeat an edit session of `workbench open` (session.toml); replaces `recording`.

    Returns:
        The answer of the command, with the entries below.

    Raises:
        InputError: the input or the call is wrong; the message states what to correct.

    Entries of the result:

    - `fx_px`: focal length; `fy_px`, `cx_px`, `cy_px` likewise. Pixel (0, 0) is the centre of the
      top-left pixel.
    - `distortion`: 5 or 8 coefficients in the order of OpenCV.
    - `std`: 1 sigma of each of them.
    - `held_out`: RMS reprojection error `rms_px` (2-D) on images left out of the fit.
    - `images`: one row for each image: `corners`, `rms_px`.

    Method: start by Zhang (IEEE PAMI 22, 2000), bundle adjustment with a bowed board.

    Examples:
        >>> template = wb.new("board-images", "my-camera")
        >>> camera = wb.camera("my-camera")
        >>> camera.held_out.rms_px < 0.2
        True
        >>> len(camera.images.to_frame())
        14
    """

def check(
    recording: Recording | Path | str,
    out: Path | str | None = None,
    trust_data: bool = False,
    no_report: bool = False,
) -> Result:
    r"""Check a recording before calibration: joint ranges, poses, repeats, noise, mistakes and missing
    data.

    Exit status 1 if data are missing that the intended command requires, or if the data contain a
    mistake.

    Args:
        recording: Folder of a recording, or a name of `workbench datasets list`.
        out: Folder to write; default: a temporary one, which is removed with the result.
        trust_data: Continue with a warning if the recorded data are implausible.
        no_report: Do not write a report page.

    Returns:
        The answer of the command, with the entries below.

    Raises:
        InputError: the input or the call is wrong; the message states what to correct.

    Entries of the result:

    - `coverage`: range of each joint (deg), extent of the flange (mm), spread of its orientation
      (deg).
    - `repeats`: groups of repeated poses; `noise_from_repeats_mm` is the noise that they show.
    - `missing`: one row for each remark: `command`, `required`, `what`, `action`.
    - `verdict`: `pass` and a sentence.

    Examples:
        >>> wb.check("elastic-arm").measures
        'ball-centre'
    """

def compare(
    recording: Recording | Path | str,
    plan: Sequence[str],
    fit_samples: Sequence[int] | Path | str | None = None,
    test_samples: Sequence[int] | Path | str | None = None,
    folds: int = 10,
    out: Path | str | None = None,
    tolerance: Sequence[str] | str | None = None,
    trust_data: bool = False,
    no_report: bool = False,
) -> Result:
    r"""Compare calibration plans on one recording: held-out errors on the same folds, with significance
    tests.

    Args:
        recording: Folder of a recording, or a name of `workbench datasets list`.
        plan: Plan: a name such as default, a TOML file, or a run folder of `workbench diagnose`.
        fit_samples: Samples to fit: their numbers, or a file with one number per line.
        test_samples: Samples to hold out: their numbers, or a file with one number per line.
        folds: Number of folds of the cross-validation.
        out: Folder to write; default: a temporary one, which is removed with the result.
        tolerance: Largest accepted error, such as 0.1mm, 0.05deg or 0.3px; `passed` is False if it
            is exceeded. One per unit.
        trust_data: Continue with a warning if the recorded data are implausible.
        no_report: Do not write a report page.

    Returns:
        The answer of the command, with the entries below.

    Raises:
        InputError: the input or the call is wrong; the message states what to correct.

    Entries of the result:

    - `plans`: one row for each plan: `free`, `identifiable`, `fit_rms_mm`, `held_out_rms_mm`,
      `ratio` to the first plan, `p` of a difference by chance.
    - `nominal`: 3-D position errors `rms_mm`, `mean_mm`, `p95_mm`, `max_mm` of the uncalibrated
      arm.
    - `verdict`: `residual` compared with `noise` and `tolerance` in `unit`; `pass`; `sentence`.

    Method: corrected resampled t-test (Nadeau & Bengio, Machine Learning 52, 2003).

    Examples:
        >>> plans = wb.compare("elastic-arm", plan=["ye-mdh", "ye-2024"], folds=5).plans.to_frame()
        >>> list(plans["plan"])
        ['ye-mdh', 'ye-2024']
    """

def compensate(
    solution: Result | Path | str,
    targets: DataFrame | ndarray | Path | str,
    force: bool = False,
    without: Sequence[str] | None = None,
    max_correction_mm: float | None = None,
    max_correction_deg: float | None = None,
    max_sigma_mm: float | None = None,
    max_joint_change_deg: float = 10.0,
    map: Path | str | None = None,
    start: str | None = None,
    payload_kg: float | None = None,
    tolerance: Sequence[str] | str | None = None,
    out: Path | str | None = None,
    no_report: bool = False,
) -> Result:
    r"""Correct the targets of a robot program with a calibrated model: a table of corrected joint
    readings.

    A target beyond reach or limits, or with an implausible correction, has no joint readings in
    corrected.csv. The exit status is then 1: the program is incomplete and must not be run.

    Args:
        solution: Run folder of `workbench calibrate` or `workbench diagnose`, or its solution.json.
        targets: Joint readings or flange poses, one row per target: any table that `workbench
            import` reads.
        force: Accept a calibration and corrections that would be refused as implausible.
        without: Omit a term of the model by name, such as joint-3.backlash; * is a wildcard.
        max_correction_mm: Refuse larger corrections of the flange's position. Default: 10 mm, more
            if measured.
        max_correction_deg: Refuse larger corrections of the flange's orientation. Default: 1 deg,
            more if measured.
        max_sigma_mm: Refuse targets with a larger standard uncertainty; default: three times the
            held-out error.
        max_joint_change_deg: Refuse a joint target if a joint would change by more than this.
        map: Columns, units and conventions of a table of targets with other headers: a mapping as
            of `workbench import`.
        start: Start of the inverse kinematics for targets that are flange poses; it selects the
            configuration of the arm: joint readings (0,-90,90,0,90,0), or a recording (its nearest
            pose). Default: the middle of the joint ranges.
        payload_kg: Load of all targets, beyond the empty tool; for targets without a column
            payload_kg, as a robot program.
        tolerance: Largest accepted error, such as 0.1mm, 0.05deg or 0.3px; `passed` is False if it
            is exceeded. One per unit.
        out: Folder to write; default: a temporary one, which is removed with the result.
        no_report: Do not write a report page.

    Returns:
        The answer of the command, with the entries below.

    Raises:
        InputError: the input or the call is wrong; the message states what to correct.

    Entries of the result:

    - `count`: number of targets n.
    - `corrected_count`: how many have corrected joint readings; `table('corrected')` has them (n
      rows, deg; mm for a prismatic joint).
    - `largest_correction_mm`: of the flange, in the base frame; `largest_correction_deg` of its
      orientation.
    - `expected_error_mm`: held-out RMS position error of the calibration, with the noise of the
      instrument.
    - `refused`: rows without a correction, with the reason.

    Method: inverse kinematics of the calibrated model by damped least squares.

    Examples:
        >>> calibration = wb.calibrate("elastic-arm", plan="ye-mdh", folds=4)
        >>> recording = wb.load_example("elastic-arm")
        >>> targets = np.rad2deg(recording.joints[:3])
        >>> corrected = wb.compensate(calibration, targets).table("corrected")
        >>> len(corrected)
        3
    """

def datasets() -> Result:
    r"""List the recordings that are known by name: bundled ones, and real ones with their source.

    Returns:
        The answer of the command, with the entries below.

    Raises:
        InputError: the input or the call is wrong; the message states what to correct.

    Entries of the result:

    - `datasets`: one row for each recording: `name`, `measures`, `variants`, `licence`, `folder`
      (None: not here).

    Examples:
        >>> recordings = wb.datasets().answer["datasets"]
        >>> "elastic-arm" in [row["name"] for row in recordings]
        True
    """

def demo(out: Path | str | None = None, bundled: bool = False, images: bool = True) -> Result:
    r"""Run a complete example: calibrate scanner and arm from rendered images, then an arm from a table
    of points.

    No public data set covers the whole chain from images to the arm, so the images are rendered.
    The table is that of a real robot if it is available, else the bundled one.

    Args:
        out: Folder to write; default: a temporary one, which is removed with the result.
        bundled: Use the bundled table of an arm instead of a real recording.
        images: Render images and calibrate the scanner from them.

    Returns:
        The answer of the command, with the entries below.

    Raises:
        InputError: the input or the call is wrong; the message states what to correct.

    Entries of the result:

    - `held_out`: 3-D position errors `rms_mm`, `mean_mm`, `p95_mm`, `max_mm` of the arm, on samples
      that no fit has seen.
    - `from_pictures`: the same from rendered images, None without images.

    Examples:
        >>> shown = wb.demo(bundled=True, images=False)
        >>> shown.held_out.rms_mm < shown.nominal.rms_mm
        True
    """

def diagnose(
    recording: Recording | Path | str | None = None,
    simulation: Path | str | None = None,
    solution: Result | Path | str | None = None,
    baseline: Literal["geometry", "joint-compliance"] = "geometry",
    scanner: Path | str | None = None,
    jobs: int | None = None,
    out: Path | str | None = None,
    trust_data: bool = False,
    no_report: bool = False,
    tolerance: Sequence[str] | str | None = None,
    session: Path | str | None = None,
) -> Result:
    r"""Find unmodelled effects in a recording: physical cause, place, size and probability, and a
    corrected model.

    Args:
        recording: Folder of a recording, or a name of `workbench datasets list`.
        simulation: Compare with this simulation: a scene (TOML), an MJCF (.xml) or URDF file
            (FILE#LINK).
        solution: Compare with this earlier calibration (solution.json).
        baseline: Model before the search: geometry, or geometry and joint compliance.
        scanner: Measure ball centres in the scans with this calibrated scanner (scanner.toml) and
            diagnose these, instead of the images.
        jobs: Number of processes; default: 1.
        out: Folder to write; default: a temporary one, which is removed with the result.
        trust_data: Continue with a warning if the recorded data are implausible.
        no_report: Do not write a report page.
        tolerance: Largest accepted error, such as 0.1mm, 0.05deg or 0.3px; `passed` is False if it
            is exceeded. One per unit.
        session: Leave out the data that an edit session of `workbench open` excludes
            (session.toml); replaces `recording`.

    Returns:
        The answer of the command, with the entries below.

    Raises:
        InputError: the input or the call is wrong; the message states what to correct.

    Entries of the result:

    - `effects`: one row for each retained effect: `effect`, `where`, `size_mm` (RMS displacement),
      `p_value`, `probability`, `t`, `statement`.
    - `refused`: the same of effects that cross-validation did not retain.
    - `held_out`: held-out RMS error `before_mm` and `after_mm` the effects are added, and
      `noise_mm`.
    - `verdict`: `explained`, `consistent` (nothing to explain), ...; `verdict_details` compares
      error and noise.
    - `smallest_visible`: minimal detectable bias of each candidate, `size_mm`.
    - `model`: files of the corrected model.

    Method: posterior probability of sets of effects, nested cross-validation.

    Examples:
        >>> template = wb.new("external-point", "my-robot", robot="ur10")
        >>> diagnosis = wb.diagnose("my-robot")
        >>> diagnosis.answer["verdict"], len(diagnosis.answer["effects"])
        ('consistent', 0)
    """

def doctor() -> Result:
    r"""Check the installation: Python, libraries, system packages, device, recordings, permissions.

    Returns:
        The answer of the command, with the entries below.

    Raises:
        InputError: the input or the call is wrong; the message states what to correct.

    Entries of the result:

    - `healthy`: whether all requirements are met.
    - `checks`: one row for each check: `name`, `ok`, `found`, `advice`.

    Examples:
        >>> checks = wb.doctor().checks.to_frame()
        >>> bool(checks.loc[checks["name"] == "Python", "ok"].all())
        True
    """

def evaluate(
    solution: Result | Path | str,
    recording: Recording | Path | str,
    refit: Literal["none", "base", "tool", "base-and-tool"] = "none",
    later: bool = False,
    out: Path | str | None = None,
    tolerance: Sequence[str] | str | None = None,
    trust_data: bool = False,
    no_report: bool = False,
) -> Result:
    r"""Test a calibrated model on another recording: position and orientation errors, without fitting
    the arm again.

    The errors of the nominal arm are stated for comparison, with base and tool estimated on the
    recording.

    Args:
        solution: Run folder of `workbench calibrate` or `workbench diagnose`, or its solution.json.
        recording: Folder of a recording, or a name of `workbench datasets list`.
        refit: Estimate the pose of the instrument (base), the target on the flange (tool), or both
            on this recording.
        later: Treat all samples as measured after those of the calibration, whatever their times: a
            drift keeps its last value, a shift remains.
        out: Folder to write; default: a temporary one, which is removed with the result.
        tolerance: Largest accepted error, such as 0.1mm, 0.05deg or 0.3px; `passed` is False if it
            is exceeded. One per unit.
        trust_data: Continue with a warning if the recorded data are implausible.
        no_report: Do not write a report page.

    Returns:
        The answer of the command, with the entries below.

    Raises:
        InputError: the input or the call is wrong; the message states what to correct.

    Entries of the result:

    - `error`: 3-D position errors `rms_mm`, `mean_mm`, `p95_mm`, `max_mm` of the calibrated arm on
      the recording, none of which was fitted.
    - `refitted`: the same with base and tool estimated on the recording.
    - `nominal`: the same of the nominal arm, base and tool estimated on the recording.
    - `held_out`: the same as the calibration stated it for its own samples.
    - `by_joint`: one row for each joint that moves: `edges` of thirds of its readings (deg; mm for
      a prismatic joint), `rms_mm` in each, None in an empty one.
    - `verdict`: `residual` compared with `noise` and `tolerance` in `unit`; `pass`; `sentence`.

    Method: prediction by the calibrated model with its parameters fixed.

    Examples:
        >>> calibration = wb.calibrate("elastic-arm", plan="ye-mdh", folds=4)
        >>> evaluated = wb.evaluate(calibration, "elastic-arm", refit="base-and-tool")
        >>> evaluated.error.rms_mm < evaluated.nominal.rms_mm
        True
    """

def export(
    source: DataFrame | ndarray | Path | str,
    to: str,
    file: Path | str,
    force: bool = False,
    parent_frame: str | None = None,
    child_frame: str | None = None,
    without: Sequence[str] | None = None,
    urdf: Path | str | None = None,
    tip: str | None = None,
    targets: DataFrame | ndarray | Path | str | None = None,
    map: Path | str | None = None,
    start: str | None = None,
    payload_kg: float | None = None,
) -> Result:
    r"""Write a calibrated model or a corrected program in another format; the file is read back as a
    check.

    A calibrated arm goes to urdf (your own file with corrected origins, where there is one), mjcf,
    python (one module that needs numpy alone), ros (kinematics of a Universal Robots arm),
    urscript, krl, rapid and fanuc (a program in which the `targets` are corrected), mdh-json and
    mdh-csv. A camera or the camera of a scanner goes to ros, opencv and kalibr; a hand-eye
    transform to ros: a static transform and a launch file that publishes it.

    Args:
        source: Run folder, solution.json, camera.toml, scanner.toml or hand-eye.toml.
        to: urdf, mjcf, python, ros, urscript, krl, rapid, fanuc, mdh-json, mdh-csv, opencv, kalibr
        file: File to write.
        force: Accept a calibration and corrections that would be refused as implausible.
        parent_frame: Name of the ROS frame of flange or base, for a hand-eye transform.
        child_frame: Name of the ROS frame of the sensor, for a hand-eye transform.
        without: Omit a term of the model by name, such as joint-3.backlash; * is a wildcard.
        urdf: The URDF whose joint origins are corrected; FILE#LINK names its flange, too.
        tip: Link of the URDF that is the flange.
        targets: Targets of a robot program, as for `compensate`.
        map: Columns, units and conventions of a table of targets with other headers: a mapping as
            of `workbench import`.
        start: Start of the inverse kinematics for targets that are flange poses; it selects the
            configuration of the arm: joint readings (0,-90,90,0,90,0), or a recording (its nearest
            pose). Default: the middle of the joint ranges.
        payload_kg: Load of all targets, beyond the empty tool; for targets without a column
            payload_kg, as a robot program.

    Returns:
        The answer of the command, with the entries below.

    Raises:
        InputError: the input or the call is wrong; the message states what to correct.

    Entries of the result:

    - `file`: the file that was written, in mm and rad, or in the units of the format.
    - `left_out`: terms that the format cannot hold.

    Examples:
        >>> calibration = wb.calibrate("elastic-arm", plan="ye-mdh", folds=4)
        >>> made = wb.export(calibration, "mdh-csv", "geometry.csv")
        >>> len(open("geometry.csv").readlines())
        7
    """

def hand_eye(
    recording: Recording | Path | str | None = None,
    camera: Path | str | None = None,
    scanner: Path | str | None = None,
    kind: Literal["in-hand", "to-hand"] | None = None,
    out: Path | str | None = None,
    tolerance: Sequence[str] | str | None = None,
    trust_data: bool = False,
    no_report: bool = False,
    session: Path | str | None = None,
) -> Result:
    r"""Estimate the hand-eye transform from images, profiles, target poses or tracker points and flange
    poses.

    Args:
        recording: Folder of a recording with flange poses or joint readings, or a known name.
        camera: Use this calibrated camera (camera.toml of `workbench camera`).
        scanner: Use this calibrated scanner (scanner.toml of `workbench scanner`).
        kind: Sensor on the flange or stationary; default: key fixed_to of [board].
        out: Folder to write; default: a temporary one, which is removed with the result.
        tolerance: Largest accepted error, such as 0.1mm, 0.05deg or 0.3px; `passed` is False if it
            is exceeded. One per unit.
        trust_data: Continue with a warning if the recorded data are implausible.
        no_report: Do not write a report page.
        session: Repeat an edit session of `workbench open` (session.toml); replaces `recording`,
            `camera`, `scanner` and `kind`.

    Returns:
        The answer of the command, with the entries below.

    Raises:
        InputError: the input or the call is wrong; the message states what to correct.

    Entries of the result:

    - `hand_eye`: the transform: `matrix` (4 x 4, mm), `xyz_mm`, `rotvec_deg`, `std_mm`,
      `rotvec_std_deg`; `std_deg` of a small rotation about the axes of the frame.
    - `transform`: its name: T_flange_sensor for a camera on the arm, T_base_sensor for a stationary
      one.
    - `target`: pose of the board, in the same form.
    - `held_out`: scatter of the board pose on images left out of the fit: `centre_mm`, `turn_deg`,
      `rms_px`.
    - `errors`: one row for each image.

    Method: start by Park & Martin (IEEE Trans. Robotics 10, 1994), then one adjustment of all
    images.

    Examples:
        >>> template = wb.new("board-images", "my-hand-eye")
        >>> found = wb.hand_eye("my-hand-eye")
        >>> found.transform, np.shape(found.hand_eye.matrix)
        ('T_flange_sensor', (4, 4))
    """

def identifiability(
    recording: Recording | Path | str,
    plan: Path | str | None = None,
    out: Path | str | None = None,
    trust_data: bool = False,
    no_report: bool = False,
) -> Result:
    r"""List the parameters that a recording identifies and those that are confounded; nothing is
    fitted.

    Args:
        recording: Folder of a recording, or a name of `workbench datasets list`.
        plan: Plan (name or TOML file) instead of the default plan.
        out: Folder to write; default: a temporary one, which is removed with the result.
        trust_data: Continue with a warning if the recorded data are implausible.
        no_report: Do not write a report page.

    Returns:
        The answer of the command, with the entries below.

    Raises:
        InputError: the input or the call is wrong; the message states what to correct.

    Entries of the result:

    - `stages`: one row for each stage: number of `free` parameters and of `identifiable`
      combinations, `undetermined` in words (`undetermined_in_any_poses`: the gauge freedoms of
      them), observability indices `O1` ... `O5`.

    Method: observability indices as of Sun & Hollerbach (ICRA 2008).

    Examples:
        >>> stages = wb.identifiability("elastic-arm").stages.to_frame()
        >>> bool((stages["identifiable"] <= stages["free"]).all())
        True
    """

def import_data(
    sources: Sequence[DataFrame | ndarray | Path | str],
    out: Path | str | None = None,
    robot: Recording | Path | str | None = None,
    map: Path | str | None = None,
    propose: Path | str | None = None,
    board: str | None = None,
    camera: Path | str | None = None,
    artefact: Path | str | None = None,
    ball_radius: float | None = None,
    sigma: float | None = None,
    time_offset: str | None = None,
    title: str = "",
    trust_data: bool = False,
    yes: bool = False,
) -> Result:
    r"""Convert tables, logs, ROS bags, images or clouds to a recording; units and conventions are
    tested on the robot.

    If the data do not determine a unit or convention, the command asks at a terminal. Without a
    terminal it stops and names the missing line of the mapping file.

    Args:
        sources: Tables, robot programs, ROS bags, images, clouds, or folders of them.
        out: New folder for the recording.
        robot: Built-in robot, robot.toml, URDF or MJCF; FILE#LINK where a file holds several arms.
        map: Mapping file (TOML): columns, units and conventions of the tables.
        propose: Write the proposed mapping file and stop.
        board: Board in the images: "chessboard 11x8 5mm", "circles 7x6 10mm", "circles 4x11 10mm
            asymmetric", "charuco 7x5 30mm 22mm DICT_5X5_250" or "aprilgrid 6x6 71.5mm 55mm"; "on
            tool" at the end where the robot holds it.
        camera: Test the poses of images with this calibrated camera (camera.toml); default: it is
            calibrated from the same images.
        artefact: File with the certified ball centres and radii (artefact.csv).
        ball_radius: Radius of the ball in point clouds.
        sigma: Standard deviation of a measured coordinate (sigma_mm), with which the fit is
            compared; leave it out if it is unknown.
        time_offset: Offset between the clocks of two tables that are joined by time: estimated from
            the motion (auto), none, or SECONDS to add to the times of the shorter table. Default:
            what `map` states, else auto.
        title: Title of the recording.
        trust_data: Continue with a warning if the recorded data are implausible.
        yes: Accept the preview without a question.

    Returns:
        The answer of the command, with the entries below.

    Raises:
        InputError: the input or the call is wrong; the message states what to correct.

    Entries of the result:

    - `folder`: the new recording.
    - `mapping`: which column is what, in which unit; as in import.toml.
    - `conventions`: one row for each candidate of units and rotations: fit on the robot, `rms_mm`,
      `rms_deg`.
    - `questions`: what the data leave open.

    Examples:
        >>> template = wb.new("external-point", "my-robot", robot="ur10")
        >>> made = wb.import_data(["my-robot/samples.csv"], out="imported", robot="ur10")
        >>> made.measures
        'external-point'
        >>> import pandas
        >>> table = pandas.read_csv("my-robot/samples.csv")
        >>> wb.import_data([table], out="from-frame", robot="ur10").samples
        36
    """

def new(kind: str, folder: Path | str, robot: Recording | Path | str | None = None) -> Result:
    r"""Write a template of a recording: files with a comment on every key, and simulated rows to
    replace with yours.

    Args:
        kind: What is measured: external-point, external-pose, ball-centre, board-images, ...; or a
            scanner: fixed-plane, galvanometer, turntable, profiler, 3d-camera.
        folder: New folder.
        robot: Built-in robot, robot.toml, URDF or MJCF; FILE#LINK where a file holds several arms.

    Returns:
        The answer of the command, with the entries below.

    Raises:
        InputError: the input or the call is wrong; the message states what to correct.

    Entries of the result:

    - `folder`: the new recording.
    - `measures`: kind of its samples.
    - `samples`: number of its rows.

    Examples:
        >>> made = wb.new("external-point", "template", robot="ur10")
        >>> wb.read("template").measures
        'external-point'
    """

def poses(
    candidates: Recording | Result | Path | str,
    count: int = 40,
    criterion: str = "D",
    tasks: Recording | Path | str | None = None,
    effects: bool = False,
    without: Sequence[str] | None = None,
    link_radius: float = 50.0,
    stand_off: tuple[float, float] | None = None,
    field: float | None = None,
    cap: float | None = None,
    repeats: int = 1,
    seed: int = 0,
    out: Path | str | None = None,
    tolerance: Sequence[str] | str | None = None,
    trust_data: bool = False,
    no_report: bool = False,
) -> Result:
    r"""Select the most informative measurement poses of a recording or a scene: a table of poses and
    the gain.

    Args:
        candidates: A recording, a known name, a scene (TOML) or a run of `workbench diagnose` to
            draw poses from.
        count: Number of poses to choose.
        criterion: Criterion: D (D-optimal), O1 ... O5 (observability indices), or task (error at
            `tasks`).
        tasks: Recording with the task poses at which the error is minimised.
        effects: Also estimate transmission errors and compliance.
        without: Omit a term of the model by name, such as joint-3.backlash; * is a wildcard.
        link_radius: Radius of the links for the collision test, mm.
        stand_off: Distance of a ball from the sensor, mm.
        field: Half the sensor's field of view, deg.
        cap: Largest angle between line of sight and top of a ball, deg.
        repeats: Largest number of measurements at one pose.
        seed: Seed of the random sets for comparison.
        out: Folder to write; default: a temporary one, which is removed with the result.
        tolerance: Largest accepted error, such as 0.1mm, 0.05deg or 0.3px; `passed` is False if it
            is exceeded. One per unit.
        trust_data: Continue with a warning if the recorded data are implausible.
        no_report: Do not write a report page.

    Returns:
        The answer of the command, with the entries below.

    Raises:
        InputError: the input or the call is wrong; the message states what to correct.

    Entries of the result:

    - `samples`: numbers of the chosen samples; `table('poses')` has their joint readings (deg).
    - `value`: of the criterion; `random_median` is that of random sets, `gain_over_random` the
      ratio.
    - `undetermined`: what these poses do not identify, in words.

    Method: D-optimal design, or the observability indices of Sun & Hollerbach (ICRA 2008).

    Examples:
        >>> chosen = wb.poses("elastic-arm", count=20).table("poses")
        >>> len(chosen)
        20
    """

def prove(
    suite: Sequence[str] | None = None,
    cases: int | None = None,
    seed: int = 1,
    folder: Path | str | None = None,
    jobs: int | None = None,
    out: Path | str | None = None,
    minutes: float | None = None,
    page: Path | str | None = None,
    no_report: bool = False,
) -> Result:
    r"""Run the blind benchmark of the diagnosis: simulated recordings with planted effects, scored
    against their truth.

    The SHA-256 of each truth is published before the diagnosis runs. An interrupted benchmark
    continues with the same command.

    Args:
        suite: Run only this suite, with COUNT cases.
        cases: Number of cases of a suite without a count.
        seed: Seed of the random cases.
        folder: Folder with your own recordings and truths.
        jobs: Number of processes; default: 1.
        out: Folder of the benchmark run.
        minutes: Start no diagnosis after this time; repeat the command to continue.
        page: Also write the scoreboard as Markdown.
        no_report: Do not write a report page.

    Returns:
        The answer of the command, with the entries below.

    Raises:
        InputError: the input or the call is wrong; the message states what to correct.

    Entries of the result:

    - `cases`: number of blind cases.
    - `figures`: one row for each figure: `name`, `suite`, `value` with its interval, what is
      `asked`.

    Examples:
        >>> board = wb.prove(suite=["clean=1"], seed=53, out="benchmark")
        >>> board.cases
        1
    """

def register(
    source: DataFrame | ndarray | Path | str,
    target: DataFrame | ndarray | Path | str,
    nearest: bool = False,
    unit: str | None = None,
    out: Path | str | None = None,
    no_report: bool = False,
) -> Result:
    r"""Register measured points to those of a tracker: rigid transform, and distance of each point.

    The rigid transform is the least-squares one. Points correspond by the column `point`, by row
    where there is none, or by nearness with `nearest`. The error of every point is also stated with
    that point left out of the fit.

    Args:
        source: Points to transform (CSV): x_mm, y_mm, z_mm, and their names in `point`.
        target: Points of the tracker (CSV), in the same columns.
        nearest: Match every point with the nearest one (ICP) instead of by name or row.
        unit: Unit of coordinates that state none: mm, m, in or cm.
        out: Folder to write; default: a temporary one, which is removed with the result.
        no_report: Do not write a report page.

    Returns:
        The answer of the command, with the entries below.

    Raises:
        InputError: the input or the call is wrong; the message states what to correct.

    Entries of the result:

    - `rms_mm`: 3-D distance after the alignment; `mean_mm`, `std_mm` and `max_mm`.
    - `matrix`: 4 x 4 matrix that takes source points (mm) to the frame of the target.

    Method: Kabsch (Acta Cryst. A32, 1976); Umeyama (IEEE PAMI 13, 1991); ICP where points have no
    names.

    Examples:
        >>> points = np.random.default_rng(0).uniform(0, 500, (5, 3))
        >>> for name, table in (("cad", points), ("tracker", points + [100.0, 0, 0])):
        ...     np.savetxt(f"{name}.csv", table, delimiter=",", header="x_mm,y_mm,z_mm", comments="")
        >>> moved = wb.register("cad.csv", "tracker.csv")
        >>> moved.rms_mm < 1e-3
        True
        >>> wb.register(points, points + [0.0, 0.0, 5.0]).rms_mm < 1e-3
        True
    """

def render(
    scene: Result | Path | str, out: Path | str | None = None, truth: Path | str | None = None
) -> Result:
    r"""Render a scene file to images: a recording of a camera or scanner with known errors.

    Args:
        scene: Scene file (TOML).
        out: Folder to write; default: a temporary one, which is removed with the result.
        truth: Write the ground truth of the rendering (JSON).

    Returns:
        The answer of the command, with the entries below.

    Raises:
        InputError: the input or the call is wrong; the message states what to correct.

    Entries of the result:

    - `recording`: folder of the recording; `wb.read` reads it.
    - `images`: number of images.

    Examples:
        >>> scene = '''
        ... camera = { width_px = 320, height_px = 240, fx_px = 500, fy_px = 500, cx_px = 160, cy_px = 120 }
        ... balls = [[0.0, 0.0, 0.0, 10.0]]
        ... scans = { count = 1 }
        ... placements = { count = 2, laser = 1 }
        ... mirror = { steps = 2 }
        ... '''
        >>> with open("scene.toml", "w") as file:
        ...     length = file.write(scene)
        >>> rendered = wb.render("scene.toml", out="rendered")
        >>> wb.read("rendered").measures
        'scan-images'
    """

def scan(
    recording: Recording | Path | str,
    scanner: Path | str | None = None,
    hand_eye: Path | str | None = None,
    out: Path | str | None = None,
    tolerance: Sequence[str] | str | None = None,
    no_report: bool = False,
) -> Result:
    r"""Compute point clouds and ball centres from images of laser scans, or from profiles or clouds of
    balls.

    Without `scanner`, the scanner is calibrated first. Images, profiles and clouds of several
    flange poses are joined in the base frame of the robot; without `hand_eye`, the hand-eye
    transform is calibrated first.

    Args:
        recording: Folder of a recording with images of scans, or with points on balls, or a known
            name.
        scanner: Use this calibrated scanner (scanner.toml of `workbench scanner`).
        hand_eye: Join images of several flange poses with this transform (hand-eye.toml of
            `workbench handeye`).
        out: Folder to write; default: a temporary one, which is removed with the result.
        tolerance: Largest accepted error, such as 0.1mm, 0.05deg or 0.3px; `passed` is False if it
            is exceeded. One per unit.
        no_report: Do not write a report page.

    Returns:
        The answer of the command, with the entries below.

    Raises:
        InputError: the input or the call is wrong; the message states what to correct.

    Entries of the result:

    - `scans`: one row for each scan: number of `points`, file of the `cloud` (mm), `balls` with
      centre, radius and 1 sigma in mm, in `frame` (camera or base).
    - `ball_centres`: folder of a recording of the ball centres for `wb.calibrate`.
    - `acceptance`: probing and length errors as of ISO 10360 and VDI/VDE 2634.

    Examples:
        >>> template = wb.new("profiler", "my-profiler")
        >>> scans = wb.scan("my-profiler").scans
        >>> scans[0].balls[0].radius_mm > 0
        True
    """

def scanner(
    recording: Recording | Path | str,
    out: Path | str | None = None,
    model: Literal["auto", "brown", "rational", "fisheye"] = "auto",
    tolerance: Sequence[str] | str | None = None,
    no_report: bool = False,
) -> Result:
    r"""Calibrate a laser scanner from images of a board: camera, light planes and mirror axis in one
    adjustment.

    Args:
        recording: Folder of a recording with images of a board under the laser, or a known name.
        out: Also write the scanner to this file; other commands read it with `scanner` FILE.
        model: Distortion model: brown (k1 k2 p1 p2 k3), rational (also k4 k5 k6), fisheye (k1 to k4
            of the angle), or auto: the one with the smallest error on held-out board poses.
        tolerance: Largest accepted error, such as 0.1mm, 0.05deg or 0.3px; `passed` is False if it
            is exceeded. One per unit.
        no_report: Do not write a report page.

    Returns:
        The answer of the command, with the entries below.

    Raises:
        InputError: the input or the call is wrong; the message states what to correct.

    Entries of the result:

    - `camera`: as of `camera`.
    - `planes`: one row for each mirror step: `normal` and `offset_mm` of the light plane in the
      camera frame, `rms_mm`, `sigma_mm`.
    - `mirror`: axis, point (mm, camera frame) and angles (deg) of the mirror.
    - `left_out`: RMS distance `rms_mm` of stripe points of left-out board poses from their light
      plane.

    Examples:
        >>> template = wb.new("fixed-plane", "my-scanner")
        >>> scanner = wb.scanner("my-scanner")
        >>> len(scanner.planes), scanner.planes[0].rms_mm < 0.1
        (1, True)
    """

def significance(
    robot: Recording | Path | str,
    points: int = 50,
    seed: int = 0,
    step_mm: float = 0.1,
    step_rad: float = 0.1,
    out: Path | str | None = None,
    no_report: bool = False,
) -> Result:
    r"""Compute how an error of each parameter of a robot changes position and axes of the flange.

    Args:
        robot: Built-in robot, robot.toml, URDF, MJCF, or a recording.
        points: Number of configurations, random or from a recording.
        seed: Seed of the random configurations.
        step_mm: Error of a length, mm.
        step_rad: Error of an angle, rad.
        out: Folder to write; default: a temporary one, which is removed with the result.
        no_report: Do not write a report page.

    Returns:
        The answer of the command, with the entries below.

    Raises:
        InputError: the input or the call is wrong; the message states what to correct.

    Entries of the result:

    - `parameters`: one row for each parameter: `index_position` (mm) and `index_x`, `index_y`,
      `index_z` (change of the axes of the end effector) for an error of `step_mm` or `step_rad`.
    - `without_effect`: parameters without effect on position or an axis.

    Examples:
        >>> sensitivity = wb.significance("ur10", points=5).parameters.to_frame()
        >>> sensitivity.loc[0, "parameter"]
        'joint-1.theta1'
    """

def simulate(
    scene: Result | Path | str, without: Sequence[str] | None = None, out: Path | str | None = None
) -> Result:
    r"""Simulate the measurements of an arm that a scene file describes, and write them as a recording.

    Args:
        scene: Scene file (TOML), or run folder of `workbench diagnose`.
        without: Omit a term of the model by name, such as joint-3.backlash; * is a wildcard.
        out: Folder to write; default: a temporary one, which is removed with the result.

    Returns:
        The answer of the command, with the entries below.

    Raises:
        InputError: the input or the call is wrong; the message states what to correct.

    Entries of the result:

    - `recording`: folder of the recording; `wb.read` reads it.
    - `samples`: number of samples n.
    - `sigma_mm`: 1 sigma of the noise of a coordinate.

    Examples:
        >>> scene = 'robot = "ur10"\nmeasures = "external-point"\nsamples = 20\nsigma_mm = 0.02\n'
        >>> with open("scene.toml", "w") as file:
        ...     length = file.write(scene)
        >>> made = wb.simulate("scene.toml", out="simulated")
        >>> wb.read("simulated").points.shape
        (20, 3)
    """

def stiffness(
    solution: Result | Path | str,
    targets: DataFrame | ndarray | Path | str,
    wrench: tuple[float, float, float, float, float, float] | None = None,
    tool_point: tuple[float, float, float] = (0.0, 0.0, 0.0),
    without: Sequence[str] | None = None,
    force: bool = False,
    map: Path | str | None = None,
    out: Path | str | None = None,
) -> Result:
    r"""Compute the Cartesian compliance and stiffness of an arm at given poses, and its deflection
    under a wrench.

    Writes stiffness.csv, compliance.npy and stiffness.npy (n, 6, 6), a map of the workspace and a
    comparison of the rigid, joint, joint and bearing, and complete models as PDF and SVG,
    models.csv and map.vtk.

    Args:
        solution: Run folder of `workbench calibrate` or `workbench diagnose`, its solution.json, or
            a file of measured or published stiffness (TOML).
        targets: Joint readings, one row per pose: any table that `workbench import` reads.
        wrench: Force (N) and moment (N m) at the tool point, in the robot's root frame.
        tool_point: Point at which the wrench acts, mm in the flange frame.
        without: Omit a term of the model by name, such as joint-3.backlash; * is a wildcard.
        force: Accept a calibration and corrections that would be refused as implausible.
        map: Columns, units and conventions of a table of targets with other headers: a mapping as
            of `workbench import`.
        out: Folder to write; default: a temporary one, which is removed with the result.

    Returns:
        The answer of the command, with the entries below.

    Raises:
        InputError: the input or the call is wrong; the message states what to correct.

    Entries of the result:

    - `compliance_largest_mm_per_n`: over all directions and poses; `compliance_least_mm_per_n` the
      smallest.
    - `models`: compliance of the rigid, joint, joint and bearing, and complete models.
    - `first_pose`: `compliance` (6 x 6; mm, rad per N, N m; root frame) at the tool point of the
      first pose.

    Examples:
        >>> calibration = wb.calibrate("elastic-arm")
        >>> targets = np.array([[0.0, 20.0, 30.0, 0.0, 40.0, 0.0]])
        >>> found = wb.stiffness(calibration, targets)
        >>> found.compliance_largest_mm_per_n > found.compliance_least_mm_per_n > 0
        True
    """

def study(
    study: Path | str,
    workers: int | None = None,
    scheduler: str | None = None,
    run: int | None = None,
    out: Path | str | None = None,
    no_report: bool = False,
) -> Result:
    r"""Run a study file: repeated simulation, calibration, diagnosis and compensation, with one table
    row per run.

    An interrupted study continues with the same command.

    Args:
        study: A study file (TOML), or the name of a bundled study.
        workers: Number of processes; default: 1.
        scheduler: Address of a Dask scheduler, to run on a cluster.
        run: Compute only this run and print its row; writes nothing.
        out: Folder to write; default: a temporary one, which is removed with the result.
        no_report: Do not write a report page.

    Returns:
        The answer of the command, with the entries below.

    Raises:
        InputError: the input or the call is wrong; the message states what to correct.

    Entries of the result:

    - `columns`: one row for each column of the table: `n`, `mean`, `std` and quantiles, in the unit
      of its name.
    - `outcome`: name of the column that the study is about.
    - `sensitivity`: Sobol indices of the outcome, or why there are none.
    - `coverage`: share of runs whose intervals contain the true value.

    Examples:
        >>> study = '''
        ... kind = "uncertainty"
        ... recording = "elastic-arm"
        ... do = ["calibrate"]
        ... models = ["geometry"]
        ... folds = 2
        ... resample = { how = "noise" }
        ... vary = { runs = 2 }
        ... '''
        >>> with open("study.toml", "w") as file:
        ...     length = file.write(study)
        >>> repeated = wb.study("study.toml", out="repeated")
        >>> repeated.done, repeated.outcome
        (2, 'geometry_held_out_mm')
    """
