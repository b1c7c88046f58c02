"""Importers: from files of other programs to the columns of a recording.

`sources` reads a file or folder into plain tables, images, clouds and a board, without any interpretation. `mapping`
proposes from the header words which column is which quantity, joins tables, and converts units and rotations. Which
unit and which rotation convention fits the robot is tested in `workbench`, because datasets knows no kinematics.
"""

from datasets.importers.source import ImageFile, RawTable, Source

__all__ = ["ImageFile", "RawTable", "Source"]
