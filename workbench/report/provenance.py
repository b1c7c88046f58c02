"""Provenance of the numbers: data, source, versions, seed, command."""

from collections.abc import Mapping

_WORDS = {
    "data_sha256": "SHA-256 of the data",
    "data_source": "source of the data",
    "data_licence": "licence of the data",
}


def section(calibration) -> dict:
    """Lines of the table; those of the recording come first."""
    recording = calibration.recording
    lines = [
        ("recording", recording.name or "–"),
        ("measures", recording.measures),
        ("samples used", f"{recording.n:,} in {len(set(recording.poses.tolist())):,} poses"),
        ("robot", calibration.robot.name),
        ("source of the nominal robot", calibration.robot.source),
    ]
    names = {name for name, _ in lines}
    lines += [line for line in flat(calibration.provenance) if line[0] not in names]
    return {"lines": [(name, words) for name, words in lines if words]}


def flat(table: Mapping, prefix: str = "") -> list[tuple[str, str]]:
    """Nested tables as lines; a list is joined with spaces."""
    lines = []
    for key, value in table.items():
        name = f"{prefix}{_WORDS.get(key, str(key).replace('_', ' '))}"
        if isinstance(value, Mapping):
            lines += flat(value, name + ": ")
        else:
            if isinstance(value, list | tuple):
                joined = " ".join(map(str, value))
            else:
                joined = value
            lines.append((name, "" if joined is None else str(joined)))
    return lines
