"""Main entries of the answer of each command, with units and frames, and the source of its method.

They stand in the docstrings of the functions; a test compares them with the answers of the examples.
"""

_ERRORS = "3-D position errors `rms_mm`, `mean_mm`, `p95_mm`, `max_mm`"
_CALIBRATION = {
    "held_out": f"{_ERRORS} on samples that no fit has seen, in the frame of the measurement; "
    "`rotation_rms_deg`, ... where poses are measured.",
    "fit": "the same of the samples of the fit.",
    "nominal": "the same of the uncalibrated arm, base and tool fitted.",
    "parameters": "one row for each parameter: `where`, `name`, `value`, `std` (1 sigma) and `nominal` in "
    "`unit`, `identifiable`, `status`.",
    "stages": "one row for each stage of the plan: `free`, `identifiable`, `rms_mm`, `held_out_rms_mm`, `earned`.",
    "noise": "stated and estimated noise of one coordinate, mm.",
}
_VERDICT = "`residual` compared with `noise` and `tolerance` in `unit`; `pass`; `sentence`."

ANSWERS: dict[str, dict[str, str]] = {
    "calibrate": {**_CALIBRATION, "verdict": _VERDICT},
    "calibrate_large": {
        **_CALIBRATION,
        "samples_for_stages": "number of samples that selected the stages.",
        "verdict": _VERDICT,
    },
    "compare": {
        "plans": "one row for each plan: `free`, `identifiable`, `fit_rms_mm`, `held_out_rms_mm`, `ratio` to the "
        "first plan, `p` of a difference by chance.",
        "nominal": f"{_ERRORS} of the uncalibrated arm.",
        "verdict": _VERDICT,
    },
    "compensate": {
        "count": "number of targets n.",
        "corrected_count": "how many have corrected joint readings; `table('corrected')` has them (n rows, deg; mm "
        "for a prismatic joint).",
        "largest_correction_mm": "of the flange, in the base frame; `largest_correction_deg` of its orientation.",
        "expected_error_mm": "held-out RMS position error of the calibration, with the noise of the instrument.",
        "refused": "rows without a correction, with the reason.",
    },
    "diagnose": {
        "effects": "one row for each retained effect: `effect`, `where`, `size_mm` (RMS displacement), `p_value`, "
        "`probability`, `t`, `statement`.",
        "refused": "the same of effects that cross-validation did not retain.",
        "held_out": "held-out RMS error `before_mm` and `after_mm` the effects are added, and `noise_mm`.",
        "verdict": "`explained`, `consistent` (nothing to explain), ...; `verdict_details` compares error and noise.",
        "smallest_visible": "minimal detectable bias of each candidate, `size_mm`.",
        "model": "files of the corrected model.",
    },
    "export": {
        "file": "the file that was written, in mm and rad, or in the units of the format.",
        "left_out": "terms that the format cannot hold.",
    },
    "identifiability": {
        "stages": "one row for each stage: number of `free` parameters and of `identifiable` combinations, "
        "`undetermined` in words (`undetermined_in_any_poses`: the gauge freedoms of them), observability indices "
        "`O1` ... `O5`.",
    },
    "poses": {
        "samples": "numbers of the chosen samples; `table('poses')` has their joint readings (deg).",
        "value": "of the criterion; `random_median` is that of random sets, `gain_over_random` the ratio.",
        "undetermined": "what these poses do not identify, in words.",
    },
    "register": {
        "rms_mm": "3-D distance after the alignment; `mean_mm`, `std_mm` and `max_mm`.",
        "matrix": "4 x 4 matrix that takes source points (mm) to the frame of the target.",
    },
    "significance": {
        "parameters": "one row for each parameter: `index_position` (mm) and `index_x`, `index_y`, `index_z` "
        "(change of the axes of the end effector) for an error of `step_mm` or `step_rad`.",
        "without_effect": "parameters without effect on position or an axis.",
    },
    "simulate": {
        "recording": "folder of the recording; `wb.read` reads it.",
        "samples": "number of samples n.",
        "sigma_mm": "1 sigma of the noise of a coordinate.",
    },
    "stiffness": {
        "compliance_largest_mm_per_n": "over all directions and poses; `compliance_least_mm_per_n` the smallest.",
        "models": "compliance of the rigid, joint, joint and bearing, and complete models.",
        "first_pose": "`compliance` (6 x 6; mm, rad per N, N m; root frame) at the tool point of the first pose.",
    },
    "camera": {
        "fx_px": "focal length; `fy_px`, `cx_px`, `cy_px` likewise. Pixel (0, 0) is the centre of the top-left pixel.",
        "distortion": "5 or 8 coefficients in the order of OpenCV.",
        "std": "1 sigma of each of them.",
        "held_out": "RMS reprojection error `rms_px` (2-D) on images left out of the fit.",
        "images": "one row for each image: `corners`, `rms_px`.",
    },
    "hand_eye": {
        "hand_eye": "the transform: `matrix` (4 x 4, mm), `xyz_mm`, `rotvec_deg`, `std_mm`, `rotvec_std_deg`; "
        "`std_deg` of a small rotation about the axes of the frame.",
        "transform": "its name: T_flange_sensor for a camera on the arm, T_base_sensor for a stationary one.",
        "target": "pose of the board, in the same form.",
        "held_out": "scatter of the board pose on images left out of the fit: `centre_mm`, `turn_deg`, `rms_px`.",
        "errors": "one row for each image.",
    },
    "render": {
        "recording": "folder of the recording; `wb.read` reads it.",
        "images": "number of images.",
    },
    "scan": {
        "scans": "one row for each scan: number of `points`, file of the `cloud` (mm), `balls` with centre, radius and "
        "1 sigma in mm, in `frame` (camera or base).",
        "ball_centres": "folder of a recording of the ball centres for `wb.calibrate`.",
        "acceptance": "probing and length errors as of ISO 10360 and VDI/VDE 2634.",
    },
    "scanner": {
        "camera": "as of `camera`.",
        "planes": "one row for each mirror step: `normal` and `offset_mm` of the light plane in the camera frame, "
        "`rms_mm`, `sigma_mm`.",
        "mirror": "axis, point (mm, camera frame) and angles (deg) of the mirror.",
        "left_out": "RMS distance `rms_mm` of stripe points of left-out board poses from their light plane.",
    },
    "check": {
        "coverage": "range of each joint (deg), extent of the flange (mm), spread of its orientation (deg).",
        "repeats": "groups of repeated poses; `noise_from_repeats_mm` is the noise that they show.",
        "missing": "one row for each remark: `command`, `required`, `what`, `action`.",
        "verdict": "`pass` and a sentence.",
    },
    "import_data": {
        "folder": "the new recording.",
        "mapping": "which column is what, in which unit; as in import.toml.",
        "conventions": "one row for each candidate of units and rotations: fit on the robot, `rms_mm`, `rms_deg`.",
        "questions": "what the data leave open.",
    },
    "new": {
        "folder": "the new recording.",
        "measures": "kind of its samples.",
        "samples": "number of its rows.",
    },
    "study": {
        "columns": "one row for each column of the table: `n`, `mean`, `std` and quantiles, in the unit of its name.",
        "outcome": "name of the column that the study is about.",
        "sensitivity": "Sobol indices of the outcome, or why there are none.",
        "coverage": "share of runs whose intervals contain the true value.",
    },
    "prove": {
        "cases": "number of blind cases.",
        "figures": "one row for each figure: `name`, `suite`, `value` with its interval, what is `asked`.",
    },
    "doctor": {
        "healthy": "whether all requirements are met.",
        "checks": "one row for each check: `name`, `ok`, `found`, `advice`.",
    },
    "datasets": {
        "datasets": "one row for each recording: `name`, `measures`, `variants`, `licence`, `folder` (None: not here).",
    },
    "evaluate": {
        "error": f"{_ERRORS} of the calibrated arm on the recording, none of which was fitted.",
        "refitted": "the same with base and tool estimated on the recording.",
        "nominal": "the same of the nominal arm, base and tool estimated on the recording.",
        "held_out": "the same as the calibration stated it for its own samples.",
        "by_joint": "one row for each joint that moves: `edges` of thirds of its readings (deg; mm for a prismatic "
        "joint), `rms_mm` in each, None in an empty one.",
        "verdict": _VERDICT,
    },
    "demo": {
        "held_out": f"{_ERRORS} of the arm, on samples that no fit has seen.",
        "from_pictures": "the same from rendered images, None without images.",
    },
}
"""Function -> entry of its answer -> meaning."""

SOURCES = {
    "calibrate": "stages are retained by K-fold cross-validation; parameters that the data do not identify are found "
    "by a singular value decomposition of the whitened Jacobian.",
    "calibrate_large": "normal equations added up in chunks; stages as by `calibrate`.",
    "compare": "corrected resampled t-test (Nadeau & Bengio, Machine Learning 52, 2003).",
    "compensate": "inverse kinematics of the calibrated model by damped least squares.",
    "diagnose": "posterior probability of sets of effects, nested cross-validation.",
    "evaluate": "prediction by the calibrated model with its parameters fixed.",
    "identifiability": "observability indices as of Sun & Hollerbach (ICRA 2008).",
    "poses": "D-optimal design, or the observability indices of Sun & Hollerbach (ICRA 2008).",
    "register": "Kabsch (Acta Cryst. A32, 1976); Umeyama (IEEE PAMI 13, 1991); ICP where points have no names.",
    "camera": "start by Zhang (IEEE PAMI 22, 2000), bundle adjustment with a bowed board.",
    "hand_eye": "start by Park & Martin (IEEE Trans. Robotics 10, 1994), then one adjustment of all images.",
}
"""Function -> source of its method."""

TABLES = {
    "calibrate": "parameters",
    "calibrate-large": "parameters",
    "camera": "images",
    "check": "missing",
    "compare": "plans",
    "compensate": "corrected.csv",
    "datasets list": "datasets",
    "demo": "parameters",
    "diagnose": "effects",
    "doctor": "checks",
    "evaluate": "residuals.csv",
    "handeye": "errors",
    "identifiability": "stages",
    "import": "conventions",
    "poses": "poses.csv",
    "prove": "figures",
    "scan": "scans",
    "scanner": "planes",
    "significance": "parameters",
    "stiffness": "stiffness.csv",
    "study": "columns",
}
"""Command -> its main table: an entry of the answer, or a file of the run folder."""
