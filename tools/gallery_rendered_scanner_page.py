"""Text and image of docs/gallery/rendered-scanner.md, from the figures of gallery_rendered_scanner."""

import textwrap
from pathlib import Path

import numpy as np

PAGE = Path(__file__).resolve().parents[1] / "docs" / "gallery" / "rendered-scanner.md"

_TEXT = """# Rendered scanner after Ye et al.: from images to ball centres, with known truth

Ye et al., Sensors 2024, 24, 2559, section 5.1: 1280 × 1024 px, fx 3423 px, baseline 69 mm, 120 light planes. No
public data set has raw images of such a scanner together with the truth, so the images are rendered
([docs/scenes/ye-scanner.toml](../scenes/ye-scanner.toml)): 20 boards with a warp of 50 µm at a corner, ten of them
swept by the laser, six scans of a 15 mm ball, 1940 images in total. The chain uses only the images.
This page is written by `python tools/gallery.py rendered-scanner`.

![influence of the effects, without and with the effect in the model](rendered-scanner.png)

| | criterion | result | stated 1 σ |
|---|---|---|---|
{whole}

- **Frame.** Centres and planes are compared after rigid alignment of the calibrated scanner with the true one
  over the working volume, without the balls. The pose of the camera frame is known only to the uncertainty of the
  principal point (here {cx:+.2f} ± {cxs:.2f} px). In the calibrated camera frame the same centres are off by
  {raw:.1f} µm RMS. A hand-eye calibration absorbs this error, and it does not affect measurements with the scanner.
- **Speckle** has a contrast of 0.10 and Gaussian grains of 0.8 px (1 σ). That is an assumption: grains about as
  wide as the lens's blur, and some hundred independent patterns (wavelengths of a diode laser, depths of a ceramic,
  places within a pixel) that average in each; the speckle of Ye's instrument is not published. The form that
  follows, {form:.1f} µm, is the noise of single points; noise in proportion, 11.4 µm would be a contrast of about
  0.24.
- **Warp.** With the same board modelled as flat, fx is off by {flat:+.1f} px, with a stated 1 σ of {flats:.2f} px, and
  the RMS of the corners grows from {corner:.4f} to {cornerflat:.4f} px per coordinate.

## The stripe on a ball is not symmetric

Across the stripe the light is exp(−f²/2s²) cos(incidence), f the distance from the light plane and s its 1 σ. On a
curved surface f has a second derivative along the scan line and the cosine a slope: the fit of a Gaussian is pulled by

    c = a² (l − (f2/f1) (3 − q a²/w²)),    a = s/f1

(sensors/stripe/surface_line.py (`sensors/stripe/surface_line.py`) defines the symbols). Almost without noise it agrees
with rendered lines to 5 % (2 % with the true s) and leaves 0.0012 px of 0.0105 px RMS (tests/test_sensor_rendered.py).
It is a physical effect and not one of the renderer: its size is s²/R times a function of both angles, 0.03 px where
the light comes in at 66°, and −0.8 µm in the centre of this ball along the direction of the mirror. A light plane of
0.15 mm and a ball of 10 mm have ten times as much. `workbench scan` takes it off: s comes from how the lines widen with
the slope, the light from the mirror. Where the light grazes by more than 60° its stripe is a ragged patch of
speckle that no first order describes (another −1 µm): these points are left out as those are that are seen too
steeply.

## Coverage of the stated standard deviations

{seeds} small rendered scanners (half the pixels, 24 planes, 12 boards, 8 of them swept, 4 scans) of other
seeds. 68 % is correct; z² is the mean
of the squares of independent standardised errors, 1 is right.

| | within 1 σ | z² | numbers |
|---|---|---|---|
{coverage}

{verdict}

## One effect at a time

A small rendered scanner with each effect in its images and not in the model: what shows (stripe:
what is left of single centres; points: of the working volume after the rigid motion). Then the effect in the model:
its value, and what is left. Bold is more than 3 σ off.

{effects}

- `mirror-wobble` with one and two cycles per revolution over a sweep of 7° is confounded with the pose of the mirror:
  the seven numbers of the mirror, or free planes, absorb it, and its own parameters stay at their priors. No
  accuracy is lost, but the truth in this row (planes without effects) is not what the scanner should find. Points
  and balls of this row are therefore not errors, nor are the points of the other effects that move the light.
- `subsurface-scatter` acts on balls alone. No board shows it: it is seen in the free radius and is to be found from
  balls.
- `plane-bow` is retained by the scanner calibration itself where the stripes on boards support it. Both columns of
  points are therefore those of a model with it.
- `board-bow` is always in the model; what happens without it is said at the top.
- `window-refraction` is nearly a camera that stands further back: only what goes with the cube of the angle shows.
{directions}
"""


def write(parts: dict, effects) -> None:
    """The page and its image."""
    whole = parts["whole"]
    seeds = [parts[name] for name in parts if name.startswith("seed-")]
    rows = {name: parts[name] for name in ("none", *(row[0] for row in effects))}
    cx = whole["joint"]["cx"]
    text = _TEXT.format(
        whole=_whole(whole),
        cx=cx[0],
        cxs=cx[1],
        raw=1e3 * _rms(whole["raw_mm"]),
        form=1e3 * _rms(whole["form_mm"]),
        flat=whole["flat"]["fx"],
        flats=whole["flat"]["std"],
        corner=whole["corner_px"],
        cornerflat=whole["flat"]["px"],
        seeds=len(seeds),
        coverage=_coverage(seeds),
        verdict=_verdict(seeds),
        effects=_effects(rows),
        directions=_directions(rows),
    )
    PAGE.write_text(text, encoding="utf-8")
    draw_image(rows, PAGE.with_suffix(".png"))


def _rms(values) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _whole(made) -> str:
    fx, (planes, points), free = made["camera"]["fx"], made["planes_mm"], made["free_mm"]
    centre, stated = 1e3 * _rms(made["laid_mm"]), 1e3 * _rms([std[:3] for std in made["std_mm"]])
    used = "one mirror" if made["mirror"][0] else "free planes"
    rows = [
        (
            "fx, corners alone",
            "within 3 σ, σ ≤ 0.1 %",
            f"{fx[0]:+.2f} px",
            f"{fx[1]:.2f} px ({fx[1] / 34.23:.4f} %)",
        ),
        ("corners, a coordinate", "", f"{made['corner_px']:.4f} px", ""),
        ("stripe, a centre", "", f"{made['stripe_px']:.3f} px", ""),
        (f"light planes ({used}), RMS over the volume", "≤ 4 µm", f"{1e3 * planes:.2f} µm", ""),
        ("free light planes", "≤ 4 µm", f"{1e3 * free[0]:.2f} µm", ""),
        (
            "points, camera and planes together",
            "",
            f"{1e3 * points:.2f} µm",
            f"{1e3 * made['stated_mm'][0]:.2f} µm",
        ),
        ("ball centre, RMS of a coordinate", "≤ 4 µm", f"{centre:.2f} µm", f"{stated:.2f} µm"),
        ("ball form, RMS", "≤ 11.4 µm", f"{1e3 * _rms(made['form_mm']):.1f} µm", ""),
        (
            "radius, where it is fitted too, mean of six",
            "",
            f"{1e3 * np.mean(made['radius_mm']):+.2f} µm",
            "",
        ),
    ]
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


_COVERED = {
    "camera": "camera, nine values",
    "planes": "camera and planes as used",
    "free": "camera and free planes",
    "balls": "ball centres",
}


def _errors(seeds) -> dict[str, np.ndarray]:
    """Standardised errors of all seeds, by what the page calls them."""
    return {
        called: np.concatenate([np.ravel(one[name]) for one in seeds])
        for name, called in _COVERED.items()
    }


def _coverage(seeds) -> str:
    return "\n".join(
        f"| {called} | {100 * (np.abs(z) < 1).mean():.0f} % | {(z**2).mean():.2f} | {z.size} |"
        for called, z in _errors(seeds).items()
    )


def _verdict(seeds) -> str:
    laid = 1e3 * np.concatenate([np.reshape(one["laid_mm"], (-1, 3)) for one in seeds])
    planes = 1e3 * _rms([one["planes_mm"][0] for one in seeds])
    mean = ", ".join(f"{value:+.2f}" for value in laid.mean(0))
    short = [
        called for called, z in _errors(seeds).items() if not 0.62 <= (np.abs(z) < 1).mean() <= 0.74
    ]
    most = 100 * (max(_rms(z) for z in _errors(seeds).values()) - 1)
    verdict = (
        f"**Outside the criterion of 62 to 74 %: {'; '.join(short)}.**"
        if short
        else "All meet the criterion."
    )
    return textwrap.fill(
        f"Ball centres are {_rms(laid):.2f} µm RMS off (mean {mean}), planes {planes:.2f} µm. {verdict} By z² stated "
        f"sigmas are up to {most:.0f} % too small. Stripes on tilted boards are pulled as those on balls are "
        "(sensors/light/straight.py (`sensors/light/straight.py`)): nearer parts are seen larger and lit more. "
        "Against true boards and planes that makes means of up to 0.005 px of a board pose, in proportion to the "
        "board's tilt about the stripe (correlation 0.43 over 400 board poses); taken off, the correlation is 0.00. "
        "What stripes of a board pose share beyond that is found to 0.009 px only, so that this much of it is counted "
        "on. The camera's nine values are not independent: of 26 further seeds, boards alone, 67 % of the values are "
        "within 1 σ, and 64 % of the 234 independent combinations.",
        116,
    )


def _directions(rows) -> str:
    """Of the effects that part the two directions of a sweep."""
    left = [rows[name]["stripe_px"] for name in ("mirror-hysteresis", "frame-sync")]
    balls = [1e3 * rows[name]["ball_mm"] for name in ("mirror-hysteresis", "frame-sync")]
    return textwrap.fill(
        "- `mirror-hysteresis` and `frame-sync` part the two directions of a sweep: to agree, boards would have to "
        f"move. Their corners hold them where they are; the {left[0]:.1f} and {left[1]:.1f} px that are left are taken "
        "for a shift of each board pose, much larger than light can make one, and `workbench scanner` says that "
        "something is missing. Planes are those of the mean of both directions; whoever goes on all the same has "
        f"centres that are off by {balls[0]:.0f} and {balls[1]:.0f} µm, as each scan has its own direction. In the "
        "model both are found.",
        116,
        subsequent_indent="  ",
    )


def _effects(rows) -> str:
    heads = (
        "effect",
        "corners px",
        "stripe px",
        "points µm",
        "one mirror?",
        "ball µm",
        "form µm",
        "radius µm",
        "in the model: found (true)",
        "points µm",
    )
    return "\n".join(
        [
            f"| {' | '.join(heads)} |",
            "|---" * len(heads) + "|",
            *(effect_row(*one) for one in rows.items()),
        ]
    )


def effect_row(name, made) -> str:
    """A row of the table of effects, of the figures of one part."""
    ball, form, radius = (made[key] for key in ("ball_mm", "form_mm", "radius_mm"))
    cells = [
        name,
        f"{made['corner_px']:.4f}",
        f"{made['stripe_px']:.4f}",
        f"{1e3 * made['points_mm']:.1f}",
        "yes" if made["mirror"][0] else f"no (p {made['mirror'][1]:.0e})",
    ]
    cells += ["–" if value is None else f"{1e3 * value:.1f}" for value in (ball, form, radius)]
    known = made.get("recovered") or {}
    shown = [row for row in known.items() if row[1][2] or name != "mirror-wobble"]
    cells.append("; ".join(_value(*row) for row in shown) or "–")
    cells.append(f"{1e3 * made['with_points_mm']:.1f}" if known else "–")
    return f"| {' | '.join(cells)} |"


def _value(name, found) -> str:
    value, sigma, true = found
    if sigma is None:
        return f"{name} not free"
    off = abs(value - true) > 3 * sigma
    if true and abs(value) < 0.01 * sigma:
        return f"{name} undetermined ({true:g})"
    text = f"{value:.3g} ± {sigma:.1g} ({true:g})"
    return f"{name} {'**' + text + '**' if off else text}"


def draw_image(rows: dict, path: Path) -> None:
    """Bars: points of the working volume, form and ball, for each effect, without and with it in the model."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(11, 5.2))
    place = np.arange(len(rows))
    shown = (
        ("points_mm", "points, effect not in the model"),
        ("with_points_mm", "points, effect in the model"),
        ("ball_mm", "ball centre, not in the model"),
        ("form_mm", "ball form, not in the model"),
    )
    for k, (key, called) in enumerate(shown):
        axes.bar(
            place + 0.2 * (k - 1.5),
            [1e3 * (row.get(key) or np.nan) for row in rows.values()],
            0.2,
            label=called,
        )
    axes.set_yscale("log")
    axes.set_ylabel("µm, RMS")
    axes.set_xticks(place, list(rows), rotation=30, ha="right")
    axes.grid(axis="y", alpha=0.3)
    axes.set_ylim(top=5 * axes.get_ylim()[1])  # room for the legend
    axes.legend(ncols=2, frameon=False)
    figure.tight_layout()
    figure.savefig(path, dpi=110)
    plt.close(figure)
