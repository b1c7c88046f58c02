"""The sentence on noise that is correlated from pose to pose."""

from workbench.diagnosis.noise.serial_correlation import SerialCorrelation


def correlated_noise(noise: SerialCorrelation, is_unknown: bool = False) -> str:
    """State what a reader should know of correlated noise. is_unknown: nothing says how large the noise is."""
    found = f"correlated from pose to pose ({noise.value:.2f} ± {noise.std:.2f})"
    growth = f"up to {noise.design_effect**0.5:.1f} times as large as stated"
    if is_unknown:
        return (
            f"What remains is {found}. The noise is unknown, so that nothing distinguishes slow noise from an effect "
            f"that the catalogue does not describe. The uncertainty of slow effects is {growth}. Measure some poses "
            "again at other times."
        )
    return (
        f"The noise is {found}, which the recording does not state. The uncertainty of slow effects is {growth}. "
        "Let instrument and arm warm up, or measure the poses in a random order."
    )


__all__ = ["correlated_noise"]
