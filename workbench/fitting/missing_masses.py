"""Whether a plan has elastic terms under the weight of links whose masses nobody states."""

from collections.abc import Sequence

from robot_model.effects.elastic import JointCompliance
from robot_model.effects.unknown_masses import GravityCompliance
from robot_model.state import State
from workbench.core.solution import Stage

_NAME = JointCompliance.effect


def missing_mass_warnings(stages: Sequence[Stage], state: State) -> tuple[str, ...]:
    """A sentence if a plan names joint-compliance, and neither links nor load of the arm have a mass."""
    planned = {name for stage in stages for name, _, _ in stage.effects}
    if _NAME not in planned or state.has_masses:
        return ()
    return (
        f"The robot has no masses and the recording no payload_kg: {_NAME} has no effect, and nothing is estimated "
        f"for it. Use {GravityCompliance.effect}, which needs no masses, or state mass_kg and com_mm of the links.",
    )
