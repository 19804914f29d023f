"""Several cameras at one scene: calibrations read and written, pixels to points in space, poses adjusted."""

from .boards import Board
from .bundle import Adjusted, bundle_adjust
from .calibrate import calibrate
from .camera import Calibration, Camera
from .filmed import Filmed, filmed, load_filmed
from .formats import read_calibration
from .projection import project, rays, undistort
from .reprojection import reprojection
from .scene import Length, Scene, reconstruct
from .synchronise import Clock, find_offsets
from .toml_cameras import write_calibration
from .triangulate import Triangulated, triangulate
from .views import Views, at_one_time, match_names, put_in_order, read_tracks, sides_kept

__all__ = [
    "Adjusted",
    "Board",
    "Calibration",
    "Camera",
    "Clock",
    "Filmed",
    "Length",
    "Scene",
    "Triangulated",
    "Views",
    "at_one_time",
    "bundle_adjust",
    "calibrate",
    "filmed",
    "find_offsets",
    "load_filmed",
    "match_names",
    "project",
    "put_in_order",
    "rays",
    "read_calibration",
    "read_tracks",
    "reconstruct",
    "reprojection",
    "sides_kept",
    "triangulate",
    "undistort",
    "write_calibration",
]
