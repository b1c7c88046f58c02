"""The scanner's entries of the catalogue page: a rendered recording, its images taken once more with each effect."""

import sys
import tempfile
import tomllib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

import datasets
from catalogue_entries import Entry, confounded, large_enough, listed, sizes
from sensors.effects import CATALOGUE
from sensors.rendering import Scene, make_recording
from workbench.diagnosis.scanner.sensor import SensorBench, bench_of
from workbench.explanation.sentences.words import measured
from workbench.jobs.sensor.chains import Chains

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from sensor_recordings import SCENE  # noqa: E402
from simulated_images import simulated, solved  # noqa: E402

# what differs from the small scene of the tests: more steps, boards and scans, pixels in parts as usual
_MORE = {
    "mirror": {"steps": 16},
    "placements": {"count": 12, "laser": 6},
    "scans": {"count": 3, "range_mm": (122.0, 134.0), "aside": 0.1},
}
_PLACES = {
    "camera": "camera",
    "laser": "laser",
    "mirror": "mirror",
    "sensor": "sensor",
    "artefact": "artefact",
    "time": "time",
    "ball": "ball-1",
}
_OPTIONS = {"mirror-encoder-harmonic": {"order": 60}}
NOT_SEEN = {
    "lateral-scale": "it acts on profiles and clouds that were made with another program, as field-bias does",
    "field-bias": "it acts on clouds that were made with another program; here camera and light are fitted",
    "ball-position": "one ball of a scan has its place fitted; see the robot's",
    "noise-heteroscedastic": "see the robot's",
    "rolling-shutter": "it needs the column mirror_speed_deg_s, which these images do not have",
    "recorded-column": "it needs a recorded column, such as exposure_ms, which these images do not have",
    "blooming": "it reads brightness and width of the line, which these measurements do not have",
    "ghost-line": "light planes absorb it; the profile of the laser line shows it",
}
_SEED = 5


def entries() -> Iterator[Entry]:
    """One a scanner's effect that a calibration of camera, mirror and poses can miss."""
    bench = _perfect()
    for name, kind in CATALOGUE.items():
        if name not in NOT_SEEN:
            yield _entry(bench, name, kind)


def _perfect() -> SensorBench:
    """The bench of rendered images, its measurements replaced by those of its own solution and noise."""
    keys = {name: value for name, value in tomllib.loads(SCENE).items() if name != "parts"}
    scene = Scene(**keys | {name: keys[name] | more for name, more in _MORE.items()})
    with tempfile.TemporaryDirectory() as folder:
        make_recording(scene, Path(folder))
        bench = bench_of(datasets.read(Path(folder)))
    return SensorBench(_with_causes(solved(bench)))


def _with_causes(chains: Chains) -> Chains:
    """The chains with columns that the rendered recording does not have: direction of sweep, speed, temperature."""
    rng, made = np.random.default_rng(_SEED), {}
    first = 0
    for name, chain in chains.parts.items():
        label = chain.labels["ball" if name == "balls" else "placement"]
        count = int(label.max()) + 1
        sweep, speed = rng.choice([-1.0, 1.0], count)[label], rng.uniform(20.0, 60.0, count)[label]
        more = {
            "temperature_c": 20 + (label + first) * 0.8,
            "time_s": 30.0 * (label + first),
            "sweep": sweep,
            "mirror_speed_deg_s": sweep * speed,
        }
        made[name] = replace(chain, covariates={**chain.covariates, **more})
    return replace(chains, **made)


def _entry(perfect: SensorBench, name, kind) -> Entry:
    where = _PLACES[kind.places[0]]
    effect = kind(where, **_OPTIONS.get(name, {}))
    start = perfect.problem((effect,))
    rows = perfect.parameters((effect,))
    values = large_enough(start, np.array([row["typical"] for row in rows]))
    true = dict(zip((row["key"] for row in rows), values.tolist()))
    bench = SensorBench(simulated(perfect.chains, (effect,), true, _SEED))
    whole, left, orthogonal_share = sizes(start, values)
    near = confounded(start, values, f"{kind.effect} {where}")
    numbers = tuple(
        f"{row['label']} {measured(true[row['key']], None, row['unit'])}" for row in rows
    )
    points = np.stack([bench.covariates["u"], bench.covariates["v"]])
    return Entry(
        name,
        kind,
        where,
        numbers,
        whole,
        left,
        orthogonal_share,
        "px",
        listed(near),
        _separates(effect, near),
        bench.problem(),
        points,
    )


def _separates(effect, near) -> str:
    """What would change for one of the two and not for the other."""
    if not near or near[0][1] < 0.5:
        return "Nothing is needed: no other effect explains half of its residual."
    other = near[0][0].effects[0]
    needs = [
        name
        for name in (*effect.needs, *other.needs)
        if name not in set(effect.needs) & set(other.needs)
    ]
    if needs:
        return f"Recordings in which {' and '.join(needs)} changes and nothing else does."
    if effect.where == other.where:
        return "More board poses, nearer and farther and more oblique: both sit at one place."
    kinds = {
        "artefact": "another board",
        "ball": "another ball",
        "mirror": "a second range of the mirror's angles",
        "laser": "nearer and farther board poses",
        "camera": "a board of another material, its temperature recorded",
        "sensor": "balls of another size and material",
        "time": "another speed of the mirror",
    }
    return f"The same with {kinds[other.where.partition('-')[0]]}."
