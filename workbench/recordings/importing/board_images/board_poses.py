"""Import of images of a board with flange poses (hand-eye): units and rotation convention tested on the board.

The board is found in some of the images, and a camera is calibrated from them. `pose_readings` lists the possible
readings of the flange poses; `reading_fits` compares how well they explain the board poses.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from datasets.importers.mapping.candidates import (
    reordered_candidates,
)
from datasets.importers.mapping.conversion import (
    complete_rows,
    other_columns,
)
from datasets.importers.mapping.joined_tables.sessions import SESSION
from datasets.importers.mapping.model import Mapping
from datasets.importers.source import ImageFile, RawTable
from datasets.recording import Recording
from sensors.camera.model import Camera
from sensors.hand_eye.checks.relative_motions import (
    EQUAL_REMEDY,
    equal_poses,
    relative_motions,
    scale_gap,
)
from sensors.hand_eye.motion import motion
from workbench.core.errors import InputError
from workbench.core.rigid import inverse, rotation_matrix, transform
from workbench.fitting.verdicts.hand_eye_verdict import weak_focal
from workbench.machine.progress import paced
from workbench.recordings.importing.board_images.board_review import likely_mistake, pose_warnings
from workbench.recordings.importing.board_images.image_rows import matched_rows
from workbench.recordings.importing.board_images.pose_readings import (
    flange_readings,
    pose_columns,
    possible_readings,
    reading_line,
)
from workbench.recordings.importing.board_images.reading_fits import (
    BoardViews,
    agreeing_labels,
    as_instrument_poses,
    compare_readings,
)
from workbench.recordings.importing.interpretation.decisions import choose_reading
from workbench.recordings.importing.interpretation.fits import (
    is_only_good,
    order_error,
)
from workbench.recordings.importing.measured_robot import Made
from workbench.recordings.importing.segments.pose_segments import PoseReadings, refuse_changed_poses
from workbench.recordings.importing.sources.header_problems import pose_error

_IMAGES_TESTED = 60
_FEWEST = 4
_MOVED_MM = 2.0  # more than the pose of a board from one image errs by
_NO_BOARD = (
    "The board in the images is not described, so that no image can be used; add --board "
    '"chessboard 11x8 5mm" (kind, inner corners or circles, distance in mm), or name a Kalibr target file.'
)
_REMEDY = (
    "check that each row belongs to its image (a column image with the file names connects them), the size of the "
    "board, and the columns of the mapping"
)


def import_images(found, options, folder: Path, progress) -> Made:
    """Recording, complete mapping, fits and warnings of a folder of images with or without poses.

    folder: an empty place for the images until they are written. Raises InputError where the board is not described,
    images and rows do not correspond, or the poses fit under no reading.
    """
    mapping = replace(found.mapping, measures="board-images")
    if found.table is not None and not _has_poses(mapping):
        has_board = options.board or mapping.board or found.source.board
        raise pose_error(found.table, mapping, () if has_board else (_NO_BOARD,))
    board = _board(found, options)
    mapping = replace(mapping, board=board)
    if found.table is None:
        images = _linked_images(found.source.images, folder)
        return Made(_recording({}, images, board, folder, {}, options.name), mapping, (), ())
    table, notes = matched_rows(found.source.images, found.table)
    images = _linked_images([image for image, _ in table], folder)
    rows = found.table.take(np.array([row for _, row in table]))
    rows, dropped = complete_rows(rows, mapping)
    if dropped:
        raise InputError(f"{dropped[0]} Remove their images or complete the rows.")
    keys, mapping, readings = possible_readings(rows, mapping, options)
    progress("finding the board in the images")
    views = _board_views(_recording({}, images, board, folder, {}, options.name), options, progress)
    kind = "to-hand" if board.get("fixed_to") == "tool" else "in-hand"
    if not options.trust_data:
        _check_equal_poses(readings, views, rows)
    try:
        mapping, fits = _decide(readings, views, kind, rows, options)
    except InputError as problem:
        compared = compare_readings(readings, views, kind)
        if not (compared and compared[0][1].is_good):
            _refuse_other_order(rows, mapping, views, kind)
        probable = {place: readings[place] for place, _ in compared}
        named = likely_mistake(probable, views, kind, rows)
        raise problem if named is None else InputError(named) from None
    chosen = next(poses for _, candidate, poses in readings if candidate is mapping)
    warnings = _plausible(chosen[views.rows], views, kind)
    progress("comparing flange poses and images")
    wrong = pose_warnings(chosen, views, kind, rows)
    if wrong and not options.trust_data:
        refuse_changed_poses(_pose_readings(readings, views, kind), rows)
    warnings += wrong
    columns = {
        "sample": np.arange(1, rows.n + 1, dtype=float),
        **pose_columns(rows, mapping, keys),
    }
    others = other_columns(rows, mapping)
    columns |= {name: cells for name, cells in others.items() if cells.dtype.kind == "f"}
    columns |= {SESSION: rows.columns[SESSION]} if SESSION in rows.columns else {}
    recording = _recording(columns, images, board, folder, keys, options.name)
    return Made(recording, mapping, fits, (*notes, *warnings), suspicions=warnings)


def _check_equal_poses(readings, views: BoardViews, rows: RawTable) -> None:
    """Raise InputError where rows have one and the same pose, although the board moved between their images."""
    poses = readings[0][2][views.rows]
    seen = views.seen[0]
    distances = np.linalg.norm(seen[:, None, :3, 3] - seen[None, :, :3, 3], axis=-1)
    wrong = [(a, b) for a, b in equal_poses(poses) if distances[a, b] > _MOVED_MM]
    if not wrong:
        return
    first, later = wrong[0]
    numbers = [rows.lines[row] for row in views.rows]
    raise InputError(
        f"{rows.file}, rows {numbers[first]} and {numbers[later]}: expected the flange pose of each image, found the "
        f"pose of an earlier row in {len(wrong)} of {len(poses)} rows, although the board moved by "
        f"{distances[first, later]:.0f} mm between the images; {EQUAL_REMEDY}, or repeat with --trust-data."
    )


def _plausible(poses: np.ndarray, views: BoardViews, kind: str) -> tuple[str, ...]:
    """Sentences on what relative motions and missing rotations say of the poses (k, 4, 4) of the tested images."""
    sentences = [
        f"The flange poses do not determine everything: {sentence}."
        for sentence in motion(poses, kind).sentences
    ]
    if sentences:
        return tuple(sentences)
    measured = inverse(views.seen) if kind == "in-hand" else views.seen
    labels = agreeing_labels(measured[..., :3, :3], poses[:, :3, :3])
    seen = views.seen[labels, np.arange(len(views.rows))]
    gap = scale_gap(relative_motions(poses, seen, kind))
    if gap is None:
        return ()
    return (f"{gap[0][:1].upper()}{gap[0][1:]}; {gap[1]}.",)


def _board(found, options) -> dict:
    board = options.board or found.mapping.board or found.source.board
    if board is None:
        raise InputError(_NO_BOARD)
    return dict(board)


def _has_poses(mapping: Mapping) -> bool:
    """Whether the mapping names flange poses, or joint readings."""
    has_flange = mapping.flange_point is not None and mapping.flange_rotation is not None
    return has_flange or mapping.joints is not None


def _linked_images(images: Sequence[ImageFile], folder: Path) -> list[dict]:
    """Rows of images.csv; the files are linked into folder/images under unique names.

    Raises InputError for a file that is no image.
    """
    from sensors.images import check_readable

    target = folder / "images"
    target.mkdir(parents=True, exist_ok=True)
    rows, used = [], set()
    for number, image in enumerate(images, 1):
        if image.name not in used:
            name = image.name
        else:
            name = f"{number}-{image.name}"
        used.add(name)
        check_readable(image.path, image.name)
        (target / name).symlink_to(Path(image.path).resolve())
        rows.append({"image": f"images/{name}", "role": "board", "sample": number})
    return rows


def _recording(columns, images, board, folder, keys, name) -> Recording:
    if not columns:
        images = [{"image": row["image"], "role": "board"} for row in images]
    return Recording(
        measures="board-images",
        columns=columns,
        robot=keys,
        images=tuple(images),
        board=board,
        name=name,
        folder=folder,
    )


def _board_views(recording: Recording, options, progress) -> BoardViews:
    """Board poses of some of the images, evenly chosen. Raises InputError where the board is not found."""
    from sensors.boards.detection import detect_all, relabelled
    from sensors.camera.calibration import calibrate_camera
    from sensors.camera.model_choice import AUTO
    from workbench.files.images.images import check_size

    count = len(recording.images)
    rows = np.unique(np.linspace(0, count - 1, min(count, _IMAGES_TESTED)).astype(int))
    images = tuple(recording.images[row] for row in rows)
    tested_images = replace(recording, images=images)
    said_in = "--board" if options.board else "the description of the board"
    tick = paced(progress, "board in image")
    found = detect_all(tested_images, lambda done, total, name: tick(done, total), said_in=said_in)
    numbers = {image["image"]: row for row, image in zip(rows, tested_images.images)}
    if options.camera is None:
        progress("calibrating a camera to test the poses")
        calibration = calibrate_camera(found.views, found.board, found.size, AUTO, folds=0)
        camera = calibration.camera
    else:
        calibration = camera = options.camera
        check_size(camera, found.size, recording.name, "--camera")
    seen = []
    for turn in range(found.board.rotational_symmetry):
        labelled = [relabelled(view, found.board, turn) for view in found.views]
        seen.append([_pose_of(view, found.board, camera) for view in labelled])
    tested = np.array([numbers[view.image] for view in found.views])
    return BoardViews(np.array(seen), tested, found, calibration)


def _pose_of(view, board, camera) -> np.ndarray:
    """(4, 4) T_camera_board of one image."""
    from sensors.hand_eye.start import board_poses

    corners = board.points[:, view.index]
    return board_poses(corners, view.pixels, np.zeros(len(view.index), int), camera)[0]


def _decide(readings, views: BoardViews, kind: str, rows: RawTable, options):
    """The reading that explains the board poses, and the fits. Raises InputError where none or several do."""
    file = rows.file
    if len(views.rows) < _FEWEST:
        raise InputError(
            f"{file}: expected the board in {_FEWEST} images or more to test the poses, found it in "
            f"{len(views.rows)}; correct --board or take more images."
        )
    fits = compare_readings(readings, views, kind)
    if not (fits and fits[0][1].is_good):
        refuse_changed_poses(_pose_readings(readings, views, kind), rows)
        _refuse_other_kind(readings, views, kind, fits, file)
    lines = [reading_line(mapping) for _, mapping, _ in readings]
    chosen = choose_reading(lines, fits, f"{file}, flange poses", options.ask, _REMEDY)
    best = dict(fits)[chosen]
    if not best.is_good and not options.trust_data:
        raise InputError(
            f"{file}: expected flange poses that explain the board in the images, found none under any reading "
            f"(best {best.words}); check that rows and images belong together, the size of the board and the mapping"
            f"{_weak_camera(views)}, or repeat with --trust-data."
        )
    return readings[chosen][1], tuple(fit for _, fit in fits)


def _weak_camera(views: BoardViews) -> str:
    """What to do where the images do not determine the camera with which the poses are tested; empty elsewhere."""
    calibration = views.camera
    focal = None if isinstance(calibration, Camera) else weak_focal(calibration)
    if focal is None:
        return ""
    return (
        f"; the images determine the focal length to {100 * focal:.2g} % only, name a calibrated camera with --camera "
        "camera.toml"
    )


def _pose_readings(readings, views: BoardViews, kind: str) -> PoseReadings:
    """Every reading of the table on the tested images, for the search of rows where it changes."""
    measured = inverse(views.seen) if kind == "in-hand" else views.seen

    def best(places: np.ndarray) -> tuple[int, np.ndarray] | None:
        selected = replace(views, seen=views.seen[:, places], rows=views.rows[places])
        fits = compare_readings(readings, selected, kind)
        if not (fits and fits[0][1].is_good):
            return None
        poses = readings[fits[0][0]][2][selected.rows]
        labels = agreeing_labels(measured[:, places, :3, :3], poses[:, :3, :3])
        return fits[0][0], labels

    return PoseReadings(readings, views.rows, measured, best, _solved)


def _solved(poses: np.ndarray, measured: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(4, 4) from flange to target, and (4, 4) pose of the base, that fit flange and target poses (m, 4, 4) best."""
    frames, target = as_instrument_poses(poses, measured)
    base, tool = target.start(frames)
    sensor, pose = (transform(rotation_matrix(twist[3:]), twist[:3]) for twist in (tool, base))
    return sensor, pose


def _refuse_other_kind(readings, views: BoardViews, kind: str, fits, file: str) -> None:
    """Raise InputError where a board on the other side of the chain explains the poses."""
    other = compare_readings(readings, views, "to-hand" if kind == "in-hand" else "in-hand")
    if not (other and other[0][1].is_good):
        return
    best = f" ({fits[0][1].words})" if fits else ""
    stated, fixed = ("base", "tool") if kind == "in-hand" else ("tool", "base")
    raise InputError(
        f"{file}: expected poses that agree with a board fixed to the {stated}{best}, found that they agree with a "
        f'board fixed to the {fixed} or with inverse poses ({other[0][1].words}); add fixed_to = "{fixed}" to '
        "[board] of a mapping file (--map), or invert the poses."
    )


def _refuse_other_order(rows: RawTable, mapping: Mapping, views: BoardViews, kind: str) -> None:
    """Raise InputError where the rotation explains the poses with its columns in one other order than their names'."""
    if mapping.flange_rotation is None:
        return
    turns = reordered_candidates(mapping.flange_rotation, rows)
    readings = flange_readings(rows, mapping, turns) if turns else []
    fits = compare_readings(readings, views, kind) if readings else []
    if is_only_good(fits):
        best = readings[fits[0][0]][1]
        raise order_error(rows.file, best.flange_rotation, fits[0][1], reading_line(best))
