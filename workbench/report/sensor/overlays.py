"""Images with what was detected in them: corners as circles, their residuals as enlarged arrows."""

import base64
from pathlib import Path

import numpy as np

from workbench.report.text import rounded

_LONGEST = 560
_ORANGE, _MAGENTA = (14, 127, 255), (208, 47, 255)  # BGR
_ARROW = 22.0


def overlay(path: Path, pixels: np.ndarray, residual: np.ndarray, scale: float) -> str:
    """A data address of the image at `path` with corners (2, k) px and residuals (2, k) px, `scale` times enlarged.

    "" where the image cannot be read.
    """
    import cv2

    image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    if image is None or not image.size:
        return ""
    shrink = min(_LONGEST / max(image.shape), 1.0)
    small = cv2.resize(image, None, fx=shrink, fy=shrink, interpolation=cv2.INTER_AREA)
    drawn = cv2.cvtColor(small, cv2.COLOR_GRAY2BGR)
    for corner, arrow in zip(pixels.T, residual.T):
        start = _point(corner * shrink)
        end = _point((corner + scale * arrow) * shrink)
        cv2.circle(drawn, start, 4, _ORANGE, 1, cv2.LINE_AA)
        cv2.arrowedLine(drawn, start, end, _MAGENTA, 1, cv2.LINE_AA, 0, 0.25)
    code = cv2.imencode(".jpg", drawn, [cv2.IMWRITE_JPEG_QUALITY, 82])[1]
    return "data:image/jpeg;base64," + base64.b64encode(code.tobytes()).decode()


def _point(place: np.ndarray) -> tuple[int, int]:
    x, y = np.round(np.nan_to_num(place)).astype(int)
    return int(x), int(y)


def overlays(run, max_images: int = 6) -> list[tuple[str, str]]:
    """Data address and caption of the images with the largest RMS of a camera run, largest first."""
    from workbench.report.calibration.scene import arrow_step

    calibration = run.calibration
    size = max(calibration.camera.size)
    length = float(np.percentile(np.sqrt((calibration.residual**2).sum(0)), 95))
    wanted = _ARROW * size / _LONGEST / max(length, 1e-9)
    scale = arrow_step(wanted)
    found = []
    for k in np.argsort(-calibration.view_rms_px)[:max_images]:
        view = calibration.views[k]
        is_of_view = calibration.view == k
        source = overlay(
            run.recording.folder / view.image,
            calibration.chain.pixels[:, is_of_view],
            calibration.residual[:, is_of_view],
            scale,
        )
        caption = f"{view.image}: RMS {rounded(calibration.view_rms_px[k])} px, arrows enlarged {scale:,.0f} times"
        found.append((source, caption))
    return found
