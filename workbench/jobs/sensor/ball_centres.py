"""Results of scans: the JSON contract, acceptance figures, and the recording of ball centres for `calibrate`."""

from array import array
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from operator import itemgetter
from pathlib import Path

import numpy as np

import datasets
from datasets.recording import Recording
from sensors.acceptance import Characteristic, acceptance
from sensors.ball.search import Refusal
from sensors.scanner.model import Scanner
from workbench.core.errors import InputError
from workbench.files.images.flange import rows_of_samples
from workbench.files.provenance import provenance
from workbench.files.spool import JoinedMapping, Made, Spool
from workbench.fitting.verdicts.sensor_verdict import scan_verdict, scan_warnings
from workbench.fitting.verdicts.verdict import Tolerance
from workbench.jobs.sensor.scan import Ball, Scan, Scans

FOLDER = "ball-centres"


def as_json(scans: Scans, folder: Path, tolerances: Sequence[Tolerance] = ()) -> dict:
    """The answer of `workbench scan`; folder: where the run will stand; tolerances: what its verdict is judged by."""
    centres = centres_of(scans)
    return {
        "scans": Made(scans.scans, lambda scan: scan_json(scan, folder, scans.scanner)),
        "uncertainty": uncertainty(scans.scanner),
        "scanner": None if scans.calibration is None else str(folder / "scanner.toml"),
        "ball_centres": None
        if centres is None
        else {"folder": str(folder / FOLDER), "samples": centres.n},
        "acceptance": [
            characteristic_json(characteristic) for characteristic in characteristics(scans)
        ],
        "warnings": scan_warnings(scans),
        "verdict": scan_verdict(scans, tolerances).as_json(),
        "provenance": provenance(scans.recording),
    }


def uncertainty(scanner: Scanner | None) -> str:
    """Source of the sigmas of ball centres; scanner: None if the sensor delivers points."""
    best = (
        "std_in_best_frame_mm: 1 sigma in the frame that fits the scanner's points best, for distances between balls, "
        "hand-eye and robot calibration; scans that flange poses join share the error of the hand-eye transform, which "
        "turns with the flange: between two of them std_mm holds"
    )
    if scanner is None:
        return (
            "std_mm: 1 sigma of x, y and z in the base frame, with the uncertainty of the hand-eye transform; "
            "std_in_best_frame_mm is without it"
        )
    if scanner.frame is None:
        return f"std_mm is the same, since the frame's own uncertainty is not in the scanner's file; {best}"
    return (
        "std_mm: 1 sigma of x, y and z in the camera's frame, with the uncertainty of that frame, which all points of "
        f"a scan share; {best}"
    )


def scan_json(scan: Scan, folder: Path, scanner: Scanner) -> dict:
    """One scan of the contract."""
    return {
        "scan": scan.name,
        "frame": scan.frame,
        "sample": scan.row.get("sample"),
        "points": scan.points,
        "cloud": str(folder / scan.cloud) if scan.points else None,
        "dropped": dict(scan.dropped),
        "rejected": [{"image": unseen.image, "why": unseen.why} for unseen in scan.rejected],
        "balls": [ball_json(ball, scanner) for ball in scan.balls],
        "refused": [refusal_json(candidate) for candidate in scan.refused],
        "outcome": scan.outcome,
    }


def whole_covariance(scanner: Scanner, ball: Ball) -> np.ndarray:
    """(3, 3) mm^2 of a ball's centre in the frame of its scan: of the fit, and of what all points of the scan share."""
    fit = ball.fit
    if ball.common is not None:
        return fit.covariance[:3, :3] + ball.common
    return fit.covariance[:3, :3] + scanner.frame_covariance(fit.centre[:, None])[..., 0]


def ball_json(ball: Ball, scanner: Scanner) -> dict:
    """A ball of the contract, frame of its scan: `radius_mm` is that of the fit, certified where it is known; `std_mm`
    holds in that frame, see `uncertainty`."""
    fit, free = ball.fit, ball.free
    full_covariance = whole_covariance(scanner, ball)
    return {
        "ball": ball.number,
        **dict(zip(("x_mm", "y_mm", "z_mm"), fit.centre.tolist())),
        "radius_mm": fit.radius,
        "radius_known": ball.radius is not None,
        "rms_mm": fit.rms,
        "std_mm": np.sqrt(np.diag(full_covariance)).tolist(),
        "covariance_mm2": full_covariance.tolist(),
        "std_in_best_frame_mm": fit.std[:3].tolist(),
        "covariance_in_best_frame_mm2": fit.covariance[:3, :3].tolist(),
        "free_radius_mm": free.radius,
        "free_radius_std_mm": float(free.std[-1]),
        "d95_mm": fit.d95,
        "peak_to_valley_mm": fit.peak_to_valley,
        "used": int(fit.inliers.sum()),
        "rejected": fit.rejected,
        "cap_deg": float(np.rad2deg(fit.cap)),
        "cut_by_field": bool(fit.cut),
        "beyond_calibrated_depths": ball.is_beyond_volume,
        "radius_gap_sigma": _number(fit.radius_gap),
        "centre_moves_with_free_radius_mm": _number(fit.centre_moves),
        "misfit": None if ball.misfit is None else ball.misfit.as_json(),
        "warnings": list(fit.warnings),
        "outcome": fit.outcome,
    }


def refusal_json(refusal: Refusal) -> dict:
    """A candidate that is no ball, and the requirement that it fails."""
    x, y, z = refusal.centre.tolist()
    place = {"x_mm": x, "y_mm": y, "z_mm": z}
    return {**place, "radius_mm": refusal.radius, "points": refusal.points, "why": refusal.why}


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def characteristics(scans: Scans) -> tuple[Characteristic, ...]:
    """Acceptance figures over all scans: the largest of all scans is the result.

    Balls that are cut by the field, hidden in part or beyond the calibrated depths do not count. Worked out once."""
    if "characteristics" not in scans.cache:
        scans.cache["characteristics"] = _characteristics(scans)
    return scans.cache["characteristics"]


def _characteristics(scans: Scans) -> tuple[Characteristic, ...]:
    all_combined = tuple(map(_Combined, acceptance()))
    single = (
        [
            combined.add(scan.name, characteristic)
            for combined, characteristic in zip(all_combined, scan.accepted)
        ]
        for scan in scans.scans
    )
    spool = Spool(
        single, folder=scans.folder
    )  # single results of a long session are read when they are written
    return tuple(
        combined.characteristic(JoinedMapping(Made(spool, itemgetter(k))))
        for k, combined in enumerate(all_combined)
    )


class _Combined:
    """One characteristic of all scans, as they come: the largest of those determined; of shares and temperatures the
    mean. `undetermined` stands where there is no scan."""

    def __init__(self, undetermined: Characteristic):
        self._kept, self._scans, self._n, self._sum = undetermined, 0, 0, 0.0

    def add(self, name: str, characteristic: Characteristic) -> dict[str, float]:
        """That of the next scan; gives back its single results by their names among those of all scans."""
        self._scans += 1
        if (
            self._scans == 1
            or characteristic.determined
            and not abs(characteristic.value) <= abs(self._kept.value)
        ):  # nan: none so far
            self._kept = characteristic
        if not characteristic.determined:
            return {}
        self._n, self._sum = (
            self._n + characteristic.n,
            self._sum + characteristic.n * characteristic.value,
        )
        return {f"scan {name}, {part}": value for part, value in characteristic.parts.items()}

    def characteristic(self, single_results: Mapping[str, float]) -> Characteristic:
        """That of all scans so far, with their single results."""
        if not self._kept.determined:
            return self._kept
        mean = self._kept.name in ("rejected", "temperature")
        if mean:
            value = float(self._sum / self._n)
        else:
            value = self._kept.value
        return replace(self._kept, value=value, n=self._n, parts=single_results)


def characteristic_json(characteristic: Characteristic) -> dict:
    """A line of the acceptance report."""
    return {
        "name": characteristic.name,
        "symbol": characteristic.symbol,
        "vdi": characteristic.vdi,
        "value": characteristic.value if characteristic.determined else None,
        "unit": characteristic.unit,
        "std": characteristic.std,
        "n": characteristic.n,
        "why": characteristic.why,
        "parts": characteristic.parts,
        "definition": characteristic.definition,
        "verdict": characteristic.verdict,
    }


def centres_of(scans: Scans) -> Recording | None:
    """The recording of kind ball-centre that these scans make; None where no ball is named or no sample is known.

    One row a ball and scan, with all columns of the sample that the scan belongs to, sigmas of each
    coordinate from the covariance of the fit, and where in the sensor's field the ball was seen. The sigmas are in the
    frame that fits best: what the camera's own frame is off, the calibration of the arm takes up. Worked out once.
    """
    if "centres" not in scans.cache:
        scans.cache["centres"] = _centres_of(scans)
    return scans.cache["centres"]


def _centres_of(scans: Scans) -> Recording | None:
    recording = scans.recording
    is_placed = recording.columns and (recording.robot or recording.flange is not None)
    measured = _columns(scans) if is_placed else {}
    if not measured:
        return None
    place = rows_of_samples(recording, measured.pop("sample"))
    columns = {name: values[place] for name, values in recording.columns.items()}
    if len(set(place.tolist())) < len(place):
        columns["pose"] = columns.get("pose", columns["sample"])
        columns["sample"] = np.arange(1.0, len(place) + 1)
    return Recording(
        "ball-centre",
        columns | measured,
        recording.robot,
        title=recording.title,
        balls=recording.balls,
        guess=recording.guess,
        name=recording.name,
        source=recording.source,
        licence=recording.licence,
        sha256=recording.sha256,
    )


def check_arm(recording: Recording) -> None:
    """Raise InputError, before anything is scanned, where a recording knows no arm."""
    if not recording.columns or not recording.robot:
        raise InputError(
            f"{recording.name}/recording.toml: expected [robot] and [samples] to calibrate an arm from scans, found "
            "none; add them, or use `workbench scan` for the balls alone"
        )


def check_poses(recording: Recording) -> None:
    """Raise InputError, before anything is scanned, where no pose of a robot is known at the scans."""
    if not recording.columns or (not recording.robot and recording.flange is None):
        raise InputError(
            f"{recording.name}/recording.toml: expected [samples] with joint readings and [robot], or with flange "
            "poses, to diagnose ball centres, found none; add them, or omit --scanner to diagnose the images"
        )


def required(scans: Scans) -> Recording:
    """The recording of ball centres; InputError where these scans make none."""
    found = centres_of(scans)
    if found is not None:
        return found
    if any(scan.frame == "base" for scan in scans.scans):
        raise InputError(
            f"{scans.recording.name}, images.csv: expected scans that were taken at one sample each, found images of "
            "one scan at several samples; joining them assumes that the flange poses are right: use `workbench scan`"
        )
    name = scans.recording.name
    fitted = sum(bool(ball.fit) for scan in scans.scans for ball in scan.balls)
    if not any("sample" in scan.row for scan in scans.scans):
        raise InputError(
            f"{name}, images.csv, column sample: expected the row of samples.csv that each scan belongs to, found "
            "none; add the column"
        )
    why = next((scan.outcome for scan in scans.scans if scan.outcome), "no ball was found")
    raise InputError(
        f"{name}: expected balls that are known by their number in artefact.csv, found {fitted} balls and none "
        f"of them named ({why}); add a column ball to samples.csv"
    )


def renumbered(
    scans: Scans, centres: Recording, samples: Sequence[int] | None
) -> tuple[int, ...] | None:
    """Samples of `centres` that come from these samples of the images' recording; None for None."""
    if samples is None:
        return None
    wanted = np.isin([int(row["sample"]) for row, _ in _rows(scans)], list(samples))
    return tuple(int(number) for number in centres.sample_ids[wanted])


def _rows(scans: Scans) -> Iterator[tuple[dict, Ball]]:
    """Row of images.csv and ball, of every named ball in a scan of one sample, at depths that are calibrated."""
    for scan in scans.scans:
        for ball in scan.balls:
            is_placed = scan.frame == "camera" and "sample" in scan.row
            if ball.number is not None and ball.fit and not ball.is_beyond_volume and is_placed:
                yield scan.row, ball


def _columns(scans: Scans) -> dict[str, np.ndarray]:
    """Columns (k,) of `_ball_columns` of every row of `_rows`, and its sample; numbers alone are kept of a ball."""
    columns: dict[str, array] = {}
    for row, ball in _rows(scans):
        for name, value in {"sample": row["sample"], **_ball_columns(scans, ball)}.items():
            columns.setdefault(name, array("d")).append(value)
    return {name: np.array(values) for name, values in columns.items()}


def _ball_columns(scans: Scans, ball: Ball) -> dict[str, float]:
    """Columns of one ball centre, in file units."""
    fit = ball.fit
    std = fit.std[:3]
    outward = ball.points[:, fit.inliers] - fit.centre[:, None]
    to_sensor = -ball.points[:, fit.inliers]
    cosine = (outward * to_sensor).sum(0) / (
        np.linalg.norm(outward, axis=0) * np.linalg.norm(to_sensor, axis=0)
    )
    u, v = scans.scanner.camera.project(fit.centre[:, None])[:, 0]
    return {
        "ball": ball.number,
        **dict(zip(("x_mm", "y_mm", "z_mm"), fit.centre.tolist())),
        "sigma_mm": float(np.sqrt((std**2).mean())),
        **dict(zip(("sigma_x_mm", "sigma_y_mm", "sigma_z_mm"), std.tolist())),
        "range_mm": float(np.linalg.norm(fit.centre)),
        "u_px": float(u),
        "v_px": float(v),
        "incidence_deg": float(np.rad2deg(np.arccos(np.clip(cosine, -1, 1)).mean())),
    }


def save(scans: Scans, folder: Path) -> None:
    """Write the recording of ball centres, and the scanner where it was calibrated here, into `folder`."""
    if scans.calibration is not None:
        from workbench.jobs.sensor import scanner

        scanner.save(scans.calibration, folder)
    centres = centres_of(scans)
    if centres is not None:
        datasets.write(centres, folder / FOLDER)
