"""Several cameras at one scene: calibrations read and written, pixels to points in space, poses adjusted."""

from .boards import Board
from .bundle import Adjusted, bundle_adjust
from .calibrate import calibrate
from .camera import Calibration, Camera
from .camera_tables import write_calibration
from .formats import read_calibration
from .projection import project, rays, undistort
from .reprojection import reprojection
from .scene import Length, Scene, reconstruct
from .triangulate import Triangulated, triangulate
from .views import Views, match_names, read_views

__all__ = [
    "Adjusted",
    "Board",
    "Calibration",
    "Camera",
    "Length",
    "Scene",
    "Triangulated",
    "Views",
    "bundle_adjust",
    "calibrate",
    "match_names",
    "project",
    "rays",
    "read_calibration",
    "read_views",
    "reconstruct",
    "reprojection",
    "triangulate",
    "undistort",
    "write_calibration",
]
