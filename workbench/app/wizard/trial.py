"""The trial of a mapping: the complete import into a folder of its own, so that the preview is what is imported."""

import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory

from datasets.importers.mapping.model import Mapping
from workbench.core.errors import InputError
from workbench.recordings.importing import ImportOptions, ImportResult, import_recording
from workbench.recordings.importing.interpretation.questions import Question

_PREVIEWED = 5
_MADE = "recording"


class _Unanswered(Exception):
    """A question that the data do not decide and that was not answered yet."""

    def __init__(self, question: Question):
        super().__init__(question.sentence)
        self.question = question


@dataclass
class Trial:
    """Result of a trial import: exactly one of `result`, `question` and `problem` is set.

    The recording lies in `scratch` until `keep` moves it.
    """

    result: ImportResult | None = None
    question: Question | None = None
    problem: str = ""
    scratch: TemporaryDirectory | None = field(default=None, repr=False)

    @property
    def fits(self) -> list[dict]:
        """Interpretations that were tested on the robot, the chosen one first: name, rms_mm, rms_deg as text."""
        rows = [] if self.result is None else [fit.as_json() for fit in self.result.fits]
        return [{key: _shown(value, 3) for key, value in row.items()} for row in rows]

    @property
    def samples(self) -> list[list[str]]:
        """Columns of the recording: name and the first values, in the units of the recording."""
        if self.result is None:
            return []
        columns = self.result.recording.columns
        return [[name, *map(_shown, cells[:_PREVIEWED])] for name, cells in columns.items()]

    def keep(self, folder: Path) -> None:
        """Move the recording to a new folder. Raises InputError where it exists or cannot be written."""
        if self.result is None or self.scratch is None:
            raise InputError("The import is not complete; answer what is open first")
        if folder.exists():
            raise InputError(f"{folder}: expected a new folder, found one; choose another name")
        try:
            shutil.copytree(Path(self.scratch.name) / _MADE, folder)
        except OSError as problem:
            shutil.rmtree(folder, ignore_errors=True)
            raise InputError(
                f"{folder}: expected a folder that can be written, found '{problem.strerror}'; start workbench open "
                "in another folder"
            ) from None


def _shown(value, digits: int = 6) -> str:
    if value is None:
        return "–"
    return value if isinstance(value, str) else f"{float(value):.{digits}g}"


def try_import(
    paths: Sequence[Path],
    options: ImportOptions,
    answers: Sequence[tuple[Question, int]] = (),
    progress: Callable[[str], None] = lambda text: None,
) -> Trial:
    """Import into a temporary folder; a question that `answers` do not hold ends the trial with it."""

    def ask(question: Question) -> int:
        for answered, choice in answers:
            if answered == question:
                return choice
        raise _Unanswered(question)

    scratch = TemporaryDirectory(prefix="workbench-trial-")
    chosen = _with_asker(options, ask)
    try:
        imported = import_recording(paths, Path(scratch.name) / _MADE, chosen, progress)
    except _Unanswered as open_one:
        return Trial(question=open_one.question)
    except InputError as problem:
        return Trial(problem=str(problem))
    return Trial(result=imported, scratch=scratch)


def _with_asker(options: ImportOptions, ask) -> ImportOptions:
    from dataclasses import replace

    return replace(options, ask=ask)


def read_proposal(paths: Sequence[Path], options: ImportOptions):
    """Mapping that headers and formats suggest, the joined table (None without one) and names of the images.

    Raises InputError for a file that cannot be read.
    """
    from workbench.recordings.importing.chain import find_mapping

    with TemporaryDirectory(prefix="workbench-trial-") as scratch:
        found = find_mapping(paths, options, Path(scratch))
    images = [image.name for image in found.source.images]
    return found.mapping or Mapping(), found.table, images
