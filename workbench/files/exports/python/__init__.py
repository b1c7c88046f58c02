"""A calibrated arm as one Python module that needs numpy alone.

`runtime` computes flange poses and corrected joint readings from plain data. `bundle` collects the source of all that
it calls (kinematics, statics, the effects of this arm) into one text. `module` joins both with the arm's values.
"""

from workbench.files.exports.python.module import python_module

__all__ = ["python_module"]
