"""Points on the tool that a calibration determined, from its parameters."""


def calibrated_points(values) -> dict:
    """Name -> three coordinates (mm, flange frame) of the points that a calibration determined on the tool.

    values: parameters by key, as `tool.reflector1_x` (name reflector1, sorted by number), `tool.tip_x` (tip),
    `tool.x` (tool) or `sensor.x` (sensor).
    """
    found = {}
    for key in values:
        place, _, axis = key.partition(".")
        name = axis[:-2] if axis.endswith("_x") else place if axis == "x" else ""
        if place in ("tool", "sensor") and name and "." not in name:
            found[name] = [values[key[:-1] + letter] for letter in "xyz"]
    numbers = {
        name: int(name.removeprefix("reflector") or 0) for name in found if name[-1:].isdigit()
    }
    return {name: found[name] for name in sorted(found, key=lambda name: numbers.get(name, 0))}
