"""Points on the tool that a calibration determined, from its parameters."""

import numpy as np

_ON_A_LINE_MM = (
    10.0  # distance from their common line below which points do not determine a rotation about it
)


def calibrated_points(values) -> dict:
    """Name -> three coordinates (mm, flange frame) of the points that a calibration determined on the tool.

    values: parameters by key, as `tool.reflector1_x` (name reflector1, sorted by number), `tool.tip_x` (tip),
    `tool.x` (tool) or `sensor.x` (sensor).
    """
    found = {}
    for key in values:
        place, _, axis = key.partition(".")
        name = ""
        if axis == "x":
            name = place
        elif axis.endswith("_x"):
            name = axis[:-2]
        if place in ("tool", "sensor") and name and "." not in name:
            stem = key[:-1]
            found[name] = [values[stem + letter] for letter in "xyz"]

    def number(name):
        if name[-1:].isdigit():
            return int(name.removeprefix("reflector") or 0)
        return 0

    return {name: found[name] for name in sorted(found, key=number)}


_WITH_ROTATION = ("tool", "sensor")
_NAMES = {
    "tip": "the tip",
    "tool": "the measured target on the tool",
    "sensor": "the origin of the sensor",
}


def corrected_point_name(values) -> str:
    """The point that an arm with fewer than six directions places first, in words: "reflector 1".

    It is the first of `calibrated_points`, or the origin of the flange if there is none; values: as there.
    """
    name = next(iter(calibrated_points(values)), "")
    if name.startswith("reflector"):
        return f"reflector {name.removeprefix('reflector') or 1}"
    return _NAMES.get(name, "the origin of the flange")


def undetermined_points_remark(values) -> str:
    """Sentence on a calibration whose measured points are on one line; "" where they determine the whole tool.

    The rest of the tool can then turn about this line, or about the only point, without a change of any measurement.
    values: as of `calibrated_points`.
    """
    points = calibrated_points(values)
    if not points or any(name in _WITH_ROTATION for name in points):
        return ""
    places = np.array(list(points.values()))
    distances = np.linalg.svd(places - places.mean(0), compute_uv=False)
    if len(places) > 2 and distances[1] > _ON_A_LINE_MM:
        return ""
    name = next(iter(points))
    described = "tip" if name == "tip" else "reflector"
    x, y, z = places[0]
    where = (
        f"The stated errors are those of the {described} (at {x:.0f}, {y:.0f}, {z:.0f} mm in the flange frame)."
        if len(places) == 1
        else f"The stated errors are those of the {len(places)} {described}s, which are on one line."
    )
    return (
        f"{where} The flange, and a tool at another place, have errors in addition that these data do not show: "
        "length, twist and zero of the last joint. Measure three reflectors that are not on a line, or poses."
    )
