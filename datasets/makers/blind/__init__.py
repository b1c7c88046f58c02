"""Generator of blind cases: recordings with a planted effect, and their truths.

It shares no physics and no code with `robot_model`, `sensors` and `workbench.core`: it uses MuJoCo
statics, independent drive models, and an independent numerical baseline. `case.draw` creates a case of a suite from a
seed; `writing` writes recording and truth to separate folders. Needs the package `mujoco` (extra `proof`).

`images` creates the cases of the suite "sensor" from rendered images, with the same functions as `case` and
`writing`: `draw`, `recording`, `truth`, `salt`.
"""
