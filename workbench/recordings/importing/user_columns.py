"""Sentences on the columns of a recording as sentences on the columns of the table that it is imported from."""

import re

from datasets.importers.mapping.columns.spherical import is_spherical
from datasets.importers.mapping.model import Mapping

_INTERNAL = re.compile(r"samples\.csv of recording '[^']*'")
_LEADING = re.compile(r"^recording '[^']*', (?=robot file of )")
_QUATERNION = "quaternion "


def in_user_columns(sentence: str, called: str, mapping: Mapping) -> str:
    """The sentence with the name of the user's file, and with headers in the place of the columns of a recording.

    called: the file. Sentences on anything but samples.csv are returned as they are.
    """
    sentence = _LEADING.sub("", sentence)
    if not _INTERNAL.search(sentence):
        return sentence
    named = _INTERNAL.sub(lambda match: called, sentence)
    columns = user_columns(mapping)
    if not columns:
        return named
    pattern = "|".join(sorted(map(re.escape, columns), key=len, reverse=True))
    return re.sub(rf"(?<![\w'])({pattern})(?!\w)", lambda match: f"'{columns[match[1]]}'", named)


def user_columns(mapping: Mapping) -> dict[str, str]:
    """Column of a recording -> header of the column that it is read from, as far as it is one column."""
    names_by_target = {target: name for name, target in mapping.columns.items()}
    if mapping.joints is not None:
        for number, name in enumerate(mapping.joints.columns, 1):
            names_by_target |= {f"q{number}_deg": name, f"q{number}_mm": name}
    for group, prefix in ((mapping.point, ""), (mapping.flange_point, "flange_")):
        if group is not None and not is_spherical(group.convention):
            names_by_target |= {
                f"{prefix}{axis}_mm": name for axis, name in zip("xyz", group.columns)
            }
    for group, prefix in ((mapping.rotation, ""), (mapping.flange_rotation, "flange_")):
        if group is not None and (group.convention or "").startswith(_QUATERNION):
            letters = group.convention.removeprefix(_QUATERNION)
            names_by_target |= {
                f"{prefix}q{axis}": name for axis, name in zip(letters, group.columns)
            }
    return names_by_target
