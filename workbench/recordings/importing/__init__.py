"""Import: the mapping proposed by `datasets.importers` is completed by tests on the robot, then written as a recording.

Order: `chain` reads sources and proposal; `decisions` lets `fits` compare units and rotation conventions on the robot
(`board_poses` on images of a board); what the data do not decide becomes a question (`questions`).
"""

from workbench.recordings.importing.chain import ImportOptions, ImportResult, import_recording

__all__ = ["ImportOptions", "ImportResult", "import_recording"]
