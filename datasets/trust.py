"""The option --trust-data in the texts of refusals and warnings."""

TRUST_DATA = "--trust-data"


def naming_option(sentence: str) -> str:
    """The text of a refusal, with the option that accepts the data."""
    return (
        f"{sentence.removesuffix('.')}; if the recorded data are right, repeat with {TRUST_DATA}."
    )


def accepted_by_option(sentence: str) -> str:
    """The sentence of a finding that would have been a refusal, as a warning."""
    return f"{sentence.removesuffix('.')}; accepted because of {TRUST_DATA}."
