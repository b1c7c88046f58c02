"""Build the source distribution and the wheel, and use the wheel outside the checkout.

`python tools/check_package.py` checks that

- the source distribution holds every tracked file,
- the wheel, built from the source distribution, installs into a new virtual environment,
- `workbench --version`, `check` and `demo` of the installed package run in an empty folder, from which the checkout
  cannot be imported.

The new environment takes the dependencies from the environment that runs this script, by a path file: they are not
downloaded again. Only the project itself comes from the wheel.
"""

import os
import subprocess
import sys
import tarfile
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
BUILD = "import sys; from setuptools import build_meta; print(build_meta.{}(sys.argv[1]))"


def main() -> int:
    """Exit status 0 where all of it holds; the first failure is printed."""
    with tempfile.TemporaryDirectory(prefix="workbench-package-") as home:
        place = Path(home)
        source = unpacked_source(place)
        missing = sorted(tracked_files() - {str(p.relative_to(source)) for p in files_in(source)})
        if missing:
            print(f"the source distribution lacks {len(missing)} tracked files: {missing[:5]}")
            return 1
        wheel = built("build_wheel", source, place)
        print(f"{wheel.name}: {wheel.stat().st_size / 1e6:.1f} MB")
        return use(installed(wheel, place), place)


def tracked_files() -> set[str]:
    """Paths of all tracked files; those of the folder where this is no checkout of git."""
    listed = subprocess.run(
        ["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=True
    )
    return {name for name in listed.stdout.split("\0") if name and (ROOT / name).is_file()}


def files_in(folder: Path) -> list[Path]:
    """All files below a folder."""
    return [path for path in folder.rglob("*") if path.is_file()]


def unpacked_source(place: Path) -> Path:
    """The folder of the unpacked source distribution, built from a copy of the tracked files."""
    copy = place / "checkout"
    for name in tracked_files():
        target = copy / name
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes((ROOT / name).read_bytes())
    archive = built("build_sdist", copy, place)
    with tarfile.open(archive) as file:
        file.extractall(place / "source", filter="data")
    return next((place / "source").iterdir())


def built(kind: str, source: Path, place: Path) -> Path:
    """The distribution that setuptools builds of a source folder."""
    words = [sys.executable, "-c", BUILD.format(kind), str(place)]
    done = subprocess.run(words, cwd=source, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"{kind} failed: {done.stderr[-2000:]}")
    return place / done.stdout.strip().splitlines()[-1]


def installed(wheel: Path, place: Path) -> Path:
    """The folder of programs of a new environment with the wheel and the dependencies of this one."""
    environment = place / "environment"
    subprocess.run([sys.executable, "-m", "venv", str(environment)], check=True)
    programs = environment / ("Scripts" if os.name == "nt" else "bin")
    ask = "import sysconfig; print(sysconfig.get_path('purelib'))"
    packages = [
        subprocess.run(
            [python, "-c", ask], capture_output=True, text=True, check=True
        ).stdout.strip()
        for python in (str(programs / "python"), sys.executable)
    ]
    install = ["-m", "pip", "install", "--quiet", "--no-deps", "--no-index", str(wheel)]
    subprocess.run([str(programs / "python"), *install], check=True)
    # Plain folders in a path file come after the environment's own packages; its path files are not read.
    (Path(packages[0]) / "dependencies.pth").write_text(packages[1] + "\n", encoding="utf-8")
    return programs


def use(programs: Path, place: Path) -> int:
    """Run commands of the installed package in an empty folder; 0 where they end as they should."""
    empty = place / "empty"
    empty.mkdir()
    hidden = ("PYTHONPATH", "WORKBENCH_RECORDINGS")
    environment = {name: value for name, value in os.environ.items() if name not in hidden}
    where = "import workbench, datasets, sensors, robot_model; print(workbench.__file__, datasets.__file__)"
    calls = (
        [str(programs / "python"), "-c", where],
        [str(programs / "workbench"), "--version"],
        [str(programs / "workbench"), "check", "elastic-arm"],
        [str(programs / "workbench"), "demo", "--bundled", "--no-pictures", "--out", "demo"],
    )
    for words in calls:
        done = subprocess.run(
            words, cwd=empty, env=environment, capture_output=True, text=True, check=False
        )
        if done.returncode or str(ROOT) in done.stdout:
            print(f"{' '.join(words[1:])}: status {done.returncode}\n{done.stdout}{done.stderr}")
            return 1
        print(f"{Path(words[0]).name} {' '.join(words[1:])[:60]}: works")
    return 0 if (empty / "demo" / "answer.json").is_file() else 1


if __name__ == "__main__":
    sys.exit(main())
