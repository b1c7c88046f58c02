"""The option --trust-data: how a refusal names it, and how a warning says that it was used."""

TRUST_DATA = "--trust-data"


def naming_option(sentence: str) -> str:
    """The sentence of a refusal with the way to calibrate all the same."""
    return (
        f"{sentence.removesuffix('.')}; if the recorded data are right, repeat with {TRUST_DATA}."
    )


def accepted_by_option(sentence: str) -> str:
    """The sentence of a finding that would have been a refusal, as a warning."""
    return f"{sentence.removesuffix('.')}; accepted because of {TRUST_DATA}."
