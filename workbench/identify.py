"""What a recording can determine, before anything is trusted: `workbench identifiability`."""

from dataclasses import replace

from robot_model import load_robot
from robot_model.system import bind
from workbench.core.identifiability import identifiability as at
from workbench.core.model import Model
from workbench.core.solve import solve
from workbench.plans import FRAMES, default_plan
from workbench.calibrate import _stage_mask
