"""The answer of a diagnosis: verdict, sentences, what the data could have shown, and the next experiment.

`answer.diagnose` lets the engine, `workbench.diagnosis`, search and prove, and makes a `result.Diagnosis` of it:
`words` are its sentences, `unexplained` the structure that no term explains, `minimal_detectable_bias` the smallest
sizes that the data would have shown, `planning` the next experiment,
`reference` and `differences` the comparison with a simulation or an earlier solution, `stated_noise` and `replicates`
the noise, `files` and `corrected_model` what is written.
"""
