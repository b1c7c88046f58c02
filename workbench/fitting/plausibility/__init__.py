"""Is a recording plausible? Mistakes in columns, rows, labels, units and robot file, named where possible.

Order of the work: stated values that cannot be right (`stated_values`), one robust fit with plausible geometry
errors (`fitting`), structure in its residuals (`rows`: outlying rows, change points; `joint_columns`: rounding), and
where the fit is bad, a search over corrections of the data and of the robot file (`search`, `robot_files`). Where it is
good but above the noise, single corrections of joint columns are tested (`joint_columns.small_mistakes`).
"""

from workbench.fitting.plausibility.check import check_plausibility
from workbench.fitting.plausibility.suspicion import Suspicion

__all__ = ["Suspicion", "check_plausibility"]
