"""Points on the tool that a calibration determined, from its parameters."""


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
