"""A tool, sensor or reflector that moved within the recording: what a correction of the flange leaves out."""

from workbench.files.solution_file import CalibratedArm

_WITH_REFLECTORS = ("external-point", "external-pose", "partial-pose", "distance")
"""Kinds of recordings whose rows state which reflector was measured."""


def moved_tool_words(arm: CalibratedArm) -> list[str]:
    """A sentence on each effect of the solution that displaces only what the flange carries; [] where there is none."""
    if arm.keys.get("measures") in _WITH_REFLECTORS:
        meaning = (
            "the recording does not tell a tool that moved from a reflector that was remounted, and the flange is "
            "where it was. If the tool moved, teach its tool centre point again. If the reflector was remounted, give "
            "it another number in column reflector from then on and calibrate again, which uses all poses."
        )
    else:
        meaning = (
            "what the flange carries moved, and the flange is where it was. Teach the tool centre point, or the "
            "hand-eye transform of the sensor, again."
        )
    return [
        f"{effect.title} is not corrected: {meaning}"
        for effect in arm.effects
        if effect.beyond_flange
    ]
