"""Page of a diagnosis: the measuring chain, the findings, their evidence, and the summary image."""
