"""The bench of a scanner: images of boards and balls, from which camera, laser and mirror are diagnosed.

`sensor` solves baseline and effects; `sensor_data` reads corners and stripes, `sensor_scans`
scans of balls; `sensor_library` lists the effects, `sensor_linear` makes their columns; `sensor_review` compares
confounded effects in full.
"""
