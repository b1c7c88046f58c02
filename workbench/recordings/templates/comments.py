"""recording.toml of a template: every key with a comment that says what to put there."""

from datasets.recording import Recording

_ROWS = {
    "ball-centre": "the centre of ball `ball` (of artefact.csv) in the frame of the sensor on the flange",
    "external-point": "one reflector on the flange in the frame of the tracker; the column reflector says which",
    "external-pose": "origin and unit quaternion of the target on the flange in the frame of the tracker",
    "partial-pose": "origin and x axis (unit vector nx ny nz) of the target on the flange, tracker frame",
    "touch-point": "the tip touches the fixed point `point`; nothing is measured but the joints",
    "laser-spot": "the beam of the laser on the flange passes through point `point` of sphere `sphere`",
    "distance": "one end of a measured length: two rows of one `pair` with the same length_mm",
    "plane-touch": "the tip touches the fixed plane `plane`; nothing is measured but the joints",
    "ball-surface": "a point on the surface of ball `ball` in the frame of the sensor; rows of one `pose` together",
    "board-images": "the flange pose of the image with the same number in images.csv",
    "scan-images": "the joint readings of the scan with the same number in images.csv",
}
_NEXT = {
    "board-images": "`workbench camera DIR` and `workbench handeye DIR`",
    "scan-images": "`workbench scanner DIR` and `workbench calibrate DIR`",
}


def recording_toml(recording: Recording, samples: bool = True) -> str:
    """The text of recording.toml for an example, with comments."""
    kind = recording.measures
    command = _NEXT.get(kind, "`workbench calibrate DIR`")
    lines = [
        f"# Template of a {kind} recording. Its numbers are simulated, and it calibrates as it is: {command}.",
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
        lines += ["", f"# samples.csv: one row = {_ROWS[kind]}.", *_column_lines(recording)]
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
    """What the columns of samples.csv mean, as comments."""
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
        text = f'"{value}"' if isinstance(value, str) else str(value).lower()
        comment = f"   # {comments[name]}" if name in comments else ""
        lines.append(f"{name} = {text}{comment}")
    return lines
