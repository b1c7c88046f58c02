"""The file scanner.toml: all that a calibrated scanner is, read back to the bit; a sentence for what is wrong."""

import base64
import binascii
import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tomli_w
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from sensors.camera.model import (
    camera_from_keys,
    camera_keys,
    covariance_from_keys,
    covariance_keys,
)
from sensors.effects import CATALOGUE
from sensors.light.mirror import Mirror
from sensors.scanner.model import Scanner
from sensors.scanner.turntable import Turntable
from sensors.stripe.surface_bias.surface_line import UNKNOWN_SCATTER, LineShape
from sensors.trust import trust_from_keys
from workbench.core.effect import make_effects
from workbench.core.errors import InputError
from workbench.core.text.structured_text import ContentError, read_toml

FORMAT = "scanner/1"
# by how much a unit vector, or a mirror's planes from those in the file, may differ: rounding
_UNIT, _SAME = 1e-9, 1e-6
Finite = Annotated[float, Field(allow_inf_nan=False)]
Vector = Annotated[list[Finite], Field(min_length=3, max_length=3)]
Plane = Annotated[list[Finite], Field(min_length=4, max_length=4)]
Pair = Annotated[list[Finite], Field(min_length=2, max_length=2)]


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True)


class _Mirror(_Section):
    axis: Vector
    point_mm: Vector
    face: Vector
    offset_mm: Finite
    beam: Plane
    angles_rad: list[Finite]


class _Effect(_Section):
    effect: str
    where: str
    options: dict[str, Any] = {}
    parameters: dict[str, Finite] = {}


class _Light(_Section):
    steps: Annotated[list[int], Field(min_length=1)]
    planes: list[Plane]
    scan: Pair
    sigma_px: Annotated[Finite, Field(gt=0)]
    shared_px: dict[str, Annotated[Finite, Field(ge=0)]] | None = None
    volume_mm: Pair | None = None
    line_mm_px: Pair | None = None
    line_scatter: Annotated[Finite, Field(gt=0)] | None = None
    sigma_tilt_rad: list[Pair] | None = None
    sigma_offset_mm: list[Finite] | None = None
    covariance: str | None = None
    rays_covariance: str | None = None
    frame_covariance: (
        Annotated[
            list[Annotated[list[Finite], Field(min_length=6, max_length=6)]],
            Field(min_length=6, max_length=6),
        ]
        | None
    ) = None


class _Harmonic(_Section):
    order: Annotated[int, Field(ge=1)]
    cosine_rad: Finite
    sine_rad: Finite


class _Turntable(_Section):
    axis: Vector
    point_mm: Vector
    gain: Finite
    sigma_rad: Annotated[Finite, Field(ge=0)]
    harmonics: list[_Harmonic] = []
    covariance: list[list[Finite]]


class _File(_Section):
    format: str
    camera: dict[str, Any]
    light: _Light
    mirror: _Mirror | None = None
    turntable: _Turntable | None = None
    effect: list[_Effect] = []
    provenance: dict[str, Any] = {}
    verdict: dict[str, Any] | None = None


def write_scanner(scanner: Scanner, path: Path) -> None:
    """Write scanner.toml at once or not at all. Raises InputError where the folder cannot be written to."""
    path = Path(path)
    partial = path.with_name(f".partial-{os.getpid()}-{path.name}")
    try:
        partial.write_text(scanner_text(scanner), encoding="utf-8")
        partial.replace(path)
    except OSError as problem:
        partial.unlink(missing_ok=True)
        raise InputError(
            f"{path}: expected a place to write the scanner to, found {problem.strerror}; "
            "choose another folder"
        ) from None


def scanner_text(scanner: Scanner) -> str:
    """The text of scanner.toml."""
    keys: dict[str, Any] = {
        "format": FORMAT,
        "camera": camera_keys(scanner.camera) | covariance_keys(scanner.camera_covariance),
        "light": _light_keys(scanner),
    }
    if scanner.mirror is not None:
        mirror = scanner.mirror
        keys["mirror"] = {
            "axis": _list(mirror.axis),
            "point_mm": _list(mirror.point),
            "face": _list(mirror.face),
            "offset_mm": float(mirror.offset),
            "beam": _list(mirror.beam),
            "angles_rad": _list(scanner.angles),
        }
    if scanner.turntable is not None:
        keys["turntable"] = _turntable_keys(scanner.turntable)
    if scanner.effects:
        keys["effect"] = [
            _effect_keys(scanner, effect, values) for effect, values in scanner.effects
        ]
    if scanner.trust is not None:
        keys["verdict"] = scanner.trust.as_keys()
    if scanner.camera_trust is not None:
        keys["camera"]["verdict"] = scanner.camera_trust.as_keys()
    if scanner.provenance:
        keys["provenance"] = {
            name: value for name, value in scanner.provenance.items() if value is not None
        }
    return tomli_w.dumps(keys)


def _turntable_keys(table: Turntable) -> dict:
    rows = [
        {"order": int(order), "cosine_rad": float(pair[0]), "sine_rad": float(pair[1])}
        for order, pair in table.harmonics.items()
    ]
    return {
        "axis": _list(table.axis),
        "point_mm": _list(table.point),
        "gain": float(table.gain),
        "sigma_rad": float(table.sigma),
        "harmonics": rows,
        "covariance": _list(table.covariance),
    }


def _turntable(file, where) -> Turntable | None:
    if file.turntable is None:
        return None
    keys = file.turntable
    harmonics = {
        harmonic.order: (harmonic.cosine_rad, harmonic.sine_rad) for harmonic in keys.harmonics
    }
    size = 5 + 2 * len(harmonics)
    covariance = np.array([row for row in keys.covariance if len(row) == size])
    axis = np.array(keys.axis)
    if covariance.shape != (size, size) or abs(np.linalg.norm(axis) - 1) > _UNIT:
        raise _wrong(
            f"{where}, [turntable]",
            f"a unit axis and a covariance of {size} x {size} numbers",
            "others",
            "calibrate again",
        )
    return Turntable(
        axis, np.array(keys.point_mm), keys.gain, harmonics, keys.sigma_rad, covariance
    )


def _list(values):
    return np.asarray(values, float).tolist()


def _light_keys(scanner):
    keys = {
        "steps": [int(step) for step in scanner.steps],
        "planes": _list(scanner.planes.T),
        "scan": _list(scanner.scan),
        "sigma_px": float(scanner.sigma_px),
    }
    if scanner.shared_px:
        keys["shared_px"] = {name: float(sigma) for name, sigma in scanner.shared_px.items()}
    if scanner.volume is not None:
        keys["volume_mm"] = _list(scanner.volume)
    if scanner.line is not None:
        keys["line_mm_px"] = [scanner.line.plane_width_mm, scanner.line.blur_px]
        if scanner.line.is_scatter_known:
            keys["line_scatter"] = float(scanner.line.scatter)
    if scanner.covariance is not None:
        std = np.sqrt(np.maximum(np.diag(scanner.covariance), 0)).reshape(-1, 3)
        keys |= {"sigma_tilt_rad": _list(std[:, :2]), "sigma_offset_mm": _list(std[:, 2])}
        keys["covariance"] = _encoded(scanner.covariance)
    if scanner.rays is not None and np.isfinite(scanner.rays).all():
        keys["rays_covariance"] = _encoded(scanner.rays)
    if scanner.frame is not None:
        keys["frame_covariance"] = _list(scanner.frame)  # shift mm, rotation rad
    return keys


def _encoded(values: np.ndarray) -> str:
    return base64.b64encode(np.asarray(values, "<f8").tobytes()).decode("ascii")


def _effect_keys(scanner, effect, values):
    names = [p.key.rpartition(".")[2] for p in effect.table(scanner)]
    options = {name: _plain(value) for name, value in effect.options.items() if value is not None}
    keys = {
        "effect": effect.effect,
        "where": effect.where,
        "parameters": dict(zip(names, _list(values))),
    }
    return keys | ({"options": options} if options else {})


def _plain(value):
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else value


def read_scanner(path: Path) -> Scanner:
    """The scanner of scanner.toml; InputError with one sentence where the file is not there or cannot be right."""
    path = Path(path)
    try:
        keys = read_toml(path)
    except OSError as problem:
        raise _wrong(path, "a readable file", problem.strerror, "check the path") from None
    except ContentError as problem:
        raise _wrong(path, "TOML", f"a mistake ({problem})", "correct it there") from None
    return scanner_of(keys, str(path))


def scanner_of(keys: Mapping, where: str) -> Scanner:
    """The scanner of scanner.toml's keys."""
    if keys.get("format") != FORMAT:
        raise _wrong(
            f"{where}, key format",
            f'"{FORMAT}"',
            repr(keys.get("format")),
            "calibrate the scanner again",
        )
    try:
        file = _File.model_validate(dict(keys))
    except ValidationError as problem:
        error = problem.errors()[0]
        key = f"{where}, key {'.'.join(map(str, error['loc']))}"
        found = "none" if error["type"] == "missing" else _short(error["input"])
        expected = error["msg"].removeprefix("Input should be ")
        raise _wrong(key, expected, found, "correct it or calibrate again") from None
    planes, steps = _checked_light(file, where)
    camera = camera_from_keys(file.camera, f"{where}, [camera]")
    mirror = _mirror(file, planes, where)
    angles = None if mirror is None else np.array(file.mirror.angles_rad)
    light = file.light
    volume = None if light.volume_mm is None else tuple(light.volume_mm)
    bare = Scanner(
        camera,
        steps,
        planes,
        mirror,
        angles,
        (),
        light.sigma_px,
        _covariance(light, where),
        volume,
        np.array(light.scan),
        file.provenance,
        _frame(light, where),
        light.shared_px or {},
        _turntable(file, where),
        covariance_from_keys(file.camera, camera, f"{where}, [camera]"),
        _rays(light, camera, where),
        trust_from_keys(keys, where),
        trust_from_keys(file.camera, f"{where}, [camera]"),
        _line(light, where),
    )
    effects = tuple(_effect(row, bare, where) for row in file.effect)
    return replace(bare, effects=effects)


def _line(light: _Light, where: str) -> LineShape | None:
    if light.line_mm_px is None:
        return None
    if not light.line_mm_px[0] > 0 or not light.line_mm_px[1] >= 0:
        raise _wrong(
            f"{where}, [light], key line_mm_px",
            "the 1 sigma width of the light plane (mm) and of the blur (px)",
            _short(light.line_mm_px),
            "calibrate again",
        )
    return LineShape(*light.line_mm_px, light.line_scatter or UNKNOWN_SCATTER)


def _wrong(subject, expected, found, remedy) -> InputError:
    return InputError(f"{subject}: expected {expected}, found {found}; {remedy}")


def _short(value):
    text = repr(value)
    return text if len(text) < 60 else f"{text[:57]}..."


def _checked_light(file, where):
    light = file.light
    planes = np.array(light.planes, float).reshape(-1, 4).T
    steps = np.array(light.steps)
    if planes.shape[1] != len(steps):
        raise _wrong(
            f"{where}, key light.planes",
            f"{len(steps)}, one a step",
            f"{planes.shape[1]}",
            "correct it",
        )
    if len(np.unique(steps)) < len(steps):
        raise _wrong(f"{where}, key light.steps", "every step once", "one twice", "correct it")
    if (odd := np.flatnonzero(np.abs(np.linalg.norm(planes[:3], axis=0) - 1) > _UNIT)).size:
        raise _wrong(
            f"{where}, key light.planes.{odd[0]}",
            "a unit normal and an offset in mm",
            _short(light.planes[odd[0]]),
            "correct it",
        )
    if abs(np.hypot(*light.scan) - 1) > _UNIT:
        raise _wrong(f"{where}, key light.scan", "a unit vector", f"{light.scan}", "correct it")
    return planes, steps


def _mirror(file, planes, where):
    if file.mirror is None:
        return None
    keys = file.mirror
    if len(keys.angles_rad) != planes.shape[1]:
        raise _wrong(
            f"{where}, key mirror.angles_rad",
            f"{planes.shape[1]}, one a step",
            f"{len(keys.angles_rad)}",
            "correct it",
        )
    vectors = (np.array(values) for values in (keys.axis, keys.point_mm, keys.face))
    mirror = Mirror(*vectors, keys.offset_mm, np.array(keys.beam))
    mirror_planes = mirror.planes(np.array(keys.angles_rad))
    mirror_planes = mirror_planes * np.sign((mirror_planes[:3] * planes[:3]).sum(0))
    if not np.abs(mirror_planes - planes).max() < _SAME * max(1.0, np.abs(planes[3]).max()):
        raise _wrong(
            f"{where}, [mirror]", "the planes that light.planes holds", "others", "calibrate again"
        )
    return mirror


def _covariance(light, where):
    size = 3 * len(light.steps)
    return _decoded(light.covariance, (size, size), f"{where}, key light.covariance")


def _rays(light, camera, where):
    size = len(camera.values) + 6
    shape = (size, size + 3 * len(light.steps))
    return _decoded(light.rays_covariance, shape, f"{where}, key light.rays_covariance")


def _decoded(text: str | None, shape: tuple[int, int], called: str) -> np.ndarray | None:
    """Numbers of a shape from base64; None for no text."""
    if text is None:
        return None
    try:
        values = np.frombuffer(base64.b64decode(text, validate=True), "<f8").astype(float)
    except (binascii.Error, ValueError):
        values = np.empty(0)
    if values.size != shape[0] * shape[1] or not np.isfinite(values).all():
        raise _wrong(
            called,
            f"{shape[0]} x {shape[1]} numbers, base64 of little-endian doubles",
            f"{values.size} of them",
            "remove the key or calibrate again",
        )
    return values.reshape(shape)


def _frame(light, where):
    if light.frame_covariance is None:
        return None
    values = np.array(light.frame_covariance)
    std = np.sqrt(np.maximum(np.diag(values), 0))
    scaled = values / np.outer(std, std) if (std > 0).all() else np.full((6, 6), np.inf)
    if not (
        np.isfinite(scaled).all()
        and np.allclose(scaled, scaled.T)
        and np.linalg.eigvalsh(scaled)[0] > -_SAME
    ):
        raise _wrong(
            f"{where}, key light.frame_covariance",
            "a covariance of six numbers, symmetric and positive",
            "another matrix",
            "remove the key or calibrate again",
        )
    return values


def _effect(row, scanner, where):
    try:
        effect = make_effects(CATALOGUE, [(row.effect, row.where, row.options)])[0]
    except InputError as problem:
        raise InputError(f"{where}, [[effect]]: {problem}") from None
    names = [p.key.rpartition(".")[2] for p in effect.table(scanner)]
    if set(names) != set(row.parameters):
        raise _wrong(
            f"{where}, effect {row.effect}, key parameters",
            ", ".join(names),
            ", ".join(row.parameters) or "none",
            "correct it",
        )
    return effect, np.array([row.parameters[name] for name in names])
