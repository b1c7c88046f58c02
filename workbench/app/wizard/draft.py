"""One import before it is written: the files, what the user chose, and the options of the importer."""

import re
from dataclasses import dataclass, field
from pathlib import Path

from datasets.importers.mapping.model import mapping_from_keys
from datasets.importers.source import RawTable
from workbench.app.wizard.files import Dropped
from workbench.app.wizard.form import CALLED, with_cell
from workbench.app.wizard.trial import Trial, read_proposal, try_import
from workbench.core.errors import InputError
from workbench.recordings.importing import ImportOptions
from workbench.recordings.importing.board_images.notation import board_keys
from workbench.recordings.importing.interpretation.questions import Question

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9 _.-]{0,79}")


@dataclass
class Draft:
    """State of the wizard; `table` None where there is none, `trial` None while a mapping is not tested.

    `robot` and `artefact`: a built-in name or a dropped file, FILE#LINK for one of several arms, "" for none.
    `board`, `sigma`, `ball_radius`: text fields. The mapping holds what the headers state and what the user changed.
    """

    dropped: Dropped = field(default_factory=Dropped)
    keys: dict = field(default_factory=dict)
    table: RawTable | None = None
    images: list[str] = field(default_factory=list)
    robot: str = ""
    artefact: str = ""
    board: str = ""
    sigma: str = ""
    ball_radius: str = ""
    trust_data: bool = False
    answers: list[tuple[Question, int]] = field(default_factory=list)
    trial: Trial | None = None
    changes: int = 0

    def add(self, files) -> None:
        """Take files up and propose a mapping of all files. Raises InputError."""
        self.dropped.add(files)
        if not self.robot and len(self.dropped.robots) == 1:
            self.robot = self.dropped.robots[0]
        self.propose()

    def clear(self) -> None:
        """Forget files and mapping."""
        self.dropped.clear()
        self.keys, self.table, self.images = {}, None, []
        self.robot, self.artefact = "", ""
        self._forget()

    def propose(self) -> None:
        """Read the files again and propose the mapping that their headers suggest. Raises InputError."""
        self.keys, self.table, self.images = {}, None, []
        self._forget()
        if self.sources:
            mapping, self.table, self.images = read_proposal(self.sources, self.options())
            self.keys = mapping.as_keys()

    def edit(self, name: str, key: str, value: object) -> None:
        """Change one cell of the form. Raises InputError."""
        self.keys = with_cell(self.keys, name, key, value)
        self._forget()

    def choose(self, key: str, value) -> None:
        """Set robot, artefact, board, sigma, ball_radius or trust_data."""
        is_reread = key == "artefact" and value != self.artefact
        setattr(self, key, value)
        self._forget()
        if is_reread:
            self.propose()

    def answer(self, choice: int) -> None:
        """Answer the open question of the trial. Raises InputError."""
        question = None if self.trial is None else self.trial.question
        if question is None or not 0 <= choice < len(question.options):
            raise InputError("There is no such answer; choose one of the list")
        answers = [*self.answers, (question, choice)]
        self._forget()
        self.answers = answers

    def _forget(self) -> None:
        self.trial, self.answers = None, []
        self.changes += 1

    @property
    def sources(self) -> list[Path]:
        """Files to import, without those of robot and artefact."""
        return self.dropped.sources([self.artefact] if self.artefact else [])

    def options(self) -> ImportOptions:
        """Options of the importer. Raises InputError for an incomplete mapping, and for what is no number or board."""
        folder = self.dropped.folder
        is_file = self.robot in self.dropped.robots
        robot = str(folder / self.robot) if is_file else self.robot or None
        return ImportOptions(
            robot=robot,
            mapping=mapping_from_keys(self.keys, CALLED),
            board=board_keys(self.board) if self.board.strip() else None,
            artefact=folder / self.artefact if self.artefact else None,
            ball_radius_mm=positive(self.ball_radius, "Ball radius (mm)"),
            sigma_mm=positive(self.sigma, "Standard deviation (mm)"),
            trust_data=self.trust_data,
        )

    def test(self) -> Trial:
        """Test the mapping on the robot: the complete import into a temporary folder."""
        try:
            options = self.options()
        except InputError as problem:
            return Trial(problem=str(problem))
        return try_import(self.sources, options, self.answers)


def positive(text: str, name: str) -> float | None:
    """A number above 0, None for no text. Raises InputError."""
    if not str(text or "").strip():
        return None
    try:
        number = float(str(text).replace(",", "."))
    except ValueError:
        number = 0.0
    if not 0 < number < 1e6:
        raise InputError(f"{name}: expected a number above 0, found {text!r}; correct it")
    return number


def folder_of(name: object, parent: Path) -> Path:
    """The new folder `name` below `parent`. Raises InputError for what is no plain name of a folder."""
    text = str(name or "").strip()
    if not _NAME.fullmatch(text) or text.endswith("."):
        raise InputError(
            f"Name of the recording: expected letters, digits, '-', '_', '.' or spaces, found {text[:60]!r}; "
            "correct it"
        )
    return parent / text
