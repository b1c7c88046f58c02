"""From images of a board, without and with the laser, to a scanner: the recording's part, contract and file."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from datasets.recording import Recording
from sensors.boards.board import Board
from sensors.boards.detection import Rejected, View
from sensors.camera.model_choice import AUTO
from sensors.images import read_grey, stacks, unlit
from sensors.light.board_stripes import BoardStripes, joined
from sensors.scanner.bowed import calibrated_with_bow, misfit_of
from sensors.scanner.calibration import ScannerCalibration, calibrate_scanner
from sensors.scanner.model import Scanner
from sensors.scanner.residuals.misfit import Misfit
from sensors.scanner.turntable_calibration import TurntableCalibration
from sensors.scanner.unseen_steps import with_unseen_steps
from sensors.stripe.asymmetry import Asymmetry, Profiles, asymmetry
from sensors.stripe.find import exposures, find_stripes
from sensors.trust import Trust
from workbench.core.errors import InputError
from workbench.files.images.columns import recorded_columns
from workbench.files.images.images import by_role, full_scale, path_of, streamed
from workbench.files.provenance import provenance
from workbench.fitting.verdicts.sensor_verdict import (
    camera_trust,
    scanner_trust,
    scanner_verdict,
    scanner_warnings,
)
from workbench.fitting.verdicts.verdict import Tolerance
from workbench.jobs.sensor import camera as cameras
from workbench.jobs.sensor.turntables import turntable_json, turntable_of
from workbench.machine.progress import paced

FILE = "scanner.toml"
_FRAMES = 16
_MAX_GRID_STEPS = 1.5  # steps of the grid that a board may reach beyond its outermost corners
_OUTLINED = 12  # corners that place the rest of a board
_FAR_PX = 30_000.0  # px beyond which an outline is cut
_TRIED = 3  # board poses from which the direction of the stripes is read


@dataclass(frozen=True)
class ScannerRun:
    """A recording's scanner: the `camera` from its corners alone, and `calibration` of everything together.

    `unusable`: board poses with laser images whose stripes could not be used, and why; `rejected` every image under
    the laser that was left out, these and those that are black or overexposed. `misfit`: lack of fit of the stripes,
    and `asymmetry` of the line's profile; None where there are too few stripes. `unseen`: the scanner with the planes
    of steps that scans use and no board saw, and these steps. `turntable`: from images that state `table_deg`.
    """

    recording: Recording
    camera: cameras.CameraRun
    calibration: ScannerCalibration
    unusable: tuple[Mapping, ...]
    rejected: tuple[Rejected, ...] = ()
    misfit: Misfit | None = None
    asymmetry: Asymmetry | None = None
    unseen: tuple[Scanner, tuple[int, ...]] | None = None
    turntable: TurntableCalibration | None = None

    @property
    def scanner(self) -> Scanner:
        """The calibrated scanner, with planes of steps that no board saw where a mirror gives them."""
        scanner = self.calibration.scanner if self.unseen is None else self.unseen[0]
        table = scanner.turntable if self.turntable is None else self.turntable.table
        own_trust, of_camera = self._trust
        return replace(scanner, turntable=table, trust=own_trust, camera_trust=of_camera)

    @cached_property
    def _trust(self) -> tuple[Trust, Trust]:
        """Trustworthiness of the calibration of the scanner, and of its camera alone."""
        own_trust = scanner_trust(self.calibration, self.misfit, self.asymmetry)
        return own_trust, camera_trust(self.calibration.start)


def calibrate(
    recording: Recording, model: str = AUTO, progress: Callable[[str], None] = lambda text: None
) -> ScannerRun:
    """The scanner of a recording with images of a board, without and with the laser.

    model: that of the lens, as of `calibrate_camera`; progress: called with one line a step. Raises InputError.
    """
    groups = _laser_rows(recording)
    camera = cameras.calibrate(recording, model, progress)
    seen = {view.placement: view for view in camera.calibration.views}
    usable = [(seen[name], rows) for name, rows in groups.items() if name in seen]
    unusable = tuple(
        {"placement": name, "images": len(rows), "why": _why(camera, name)}
        for name, rows in groups.items()
        if name not in seen
    )
    if not usable:
        raise InputError(
            f"{recording.name}, images.csv: expected the board to be found in a board pose with laser images, "
            f"found it in none of {len(groups)} ({unusable[0]['why']}); take the board images again"
        )
    rejected = [
        Rejected(
            row["image"],
            f"the board was not found in its pose ({placement['why']})",
            placement["placement"],
        )
        for placement in unusable
        for row in groups[placement["placement"]]
    ]
    profiles: list[Profiles] = []
    stripes = board_stripes(
        recording, usable, camera.calibration.board, progress, rejected, profiles
    )
    calibration = calibrated_with_bow(
        lambda effects: _adjusted(recording, camera.calibration, stripes, effects, progress)
    )
    shape = asymmetry(Profiles.joined(profiles)) if profiles else None
    return ScannerRun(
        recording,
        camera,
        calibration,
        unusable,
        tuple(rejected),
        misfit_of(calibration),
        shape,
        with_unseen_steps(calibration, _commanded(recording)),
        turntable_of(camera.calibration, calibration, progress),
    )


def _adjusted(recording, camera, stripes, effects, progress) -> ScannerCalibration:
    """The scanner from a calibrated camera and stripes on its boards."""
    return calibrate_scanner(
        camera.views,
        stripes,
        camera.board,
        camera.camera.size,
        camera=camera,
        effects=effects,
        provenance={k: v for k, v in provenance(recording).items() if v},
        progress=progress,
    )


def _laser_rows(recording) -> dict[str, list[Mapping]]:
    """Rows of images with the laser by board pose; InputError where there are none."""
    groups: dict[str, list[Mapping]] = {}
    for row in by_role(recording, "board-laser"):
        groups.setdefault(str(row["placement"]), []).append(row)
    if not groups:
        raise InputError(
            f"{recording.name}, images.csv, column role: expected images of a board under the laser, found "
            "none; add rows with role board-laser, or calibrate the camera alone with `workbench camera`"
        )
    return groups


def _commanded(recording) -> dict[int, float | None]:
    """Mirror angle (rad) by step of all images with the laser, None where images.csv does not state it."""
    rows = [row for row in recording.images if row["role"] in ("board-laser", "scan")]
    angles: dict[int, float | None] = {}
    for row in rows:
        angle = row.get("mirror_deg")
        angles.setdefault(
            int(row.get("step", 0)), None if angle is None else float(np.deg2rad(angle))
        )
    return angles


def _why(camera, placement):
    reasons = [rejection.why for rejection in camera.rejected if rejection.placement == placement]
    return reasons[0] if reasons else "no board image at this board pose"


def board_stripes(
    recording,
    usable,
    board: Board,
    progress,
    rejected: list[Rejected] | None = None,
    profiles: list[Profiles] | None = None,
) -> BoardStripes:
    """The laser's line on every board: `usable` pairs of a view and the rows of its images under the laser.

    rejected: given those in which no line can be seen; profiles: given the profiles of the line.
    """
    saturation = full_scale(recording, [row for _, rows in usable for row in rows])
    direction = _direction(recording, usable[:_TRIED], board, saturation)
    work = _Work(recording, board, direction, saturation)
    all_stripes = []
    for stripes, unseen, shapes in streamed(usable, work, paced(progress, "laser on board pose")):
        all_stripes += stripes
        if rejected is not None:
            rejected += unseen
        if profiles is not None:
            profiles += shapes
    return joined(all_stripes)


def _direction(recording, usable, board, saturation) -> str:
    """Across which lines of the image the stripes run: where more of them have one clear peak."""
    found = {"rows": 0, "columns": 0}
    for view, rows in usable:
        middle = rows[len(rows) // 2 : len(rows) // 2 + 1]
        for direction in found:
            found[direction] += sum(
                part.n for part in _Work(recording, board, direction, saturation)((view, middle))[0]
            )
    return max(found, key=found.get)


@dataclass(frozen=True)
class _Work:
    """Processing of the laser images of one board pose: their stripes, images in which no line can be seen, and
    profiles of the line; `scan_axis` and `saturation` as in `find_stripes`."""

    recording: Recording
    board: Board
    scan_axis: str
    saturation: float | None = None

    def __call__(
        self, placed: tuple[View, list[Mapping]]
    ) -> tuple[list[BoardStripes], list[Rejected], list[Profiles]]:
        view, rows = placed
        paths = [path_of(self.recording, row) for row in rows]
        called = {path: f"{self.recording.name}/{row['image']}" for path, row in zip(paths, rows)}
        dark = read_grey(path_of(self.recording, view.row), f"{self.recording.name}/{view.image}")
        region = region_of(view, self.board)
        first = 0
        stripe_sets = []
        rejected = []
        profiles = []
        for stack in stacks(paths, _FRAMES, called.get):
            if dark.shape == stack.shape[1:] and dark.dtype == stack.dtype:
                background = dark
            else:
                background = None
            if stack.shape[1:] != region.shape:
                raise InputError(
                    f"{called[paths[first]]}: expected {view.size[0]} x {view.size[1]} px as the board's "
                    f"image, found {stack.shape[2]} x {stack.shape[1]} px; take both with the same settings"
                )
            stack_rows = rows[first : first + len(stack)]
            why = [unlit(frame) for frame in stack]
            rejected += [
                Rejected(row["image"], reason, view.placement)
                for row, reason in zip(stack_rows, why)
                if reason
            ]
            lit_indices = [k for k, reason in enumerate(why) if not reason]
            if lit_indices:
                found = find_stripes(
                    stack[lit_indices],
                    self.scan_axis,
                    background=background,
                    region=region,
                    saturation=self.saturation,
                )
                stripe_sets.append(
                    _board_stripes(found, [stack_rows[k] for k in lit_indices], view.placement)
                )
                profiles.append(_profiles(stack[lit_indices], found, background))
            first += len(stack)
        return stripe_sets, rejected, profiles


def _profiles(stack, found, background) -> Profiles:
    """Profiles of the line in images (F, H, W), less the same scene without laser at its fitted exposure."""
    if background is None:
        return Profiles.of(stack, found)
    scale = exposures(stack, background[None])
    return Profiles.of(stack, found, scale[:, None, None] * background)


def _board_stripes(found, rows, placement) -> BoardStripes:
    """Stripes with what images.csv says of their images."""
    names = recorded_columns(rows)
    if all("mirror_deg" in row for row in rows):
        angles = [row["mirror_deg"] for row in rows]
    else:
        angles = None
    covariates = {name: [row[name] for row in rows] for name in names}
    return BoardStripes.of(
        found,
        [placement] * len(rows),
        [int(row.get("step", 0)) for row in rows],
        angles,
        covariates,
    )


def region_of(view: View, board: Board) -> np.ndarray:
    """(H, W) bool: the board's part of the image, with a margin, where a laser's line is looked for.

    Where some corners were not seen (a board cut by the border, or covered in part), the whole board counts, placed by
    the corners that were.
    """
    import cv2

    width, height = view.size
    middle = view.pixels.mean(1, keepdims=True)
    wider = 1 + 2 * _MAX_GRID_STEPS / (min(board.columns, board.rows) - 1)
    outlines = [middle + wider * (view.pixels - middle)]
    if len(view.index) < board.count:
        outlines += _outline(view, board)
    mask = np.zeros((height, width), np.uint8)
    for part in outlines:
        hull = cv2.convexHull(np.ascontiguousarray(part.T, np.float32))
        cv2.fillConvexPoly(mask, np.round(hull).astype(np.int32), 1)
    return mask.astype(bool)


def _outline(view: View, board: Board) -> list[np.ndarray]:
    """Outline (2, 4) px of the whole board by the homography of the corners that were seen; none without one."""
    import cv2

    if len(view.index) < _OUTLINED:
        return []
    seen = board.points[:2, view.index]
    homography, _ = cv2.findHomography(seen.T, view.pixels.T)
    if homography is None:
        return []
    low = board.points[:2].min(1)
    high = board.points[:2].max(1)
    low = low - _MAX_GRID_STEPS * board.square_mm
    high = high + _MAX_GRID_STEPS * board.square_mm
    ends = np.array([[low[0], high[0], high[0], low[0]], [low[1], low[1], high[1], high[1]]])
    placed = homography @ np.vstack([ends, np.ones(4)])
    if (placed[2] <= 0).any():
        return []  # the extrapolated board reaches behind the camera
    return [np.clip(placed[:2] / placed[2], -_FAR_PX, _FAR_PX)]


def as_json(run: ScannerRun, tolerances: Sequence[Tolerance] = ()) -> dict:
    """The scanner's part of the JSON contract; tolerances: what its verdict is judged by."""
    calibration, scanner = run.calibration, run.scanner
    joint = cameras.camera_json(calibration.camera, calibration.std)
    planes = [
        {
            "step": int(step),
            "normal": plane[:3].tolist(),
            "offset_mm": float(plane[3]),
            "rms_mm": float(rms),
            "rms_px": float(px),
            "sigma_mm": float(sigma),
            "sigma_best_frame_mm": sigma_apart,
        }
        for step, plane, rms, px, sigma, sigma_apart in zip(
            scanner.steps,
            scanner.planes.T,
            calibration.rms_mm,
            calibration.rms_px,
            calibration.sigma_plane_mm,
            _plane_sigmas(calibration),
        )
    ]
    good = ~calibration.wrong
    return {
        "camera": {**cameras.as_json(run.camera), **joint},
        "planes": planes,
        "mirror": mirror_json(calibration),
        "plane_rms_mm": float(np.sqrt((calibration.residual_mm[good] ** 2).mean())),
        "plane_rms_px": calibration.sigma_stripe_px,
        "corner_rms_coordinate_px": calibration.sigma_corner_px,
        "shared_px": shared_json(calibration),
        "stripe_points": int(good.sum()),
        "left_out": left_out_json(calibration.left_out),
        "dropped": dict(calibration.dropped),
        "turntable": turntable_json(run.turntable),
        "unusable_placements": list(run.unusable),
        "rejected": [
            {"image": rejection.image, "why": rejection.why} for rejection in run.rejected
        ],
        "volume_mm": list(calibration.volume),
        "sentences": [*calibration.sentences, *_on_unseen(run), *_on_turntable(run)],
        "misfit": None if run.misfit is None else run.misfit.as_json(),
        "line_asymmetry": None if run.asymmetry is None else run.asymmetry.as_json(),
        "line_dependence": None
        if calibration.dependence is None
        else calibration.dependence.as_json(),
        "warnings": scanner_warnings(calibration, run.misfit, run.asymmetry),
        "verdict": scanner_verdict(calibration, tolerances, run.misfit).as_json(),
        "provenance": provenance(run.recording),
    }


def _on_turntable(run: ScannerRun) -> tuple[str, ...]:
    return () if run.turntable is None else run.turntable.sentences


def _on_unseen(run: ScannerRun) -> list[str]:
    steps = () if run.unseen is None else run.unseen[1]
    if not steps:
        return []
    return [
        "steps that no board saw have the planes that the mirror gives them: "
        f"{', '.join(str(step) for step in sorted(steps))}"
    ]


def _plane_sigmas(calibration) -> list[float | None]:
    """mm, 1 sigma of each plane in the frame that fits best; None where such a frame takes up all of it."""
    alone = calibration.sigma_stated_mm is calibration.sigma_plane_mm
    if alone:
        return [None] * len(calibration.scanner.steps)
    return calibration.sigma_apart_mm.tolist()


def shared_json(calibration: ScannerCalibration) -> dict:
    """1 sigma, px, by which points of stripes err together, by kind, with its own sigma (None: not known)."""
    shared = calibration.made.board_stripes.shared_errors
    return {
        name: {"sigma": sigma, "std": float(std) if np.isfinite(std) else None}
        for (name, sigma), std in zip(shared.named.items(), shared.std)
    }


def mirror_json(calibration: ScannerCalibration) -> dict | None:
    """The axis and the angle law where the planes share one mirror; None where none was tried."""
    check = calibration.mirror
    if check is None:
        return None
    mirror = check.mirror
    angles = np.rad2deg(check.angles)
    return {
        "supported": check.supported,
        "axis": mirror.axis.tolist(),
        "point_mm": mirror.point.tolist(),
        "face": mirror.face.tolist(),
        "offset_mm": mirror.offset,
        "beam": mirror.beam.tolist(),
        "angles_deg": angles.tolist(),
        "angle_law": {
            "first_deg": float(angles[0]),
            "step_deg": float(np.mean(np.diff(angles))),
            "gain": check.gain,
            "plane_turns_per_mirror_turn": 2,
        },
        "fitted": list(check.fitted),
        "std": check.std,
        "difference_mm": check.difference_mm,
        "expected_mm": check.expected_mm,
        "probability": check.probability,
        "verdict": check.verdict,
        "sentences": list(check.sentences),
    }


def left_out_json(held_out) -> dict | None:
    """Stripes of board poses that were left out of the planes."""
    if held_out is None:
        return None
    return {
        "folds": held_out.folds,
        "rms_mm": held_out.rms_mm,
        "rms_px": held_out.rms_px,
        "rms_all_mm": held_out.rms_all_mm,
        "inlier_share": held_out.share,
        "sentence": held_out.sentence,
    }


def save(run: ScannerRun, folder: Path) -> None:
    """Write scanner.toml into `folder`: what `read` takes."""
    from sensors.scanner.file import write_scanner

    write_scanner(run.scanner, folder / FILE)


def read(path: Path) -> Scanner:
    """The scanner of a scanner.toml. Raises InputError."""
    from sensors.scanner.file import read_scanner

    return read_scanner(Path(path))
