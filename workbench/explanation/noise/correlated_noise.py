"""The sentence on noise that is correlated from pose to pose."""

from workbench.diagnosis.noise.serial_correlation import SerialCorrelation


def correlated_noise(noise: SerialCorrelation) -> str:
    """State what a reader should know of correlated noise."""
    return (
        f"The noise is correlated from pose to pose ({noise.value:.2f} ± {noise.std:.2f}), which the recording does "
        f"not state. The uncertainty of slow effects is up to {noise.design_effect**0.5:.1f} times as large as stated. "
        "Let instrument and arm warm up, or measure the poses in a random order."
    )


__all__ = ["correlated_noise"]
