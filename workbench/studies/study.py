"""A study from its file to its folder: validation, execution, table and summary."""

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from workbench.core.errors import InputError, Stopped
from workbench.machine import processes
from workbench.machine.progress import paced
from workbench.studies import executors, folder, robots, tables
from workbench.studies.engine import Done, carry_out, given, parts_of
from workbench.studies.spec import Study, home_of, read_study
from workbench.studies.variation import count, ends, values_of, with_values

Progress = Callable[[str], None]


@dataclass(frozen=True)
class Finished:
    """A finished study with its table in `path`; `done` is None if an earlier call finished it."""

    name: str
    study: Study
    path: Path
    done: Done | None


def read(path: Path) -> tuple[Study, str]:
    """The study of a file, validated at both ends of every varied parameter, and a checksum of its data.

    Raises InputError.
    """
    study = read_study(path)
    study = robots.check_models(study, home_of(path))
    count(study)
    _check_kind(study)
    first = values_of(study, 1)
    for axis in study.vary.parameter:
        for value in ends(axis):
            _check_scene(
                with_values(study, first | {axis.name: value}), f"parameter {axis.name} = {value}"
            )
    _check_scene(with_values(study, first), "its first run")
    return study, _data_of(study)


def _check_kind(study: Study) -> None:
    if study.kind == "sensor" and (study.recording or set(study.do) - {"simulate", "calibrate"}):
        raise InputError(
            "study, key do: a sensor study needs a scene and the steps simulate, or simulate and "
            f"calibrate; found {study.do}; correct it"
        )
    if study.recording is not None and {"compensate", "simulate"} & set(study.do):
        raise InputError(
            "study, key do: expected calibrate or diagnose for a recording, found "
            f"{study.do}; remove the others"
        )


def _check_scene(study: Study, called: str) -> None:
    """Raise InputError if the scene with these values is invalid."""
    try:
        if study.kind == "sensor":
            from workbench.studies.sensors import scene_of

            scene_of(study, 0)
        elif study.scene is not None:
            from workbench.files.scene import Scene
            from workbench.studies.spec import validated

            validated(Scene, study.scene, "scene")
            small = study.model_copy(update={"scene": study.scene | {"samples": 8}, "design": None})
            robots.world(
                small.model_copy(update={"test": study.test.model_copy(update={"samples": 4})}), 0
            )
    except InputError as problem:
        raise InputError(f"study, {called}: {problem}") from None


def _data_of(study: Study) -> str:
    """Checksum of the recording, or text of the scene's robot file; "" without one."""
    if study.recording is not None:
        from workbench.studies.resampling import original

        return original(study.recording).sha256
    robot = Path(str((study.scene or {}).get("robot", "")))
    return robot.read_text(encoding="utf-8") if robot.is_absolute() and robot.is_file() else ""


def carried_out(
    path: Path,
    out: Path | None,
    workers: int | None,
    scheduler: str | None,
    progress: Progress,
    close: Callable[[Finished, Path, Progress], None] = lambda *_: None,
) -> Finished:
    """Run the study of a file, or continue an interrupted one.

    out: the folder instead of `runs/study-<name>-<digest>`; workers: processes of this machine, None: all cores;
    scheduler: a Dask cluster instead. close: called with the study and its folder after the table is written, for
    further files. Raises InputError, and Stopped if the user interrupts it.
    """
    study, data = read(path)
    name = Path(path).stem
    place = folder.place_of(name, study, data, out)
    if place.holds(study, data):
        return Finished(name, study, place.path, None)
    with folder.opened(place, study, data) as partial_folder:
        done = _made(study, partial_folder, workers, scheduler, paced(progress, "run"))
        progress("writing the table")
        tables.put_together(partial_folder, len(parts_of(study)))
        close(Finished(name, study, partial_folder, done), place.path, progress)
    return Finished(name, study, place.path, done)


def _made(study: Study, where: Path, workers: int | None, scheduler: str | None, tick) -> Done:
    with _pool(workers, scheduler) as (executor, count_of):
        try:
            return carry_out(study, where, executor, count_of, tick)
        except KeyboardInterrupt:
            finished_runs = sum(len(parts_of(study)[k]) for k in tables.parts_done(where))
            raise Stopped(
                f"Stopped: {finished_runs:,} of {count(study):,} runs are saved in {where}. The same "
                "command continues with "
                "the remaining runs."
            ) from None


def _pool(workers: int | None, scheduler: str | None) -> AbstractContextManager:
    if scheduler is None:
        wanted = workers or processes.cores()
        return nullcontext((partial(executors.local, wanted), wanted))
    return _cluster(scheduler)


class _cluster:
    """Context manager of a Dask cluster, as an executor factory for `carry_out`."""

    def __init__(self, address: str):
        self.opened = executors.dask(address)

    def __enter__(self):
        pool, threads = self.opened.__enter__()
        return partial(given, pool), threads

    def __exit__(self, *failure):
        return self.opened.__exit__(*failure)
