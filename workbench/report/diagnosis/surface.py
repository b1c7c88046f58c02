"""Page of the diagnosis of a profiler or a 3-D camera: what was found, and held-out errors."""

from collections.abc import Mapping

from workbench.report.sections import Page, Section, note, table, words
from workbench.report.text import rounded


def page(answer: Mapping) -> Page:
    """The page; answer: the object of `diagnose --json` of a ball-surface recording with flange poses."""
    held_out = answer["held_out"]
    numbers = [
        ("held-out RMS, baseline", rounded(held_out["before_mm"]), "mm"),
        ("held-out RMS, with findings", rounded(held_out["after_mm"]), "mm"),
        ("noise", rounded(held_out["noise_mm"]), "mm"),
        ("effects found", str(len(answer["effects"])), ""),
    ]
    lead = [
        "Distances of the measured points from the ball, with the hand-eye transform and the centre of the ball "
        "estimated, and a random error of every flange pose. Each effect is tested by an F-test and by held-out poses."
    ]
    return Page(
        "Diagnosis of the sensor",
        answer["recording"],
        tuple(numbers),
        tuple(lead),
        (Section("effects", "Effects", tuple(_effects(answer))),),
    )


def _effects(answer: Mapping):
    if not answer["effects"]:
        yield words("No unmodelled effect of the sensor was found.")
    else:
        rows = [
            (
                effect["effect"],
                effect["label"],
                rounded(effect["size_mm"]),
                f"{effect['p_value']:.2g}",
                rounded(effect["held_out_before_mm"]),
                rounded(effect["held_out_after_mm"]),
            )
            for effect in answer["effects"]
        ]
        head = ["effect", "law", "size, RMS (mm)", "p", "held out before (mm)", "after (mm)"]
        yield table(head, rows, left=2)
    if answer["refused"]:
        yield note(
            "Tested and not retained",
            [refused_effect["statement"] for refused_effect in answer["refused"]],
        )
