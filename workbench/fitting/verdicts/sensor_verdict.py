"""Verdicts on cameras, scanners and scans: residuals against the noise of the images and against tolerances.

A result whose residual is far above the noise and large in itself is not trustworthy: the images then show something
else than the model says (another board, a line next to the board, images of two cameras). It does not pass, whether or
not a tolerance was given. A result with a significant lack of fit, or from an asymmetric line, can be used, but its
stated uncertainty cannot: a warning says so.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sensors.camera.model import RATIONAL
from sensors.scanner.residuals.misfit import Misfit
from sensors.stripe.asymmetry import Asymmetry
from sensors.trust import Trust
from workbench.fitting.verdicts.line_doubts import (
    DOUBT_WORDS,
    POOR_WORDS,
    is_mostly_stationary,
    is_mostly_wrong,
    line_doubts,
)
from workbench.fitting.verdicts.scan_sums import POOR, BallSums
from workbench.fitting.verdicts.verdict import (
    Noise,
    Residual,
    Tolerance,
    Verdict,
    combine,
    judge,
    no_verdict,
)

CAMERA_UNITS = ("px",)
SCANNER_UNITS = ("mm", "px")
SCAN_UNITS = ("mm",)
_CORNERS = "of each corner in its image"
_CENTRES = "of each stripe centre in its image"
_NEIGHBOURS = "of neighbouring stripe centres"
_POINTS = "of the points, as the errors of sensor and pose explain it"
# What is both so many times the noise and so many px off, or such a share of the image's width in a small image, is no
# noise and no imperfect lens.
_POOR_PX, _POOR_SHARE = 1.0, 5e-4
_WIDE_DEG = 85.0  # field of view from which a lens may be a fisheye
_BLURRED_PX = (
    2.0  # 1 sigma: twice what a lens in focus and the size of a pixel make of an edge, and more
)
_NAMED_IMAGES = 6
_MAINLY = 0.95  # of the lack of fit
_OVEREXPOSED = 0.05  # of the points on balls
_MODEL = "the model leaves out a part of what the images show"
_INDEPENDENT = (
    "no error that images share is significant, so that corners err independently by more than single images tell; the "
    "stated uncertainty follows from the residual"
)
_LENS = "lens"
_CAUSES = {
    "lines of the board": "rows or columns of the board are not where they are said to be; measure or replace it",
    "points of the board": "points of the board are not where they are said to be; measure or replace it",
    "height of the board": "the board is not flat in a way that its warp does not describe; use a flat one",
    _LENS: "the lens is not of the model fitted; use `--model auto` if a model was stated, else look for a "
    "window, dirt or a loose lens",
}
"""What to do about each error that many images share, see `sensors.camera.correlated_errors.shared_effects`."""
_DIAGNOSE = "an effect is missing in the model; run `workbench diagnose` to find it"


def camera_verdict(calibration, tolerances: Sequence[Tolerance] = ()) -> Verdict:
    """Verdict on a `CameraCalibration`: RMS reprojection error, of images left out where there are enough."""
    value, name = calibration.rms_px, "RMS reprojection error"
    if calibration.held_out is not None:
        value, name = calibration.held_out.rms_px, f"held-out {name}"
    noise = math.sqrt(2) * _rms(np.concatenate([view.sigma for view in calibration.views]))
    degrees = max(
        2 * int(calibration.view.size)
        - 6 * len(calibration.poses)
        - len(calibration.camera.values),
        1,
    )
    residual = Residual(value, "px", name, degrees)
    verdict = judge(residual, Noise(noise, _CORNERS), tolerances, _MODEL)
    if _is_poor(verdict, math.sqrt(2) * _least_px(calibration)):
        return _refused(verdict)
    if _err_independently(calibration):
        return judge(residual, Noise(noise, _CORNERS), tolerances, _INDEPENDENT)
    return verdict


def _err_independently(calibration) -> bool:
    """Whether neither errors that images share nor the focal length of single images are significant.

    The residual is then noise, whatever its size.
    """
    shared, focal = calibration.shared, calibration.focal
    if shared is None or shared.significant or calibration.two_cameras is not None:
        return False
    return focal is None or not focal.significant


def camera_warnings(calibration) -> list[str]:
    """Why a camera or its stated uncertainty is not trustworthy, if it is not."""
    verdict = camera_verdict(calibration)
    if calibration.two_cameras is not None:
        words = POOR_WORDS if verdict.passed is False else DOUBT_WORDS
        return [f"{words}: {calibration.two_cameras.sentence}"]
    if verdict.passed is not False:
        return [
            *_unknown_focal_length(calibration),
            *_focal(calibration),
            *_shared(calibration),
            *blurred_images(calibration.views),
            *_lines(calibration.left_out_lines, "; they contradict all others and are left out"),
        ]
    return [
        f"{POOR_WORDS}: corners miss their predicted places by {verdict.residual:.3g} px, "
        f"{verdict.residual_over_noise:.3g} times their noise; check kind, columns and rows under [board], that all "
        f"images are of one camera with fixed focus, and that the board is flat{_wide(calibration)}",
        *blurred_images(calibration.views),
        *_lines(calibration.displaced_lines),
    ]


def _unknown_focal_length(calibration) -> list[str]:
    """A warning where the images do not determine the focal length."""
    known = [math.isfinite(calibration.std.get(f"camera.{name}", 0.0)) for name in ("fx", "fy")]
    if all(known):
        return []
    is_rational = len(calibration.camera.values) == RATIONAL
    fewer = ", or use fewer coefficients (`--model brown`)" if is_rational else ""
    return [
        f"{DOUBT_WORDS}: the focal length is not identifiable from these images (below). Do not use this camera for "
        "measurements: take images with the board tilted by 20 to 45 degrees both ways, near and far, and over the "
        f"whole image{fewer}"
    ]


def _wide(calibration) -> str:
    """Words on a lens that may be too wide for the models, by the field of view at the focal length that was fitted."""
    camera = calibration.camera
    if calibration.choice is not None:
        return ""  # the fisheye model was tried
    half_angles = np.arctan(np.array(camera.size) / 2 / np.array([camera.fx, camera.fy]))
    angle = 2 * math.degrees(half_angles.max())
    if not angle > _WIDE_DEG:
        return ""
    return (
        f". The field of view is about {angle:.0f} deg: a fisheye lens needs `--model auto` or "
        "`--model fisheye`"
    )


def camera_trust(calibration) -> Trust:
    """Trustworthiness of a `CameraCalibration`, as stated in its file."""
    is_usable = camera_verdict(calibration).passed is not False
    return Trust(is_usable, tuple(camera_warnings(calibration)))


def scanner_verdict(
    calibration, tolerances: Sequence[Tolerance] = (), misfit: Misfit | None = None
) -> Verdict:
    """Verdict on a `ScannerCalibration`: stripe points from their light plane, in mm and in px along the scan line.

    misfit: lack of fit of the stripes, which then decides whether the residual is larger than the noise explains.
    """
    verdict = _scanner_verdict(calibration, tolerances, misfit)
    is_poor = (
        _poor_planes(calibration)
        or is_mostly_wrong(calibration)
        or is_mostly_stationary(calibration)
    )
    if is_poor or _poor_camera(calibration.start):
        return _refused(verdict)
    return verdict


def _scanner_verdict(calibration, tolerances, misfit) -> Verdict:
    good = ~calibration.wrong
    board_stripes, held_out = calibration.stripes, calibration.left_out
    sigma = np.broadcast_to(board_stripes.sigma, (1, board_stripes.n))[0][good]
    significant, source = None, _CENTRES
    if misfit is not None:
        sigma = sigma * (misfit.noise_px / _rms(sigma))
        significant, source = misfit.is_relevant, _NEIGHBOURS
    pixels = calibration.sigma_stripe_px
    millimetres = _rms(calibration.residual_mm[good])
    label = "RMS distance of stripe points from their light plane"
    if held_out is not None and math.isfinite(held_out.rms_mm):
        pixels, millimetres, label = held_out.rms_px, held_out.rms_mm, f"held-out {label}"
    degrees = max(int(good.sum()) - 3 * len(calibration.scanner.steps), 1)
    return combine(
        [
            judge(
                Residual(millimetres, "mm", label, degrees, significant),
                Noise(_rms(sigma * board_stripes.gain[good]), source),
                tolerances,
                _MODEL,
            ),
            judge(
                Residual(pixels, "px", label, degrees, significant),
                Noise(_rms(sigma), source),
                tolerances,
                _MODEL,
            ),
        ]
    )


def scanner_warnings(
    calibration, misfit: Misfit | None = None, asymmetry: Asymmetry | None = None
) -> list[str]:
    """Why a scanner or its stated uncertainty is not trustworthy, if it is not."""
    warnings = camera_warnings(calibration.start)
    if _poor_planes(calibration):
        pixels = _pixel_part(calibration)
        warnings.append(
            f"{POOR_WORDS}: the laser line lies {pixels.residual:.3g} px from its light plane, "
            f"{pixels.residual_over_noise:.3g} times the noise of its centres; {_advice(misfit)}"
        )
    if is_mostly_wrong(calibration):
        wrong = float(calibration.wrong.mean())
        warnings.append(
            f"{POOR_WORDS}: {100 * wrong:.0f} % of the points of the laser line were left out as wrong; take the "
            "images with less light, without reflections, and with the line on the board"
        )
    is_refused = any(sentence.startswith(POOR_WORDS) for sentence in warnings)
    if misfit is not None and misfit.is_relevant and not is_refused:
        warnings.append(f"{DOUBT_WORDS}: {misfit.sentence}: {_DIAGNOSE}")
    return [*warnings, *line_warnings(calibration, asymmetry)]


def line_warnings(calibration, asymmetry: Asymmetry | None = None) -> list[str]:
    """Warnings about the laser line itself of a `ScannerCalibration`, which residuals need not show."""
    return [suspicion.sentence for suspicion in line_doubts(calibration, asymmetry)]


def _focal(calibration) -> list[str]:
    """A warning on a focal length that differs between board poses; a lens of another model looks alike."""
    focal = calibration.focal
    if focal is None or not focal.significant:
        return []
    other = (
        "; or the lens is not of the model fitted, since corners at one place of the image are off alike: try "
        "`--model auto` and boards that fill the image"
        if _LENS in _large_errors(calibration)
        else ""
    )
    return [f"{DOUBT_WORDS}: {focal.sentence}{other}"]


def blurred_images(views) -> list[str]:
    """A warning on images whose edges are wider than those of a lens in focus."""
    blurred = [view for view in views if view.blur_px > _BLURRED_PX]
    if not blurred:
        return []
    widths = sorted(view.blur_px for view in blurred)
    if widths[-1] - widths[0] < 0.1:
        width = f"{widths[0]:.1f}"
    else:
        width = f"{widths[0]:.1f} to {widths[-1]:.1f}"
    names = ", ".join(view.image for view in blurred[:_NAMED_IMAGES])
    ellipsis = ", ..." if len(blurred) > _NAMED_IMAGES else ""
    return [
        f"{len(blurred)} of {len(views)} images are blurred: 1 sigma of their edges is {width} px, a lens in focus has "
        f"less than 1 px ({names}{ellipsis}). Their corners are less precise, and blur that is not symmetric displaces "
        "them; focus the lens, close the aperture or expose for less time"
    ]


def _lines(lines, addition: str = "") -> list[str]:
    """A warning on rows or columns of the board that are displaced; addition: what is said of their corners."""
    if not lines:
        return []
    sentences = ", ".join(line.sentence for line in lines)
    return [f"The board errs: the images show {sentences}{addition}. Measure or replace the board"]


def _shared(calibration) -> list[str]:
    """A warning on errors that many images share and that displace corners by more than their noise."""
    names = _large_errors(calibration)
    if not names:
        return []
    errors = calibration.shared.errors
    ratio = errors.largest / errors.noise
    return [
        f"Corners are displaced by the same in many images, by {ratio:.2g} times their noise (1 sigma: "
        f"{errors.names}): {' and '.join(_CAUSES[name] for name in names)}. The stated uncertainty "
        "includes it, more images do not average it out"
    ]


def _large_errors(calibration) -> list[str]:
    """Names of the errors that many images share which displace corners by more than their noise, in one order."""
    shared = calibration.shared
    if shared is None or not shared.significant:
        return []
    large = {name for name, *_, size in shared.errors.effects if size > shared.errors.noise}
    return [name for name in _CAUSES if name in large]


def scanner_trust(
    calibration, misfit: Misfit | None = None, asymmetry: Asymmetry | None = None
) -> Trust:
    """Trustworthiness of a `ScannerCalibration`, as stated in its file.

    Lack of fit is a further displacement of each stripe of a later scan, since it is not known whether its cause stays.
    """
    is_usable = scanner_verdict(calibration, (), misfit).passed is not False
    warnings = tuple(scanner_warnings(calibration, misfit, asymmetry))
    if misfit is None or not misfit.is_relevant:
        return Trust(is_usable, warnings)
    tilt = math.sqrt(3) * math.hypot(misfit.tilt_px, misfit.bend_px)  # at the ends, from the RMS
    return Trust(is_usable, warnings, (misfit.shift_px, tilt))


def repeated_warnings(trust: Trust | None, subject: str) -> list[str]:
    """Warnings of a calibration for a result that rests on it; subject: "scanner" or "camera"."""
    if trust is None:
        return []
    return [_repeated(warning, subject) for warning in trust.warnings]


def _repeated(warning: str, subject: str) -> str:
    for words, state in ((POOR_WORDS, "is refused"), (DOUBT_WORDS, "is doubtful")):
        if warning.startswith(words):
            return f"{words}: the calibration of the {subject} {state}{warning.removeprefix(words)}"
    return f"The calibration of the {subject} warned: {warning}"


def _is_unusable(calibration) -> bool:
    """Whether the calibration of the scanner of `Scans` was refused."""
    trust = None if calibration.scanner is None else calibration.scanner.trust
    return trust is not None and not trust.usable


def _advice(misfit: Misfit | None) -> str:
    """Points to check where the line lies far from its light planes."""
    if misfit is not None and misfit.shift_px > _MAINLY * misfit.total_px:
        return (
            "nearly all of it displaces whole stripes, as a mirror does that does not reach its angle (jitter, "
            "vibration, drift), a board that moved between images, or a wrong step in images.csv"
        )
    return (
        "see that the line runs across the board's surface and not on its margin or behind it, and that board and "
        "laser images of a board pose belong together"
    )


def _poor_planes(calibration) -> bool:
    """Whether the laser line lies far from its light planes, in px and in multiples of its noise."""
    return _is_poor(_pixel_part(calibration), _least_px(calibration))


def _pixel_part(calibration) -> Verdict:
    return next(part for part in _scanner_verdict(calibration, (), None).parts if part.unit == "px")


def _poor_camera(calibration) -> bool:
    return camera_verdict(calibration).passed is False


def scan_verdict(scan, tolerances: Sequence[Tolerance] = ()) -> Verdict:
    """Verdict on `Scans`: points of all balls from their balls, mm. One pass over the scans, whose sums are kept.

    The noise is that of neighbouring centres of each stripe, so that lack of fit does not count as noise.
    """
    sums = _ball_sums(scan)
    if not sums.points:
        verdict = no_verdict("No ball was fitted, so no residual can be judged.")
        return _refused(verdict) if _is_unusable(scan) else verdict
    size = math.sqrt(sums.squares / sums.points)
    significant = None if not sums.tested else sums.doubtful > 0
    residual = Residual(
        size, "mm", "RMS distance of ball points from their balls", sums.points, significant
    )
    noise = Noise(
        math.sqrt(sums.noise_squares / sums.points), _NEIGHBOURS if sums.tested else _POINTS
    )
    advice = "the calibration of the scanner, the certified radius or the ball's form is off"
    verdict = judge(residual, noise, tolerances, advice)
    if sums.is_poor or _is_unusable(scan):
        return _refused(verdict)
    return verdict


def scan_warnings(scan) -> list[str]:
    """Why scans or their stated uncertainty are not trustworthy, if they are not; those of the scanner first."""
    trust = None if scan.scanner is None else scan.scanner.trust
    return [*repeated_warnings(trust, "scanner"), *_own_warnings(scan)]


def _own_warnings(scan) -> list[str]:
    """The same of the scans alone."""
    sums = _ball_sums(scan)
    if sums.points and sums.is_poor:
        size = math.sqrt(sums.squares / sums.points)
        return [
            f"{POOR_WORDS}: points lie {size:.3g} mm from their balls, {sums.over_stated:.3g} times the noise; see "
            "that the scanner file belongs to these images, and check the radii in artefact.csv",
            *_overexposed(sums),
        ]
    warnings = [*_displaced(sums), *_other_radii(sums), *_other_distances(sums)]
    return [*warnings, *_overexposed(sums)] if warnings or sums.untested else warnings


def _overexposed(sums: BallSums) -> list[str]:
    """A warning on full pixels as a cause of other doubts, or where balls have too few stripes to be tested."""
    if not sums.overexposed > _OVEREXPOSED * sums.points:
        return []
    share = 100 * sums.overexposed / sums.points
    return [
        f"The laser line is overexposed at {share:.0f} % of the points on balls: light that overflows from full pixels "
        "displaces it, which no stated uncertainty holds; expose less and scan again"
    ]


def _displaced(sums: BallSums) -> list[str]:
    """A warning on stripes that do not lie on their balls."""
    if not sums.doubtful:
        return []
    untested = (
        f", which have three stripes or more ({sums.untested} with fewer cannot be tested)"
        if sums.untested
        else ""
    )
    return [
        f"{DOUBT_WORDS}: in {sums.doubtful} of {sums.tested} tested balls{untested}, {sums.worst.sentence}: {_DIAGNOSE}"
        ", and check radius and form of the ball"
    ]


def _other_radii(sums: BallSums) -> list[str]:
    """A warning on radii that differ from those of the certificate."""
    radii = sums.radii
    if not radii.count:
        return []
    count = sums.tested + sums.untested
    return [
        f"{DOUBT_WORDS}: the radius of {radii.count} of {count} balls differs from the stated one ({radii.sentence}): "
        "compare with other scans of the same ball; if they agree, correct the radius in artefact.csv, calibrate the "
        "scanner again, or look for light that enters the surface (`workbench diagnose`); if single scans differ, "
        "check the poses of a moved sensor"
    ]


def _other_distances(sums: BallSums) -> list[str]:
    """A warning on balls that are not as far apart as their certificate says."""
    if not sums.distances.count:
        return []
    return [
        f"Distances between balls contradict artefact.csv ({sums.distances.sentence}): correct centres or numbers "
        "there, or the unit; a result that rests on these distances is wrong by as much"
    ]


def _refused(verdict: Verdict) -> Verdict:
    """The same as a failure: a result that is not trustworthy passes no tolerance."""
    sentence = f"{verdict.sentence} {POOR_WORDS}."
    return replace(verdict, passed=False, sentence=sentence)


def _ball_sums(scan_run) -> BallSums:
    """The sums over all balls of all scans, made once."""
    if "ball_sums" not in scan_run.cache:
        sums = BallSums()
        for scan in scan_run.scans:
            sums.add_scan(scan, scan_run.recording.balls, scan_run.scanner)
        scan_run.cache["ball_sums"] = sums
    return scan_run.cache["ball_sums"]


def _least_px(calibration) -> float:
    """px of a coordinate."""
    return min(_POOR_PX, _POOR_SHARE * calibration.camera.size[0])


def _is_poor(verdict: Verdict, tolerance: float) -> bool:
    ratio = verdict.residual_over_noise
    return ratio is not None and ratio > POOR and verdict.residual > tolerance


def _rms(values) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
