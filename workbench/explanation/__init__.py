"""The answer of a diagnosis: verdict, sentences, detectable sizes, and the next experiment.

`answer.diagnose` lets the engine, `workbench.diagnosis`, search and validate, and makes a `result.Diagnosis` of it:
`sentences` are its texts, `unexplained` the structure that no term explains, `minimal_detectable_bias` the smallest
detectable sizes, `planning` the next experiment, `comparison` the differences from a simulation or an earlier solution,
`noise` the noise of the recording, and `output` the files that are written.
"""
