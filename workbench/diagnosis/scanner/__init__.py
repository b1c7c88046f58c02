"""The bench of a scanner: images of boards and balls, from which camera, laser and mirror are diagnosed.

`sensor` solves baseline and effects on the chains that `workbench.jobs.sensor.chains` reads from images;
`sensor_covariates` describes the samples, `sensor_library` lists the effects, `sensor_linear` makes their columns;
`sensor_review` compares confounded effects in full.
"""
