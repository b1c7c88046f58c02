"""What a calibration says of its own trustworthiness stays with its file, and with every result that rests on it."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from scanner_kinds import SCANNER, stripes_on_ball
from sensor_recordings import handeye_recording, scanner_recording
from sensors.ball.fit import fit_ball
from sensors.scanner.cloud import Cloud
from sensors.scanner.file import read_scanner, write_scanner
from sensors.scanner.residuals.misfit import Misfit
from sensors.trust import Trust, trust_from_keys
from workbench.commands import cli
from workbench.core.errors import InputError
from workbench.fitting.verdicts import sensor_verdict

RADIUS, SHIFT, NOISE = 15.0, 0.4, 0.05
REFUSED = "DO NOT USE THIS RESULT, it is not trustworthy: the line lies 3 px from its light plane"


def sweeping(trust):
    """A scanner with a light plane every 4 mm, parallel to that of `SCANNER`."""
    planes = np.repeat(SCANNER.planes, 5, axis=1)
    planes[3] += 4.0 * np.arange(-2, 3)
    return replace(SCANNER, steps=np.arange(5), planes=planes, sigma_px=NOISE, trust=trust)


def squared_error(scanner, rng):
    """(3,) squared errors over variances of the centre of a ball, whose stripes are each shifted as a whole."""
    centre = np.array([0.0, 0.0, 125.0]) + rng.uniform(-2, 2, 3)
    pixels, step = stripes_on_ball(scanner.planes.T, [centre] * 5, RADIUS)
    moved = rng.normal(0, SHIFT, 5)[step] + NOISE * rng.normal(size=len(step))
    pixels = pixels + np.stack([moved, 0 * moved])
    cloud = Cloud(scanner, scanner.reconstruct(pixels, step), pixels, step, step)
    length = np.linalg.norm(cloud.error, axis=0)
    own = {"sigma": NOISE * length, "direction": cloud.error / length, **cloud.shared_errors()}
    fit = fit_ball(cloud.points, radius=RADIUS, view=cloud.view, **own)
    return (fit.centre - centre) ** 2 / np.diag(fit.covariance)[:3]


def test_what_the_calibration_found_of_whole_stripes_is_in_the_uncertainty_of_a_ball():
    """Few stripes do not show that each is shifted: without the verdict of the calibration, sigma is too small."""
    squares = {}
    for name, trust in (("stated", Trust(False, (REFUSED,), (SHIFT, 0.0))), ("not stated", None)):
        rng = np.random.default_rng(5)
        squares[name] = np.mean([squared_error(sweeping(trust), rng) for _ in range(60)])
    assert squares["stated"] == pytest.approx(1.0, abs=0.35)
    assert squares["not stated"] > 1.2 * squares["stated"]


def test_the_file_holds_the_verdict_and_older_files_hold_none(tmp_path):
    trust = Trust(False, (REFUSED,), (0.4, 0.01))
    write_scanner(replace(sweeping(trust), camera_trust=Trust()), tmp_path / "scanner.toml")
    read = read_scanner(tmp_path / "scanner.toml")
    assert read.trust == trust
    assert read.camera_trust == Trust()
    write_scanner(sweeping(None), tmp_path / "older.toml")
    assert read_scanner(tmp_path / "older.toml").trust is None
    assert not read_scanner(tmp_path / "older.toml").stripe_variance.any()


@pytest.mark.parametrize(
    "table",
    [
        {"usable": "no"},
        {"usable": True, "warnings": "one"},
        {"usable": True, "stripe_shift_px": -1.0},
        {"usable": True, "stripe_tilt_px": "wide"},
        [],
    ],
)
def test_a_verdict_that_is_none_is_refused(table):
    with pytest.raises(InputError, match="calibrate again"):
        trust_from_keys({"verdict": table}, "scanner.toml")


def test_lack_of_fit_that_matters_is_handed_on_and_small_one_is_not(monkeypatch):
    for part in ("scanner_verdict", "scanner_warnings"):
        monkeypatch.setattr(sensor_verdict, part, lambda *rest: SimpleNamespace(passed=None))
    monkeypatch.setattr(sensor_verdict, "scanner_warnings", lambda *rest: [])
    large = Misfit(0.03, 0.4, 0.03, 0.04, 0.0, 30)
    small = replace(large, shift_px=0.002, tilt_px=0.001, bend_px=0.001)
    assert sensor_verdict.scanner_trust(None, large).stripe_px == pytest.approx(
        (0.4, 0.0866), abs=1e-4
    )
    assert sensor_verdict.scanner_trust(None, small).stripe_px == (0.0, 0.0)


@pytest.fixture(scope="module")
def scanner_file(tmp_path_factory):
    """The scanner of the rendered recording."""
    path = tmp_path_factory.mktemp("trust") / "scanner.toml"
    words = ["scanner", scanner_recording()[0], "--out", path, "--no-report"]
    assert cli.run([str(word) for word in words]) == 0
    return path


def answer(folder, *words):
    """Exit status and answer of a command that writes to `folder`."""
    words = [*words, "--out", folder / "run", "--json", folder / "answer.json", "--no-report"]
    status = cli.run([str(word) for word in words])
    return status, json.loads((folder / "answer.json").read_text())


@pytest.mark.parametrize("command", ["scan", "handeye"])
def test_a_result_that_rests_on_a_refused_calibration_is_refused(command, scanner_file, tmp_path):
    recording = scanner_recording()[0] if command == "scan" else handeye_recording()[0]
    refused = Trust(False, (REFUSED,), (0.4, 0.0))
    good = read_scanner(scanner_file)
    assert good.trust.usable
    write_scanner(replace(good, trust=refused, camera_trust=refused), tmp_path / "scanner.toml")
    status, found = answer(tmp_path, command, recording, "--scanner", tmp_path / "scanner.toml")
    assert status == 1
    assert found["verdict"]["pass"] is False
    said = [one for one in found["warnings"] if "is refused: the line lies 3 px" in one]
    assert len(said) == 1
