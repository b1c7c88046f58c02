"""Lists of the combinations of parameters that are not identifiable, for the terminal and the report page."""

from collections.abc import Mapping, Sequence


def confounded_lists(stages: Sequence[Mapping]) -> list[tuple[str, list[str]]]:
    """Titles with their sentences: those of any poses and those of the recorded poses, each at its first stage.

    stages: of the answer of `workbench identifiability`.
    """
    lists = []
    listed: set[str] = set()
    for stage in stages:
        for title, sentences in _lists_of_stage(stage):
            new_sentences = [text for text in sentences if text not in listed]
            listed.update(new_sentences)
            if new_sentences:
                lists.append((title, new_sentences))
    return lists


def _lists_of_stage(stage: Mapping) -> list[tuple[str, list[str]]]:
    """All sentences of a stage: of any poses, and of the recorded poses alone."""
    in_any_poses = stage["undetermined_in_any_poses"]
    in_these_poses = [text for text in stage["undetermined"] if text not in in_any_poses]
    name = stage["name"]
    return [
        (f"in any poses, with {name}", in_any_poses),
        (f"in these poses, with {name}", in_these_poses),
    ]
