"""recording.toml of a template: every key with a comment that says what to put there."""

import textwrap

from datasets.recording import Recording

_ROWS = {
    "ball-centre": "the centre of ball `ball` (of artefact.csv) in the frame of the sensor on the flange",
    "external-point": "one reflector on the flange in the frame of the tracker; the column reflector says which",
    "external-pose": "origin and unit quaternion of the target on the flange in the frame of the tracker",
    "partial-pose": "origin and x axis (unit vector nx ny nz) of the target on the flange, tracker frame",
    "target-pose": "flange pose, and pose of the marker in the frame of the camera (origin, unit quaternion)",
    "touch-point": "the tip touches the fixed point `point`; nothing is measured but the joints",
    "laser-spot": "the beam of the laser on the flange passes through point `point` of sphere `sphere`",
    "distance": "one end of a measured length: two rows of one `pair` with the same length_mm",
    "plane-touch": "the tip touches the fixed plane `plane`; nothing is measured but the joints",
    "ball-surface": "a point on the surface of ball `ball` in the frame of the sensor; rows of one `pose` together",
    "board-images": "the flange pose of the image with the same number in images.csv",
    "scan-images": "the joint readings of the scan with the same number in images.csv",
}
_NEXT = {
    "target-pose": "`workbench handeye DIR`",
    "board-images": "`workbench camera DIR` and `workbench handeye DIR`",
    "scan-images": "`workbench scanner DIR` and `workbench calibrate DIR`",
    "fixed-plane": "`workbench handeye DIR` and `workbench scan DIR`",
    "galvanometer": "`workbench handeye DIR` and `workbench scan DIR`",
    "turntable": "`workbench scan DIR`",
    "profiler": "`workbench handeye DIR` and `workbench scan DIR`",
    "3d-camera": "`workbench handeye DIR` and `workbench scan DIR`",
}
_SCANNERS = {
    "fixed-plane": "A laser plane fixed to the camera, both on the flange: every image of a scan names its own sample, "
    "and the images are joined by flange pose. `step` is left out or 0.",
    "galvanometer": "A galvanometer mirror: `step` numbers its positions. mirror_deg is the commanded angle (volts "
    "times the galvanometer's degrees per volt); leave it out if you do not know it.",
    "turntable": "A camera and a laser plane that stand still before a turntable: `table_deg` is the commanded angle "
    "of the table. Images of role board with table_deg show a board that stands on the table.",
    "profiler": "A laser profiler with its own calibration: points (x_mm, 0, z_mm) of one profile have one `pose` "
    "number, and repeat the flange pose of that profile.",
    "3d-camera": "A 3-D camera or structured light: the points of one cloud have one `pose` number, and repeat the "
    "flange pose of that cloud.",
}


def recording_toml(recording: Recording, samples: bool = True, template: str = "") -> str:
    """The text of recording.toml for an example, with comments; template: name of a kind of scanner."""
    kind = recording.measures
    name = template or kind
    command = _NEXT.get(name, "`workbench calibrate DIR`")
    lines = [
        f"# Template of a {name} recording. Its numbers are simulated, and it calibrates as it is: {command}.",
        *(f"# {line}" for line in textwrap.wrap(_SCANNERS.get(name, ""), 110)),
        "# Replace the rows of the tables by your own measurements, then judge them: `workbench check DIR`.",
        "# Lengths are mm, angles degrees. The whole format: docs/recording-format.md.",
        "",
        'format   = "recording/1"',
        f'measures = "{kind}"',
        f'title    = "{recording.title}"          # any text',
    ]
    if recording.sigma_mm is not None:
        lines.append(
            f"sigma_mm = {recording.sigma_mm:g}               # standard deviation of one measured coordinate; remove "
            "it if unknown"
        )
    if recording.robot:
        lines += ["", "[robot]", *_robot_lines()]
    if samples:
        row = _ROWS[kind]
        if kind == "scan-images" and not recording.robot:
            row = _ROWS["board-images"]
        lines += ["", f"# samples.csv: one row = {row}.", *_column_lines(recording)]
        lines += ["[samples]", 'file = "samples.csv"']
    if recording.balls:
        lines += ["", "# artefact.csv: certified ball centres and radii.", "[artefact]"]
        lines += ['file = "artefact.csv"']
    if recording.images:
        lines += [
            "",
            "# images.csv: one row per image: file name, role, and the row of samples.csv (sample).",
        ]
        lines += ["[images]", 'file = "images.csv"', "", *_board_lines(recording.board)]
    return "\n".join(lines) + "\n"


def _robot_lines() -> list[str]:
    return [
        'file = "robot.toml"             # nominal Denavit-Hartenberg table; also an .urdf file',
        '# builtin = "ur10"              # instead of file: a robot that the workbench knows',
    ]


def _column_lines(recording: Recording) -> list[str]:
    """Meaning of the columns of samples.csv, as comments."""
    names = list(recording.columns)
    lines = [f"#   columns here: {', '.join(names)}"]
    if "q1_deg" in names:
        lines.append("#   q1_deg ... are the joint readings as the controller shows them.")
    lines += [
        "#   optional: time_s, payload_kg (carried beyond the empty tool), temperature_c, sigma_mm (of the row),",
        "#   repeat (rows with one number repeat one commanded pose), note (text).",
    ]
    return lines


def _board_lines(board) -> list[str]:
    comments = {
        "kind": "chessboard | charuco | circles",
        "columns": "inner corners (or circles) in a row",
        "rows": "inner corners (or circles) in a column",
        "square_mm": "distance between neighbouring corners or circles, measured on the board",
    }
    lines = ["[board]"]
    for name, value in dict(board).items():
        if isinstance(value, str):
            text = f'"{value}"'
        else:
            text = str(value).lower()
        comment = f"   # {comments[name]}" if name in comments else ""
        lines.append(f"{name} = {text}{comment}")
    return lines
