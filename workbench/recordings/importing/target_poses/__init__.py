"""Import of flange poses and of poses of a board or marker that another program measured (kind target-pose).

`layouts` names the columns of tables without headers; `readings` compares units, rotation conventions, place of the
camera and direction of the poses; `tables` makes the recording.
"""
