"""Import: the mapping proposed by `datasets.importers` is completed by tests on the robot, then written as a recording.

Order: `chain` reads the tables (`sources`); `interpretation` decides units, robot and rotation conventions by fits to
the robot (`measured_robot`), `board_images` by fits to a board, `ball_scans` by fits to a ball; `segments` refuses a
table whose reading changes at a row. What the data do not decide becomes a question (`interpretation.questions`).
"""

from workbench.recordings.importing.chain import ImportOptions, ImportResult, import_recording

__all__ = ["ImportOptions", "ImportResult", "import_recording"]
