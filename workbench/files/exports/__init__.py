"""One file each kind of export: a calibrated arm or camera in the formats of other programs, and read back."""

from workbench.files.exports.camera import CAMERA_FORMATS, camera_text, read_camera_text
from workbench.files.exports.mdh import mdh_csv, mdh_json, read_mdh
from workbench.files.exports.urdf import urdf

__all__ = [
    "CAMERA_FORMATS",
    "camera_text",
    "mdh_csv",
    "mdh_json",
    "read_camera_text",
    "read_mdh",
    "urdf",
]
