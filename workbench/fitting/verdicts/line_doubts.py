"""Anomalies of the laser line of a scanner, with their place, which residuals need not show."""

from dataclasses import dataclass

from sensors.effects.laser import GhostLine
from sensors.effects.optics import Blooming
from sensors.scanner.residuals.rejected_points import RejectedPoints
from sensors.stripe.asymmetry import Asymmetry
from workbench.core.distributions import norm
from workbench.core.effect import Effect

POOR_WORDS = "DO NOT USE THIS RESULT, it is not trustworthy"
DOUBT_WORDS = "The stated uncertainty is not trustworthy"
MOST_WRONG = 0.5
# Of clean images 1 to 3 % are.
_MANY_WRONG = 0.1
_PLACES = {
    (
        "u",
        "v",
    ): "they lie at certain places of the image: a scratch or dirt on the optics, or a reflection",
    ("board_x", "board_y"): "they lie at certain places of the board: a glossy or damaged print",
    ("mirror",): "they lie in certain light planes: an obstacle before the laser, or a second line",
    (
        "line_brightness",
    ): "they lie where the line is bright or dark: overexposure, blooming, or too little light",
    (
        "line_width",
    ): "they lie where the line is wide or narrow: a line out of focus, or a second line next to it",
}
_ANYWHERE = "no place of the image or of the board and no light plane holds most of them"


@dataclass(frozen=True)
class LineDoubt:
    """One doubt: `label` in a few words, `where` in the vocabulary, the covariates that it `depends_on`, `p_value` of
    chance, `size_px` where known, the `sentence` with what to do, and the `suspect`, an effect
    that does so, None where many causes do."""

    label: str
    where: str
    depends_on: tuple[str, ...]
    p_value: float
    size_px: float | None
    sentence: str
    suspect: type[Effect] | None = None


def line_doubts(calibration, asymmetry: Asymmetry | None = None) -> list[LineDoubt]:
    """Doubts about the laser line of a `ScannerCalibration`."""
    found, dependence = [], calibration.dependence
    if calibration.rejected.share > _MANY_WRONG and not is_mostly_wrong(calibration):
        found.append(_of_rejected(calibration.rejected))
    if asymmetry is not None and asymmetry.is_relevant(calibration.scanner.sigma_px):
        found.append(_of_asymmetry(asymmetry))
    if dependence is not None and dependence.is_relevant:
        description = (
            "camera",
            ("line_brightness", "line_width"),
            dependence.p_value,
            dependence.rms_px,
        )
        label = "centres of the line are displaced with its brightness and width"
        sentence = f"{DOUBT_WORDS}: {dependence.sentence}"
        found.append(LineDoubt(label, *description, sentence, Blooming))
    first = POOR_WORDS if is_mostly_stationary(calibration) else DOUBT_WORDS
    label = "another line stays at one place of the image"
    for line in calibration.lines:
        description = ("camera", ("u", "v"), 0.0, None)
        found.append(LineDoubt(label, *description, f"{first}: {line.sentence}"))
    return found


def is_mostly_wrong(calibration) -> bool:
    """Whether most points of the laser line were left out as wrong."""
    return float(calibration.wrong.mean()) > MOST_WRONG


def is_mostly_stationary(calibration) -> bool:
    """Whether most centres on boards were of lines that stay in the image: what is left is then hardly the laser's."""
    stationary = sum(line.centres for line in calibration.lines)
    return stationary > MOST_WRONG * (stationary + calibration.stripes.n)


def _of_rejected(rejected: RejectedPoints) -> LineDoubt:
    share = f"{100 * rejected.share:.0f} %"
    label = f"{share} of its points were left out as wrong"
    place = _PLACES.get(rejected.depends_on, _ANYWHERE)
    sentence = (
        f"{DOUBT_WORDS}: {share} of the points of the laser line were left out as wrong; {place}"
    )
    if rejected.region:
        label += f" ({rejected.region})"
        sentence += f" ({rejected.region})"
    sentence += ". Look at the laser images there, remove the cause, and take them again"
    description = (rejected.where, rejected.depends_on, rejected.p_value, None)
    return LineDoubt(label, *description, sentence, Blooming if rejected.is_bright else None)


def _of_asymmetry(asymmetry: Asymmetry) -> LineDoubt:
    label = f"its profile is asymmetric by {100 * asymmetry.odd:.1f} % of its peak"
    sentence = (
        f"The profile of the laser line is asymmetric by {100 * asymmetry.odd:.1f} % of its peak: where brightness or "
        f"width of the line change, its centre moves by up to {abs(asymmetry.ambiguity_px):.2g} px, which no residual "
        "and no stated uncertainty holds; look for a second line, a reflection, blooming or overexposure in the laser "
        "images, and focus the laser"
    )
    # two-sided, of a normal distribution
    p_value = float(2 * norm.sf(abs(asymmetry.ambiguity_px) / max(asymmetry.std_px, 1e-300)))
    description = ("laser", ("line_width",), max(p_value, 1e-300), abs(asymmetry.ambiguity_px))
    return LineDoubt(label, *description, sentence, GhostLine)
