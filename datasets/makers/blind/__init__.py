"""The maker of concealed cases: recordings in which a known effect is hidden, and the sealed truth of it.

It shares no physics and no code with `robot_model`, `sensors` and `workbench.core`: MuJoCo's
statics, the maker's own drives, and its own numerical baseline. `case.draw` makes a case of a suite from a
seed, `writing` puts recording and truth into separate places. Needs the package `mujoco` (extra `proof`).

`images` makes the cases of the suite "sensor" from rendered images, with the same functions as `case` and
`writing`: `draw`, `recording`, `truth`, `salt`.
"""
