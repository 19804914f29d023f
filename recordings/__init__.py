"""Keypoint tracks in, results out: formats, units, named real recordings."""

from .atomic import atomic_path, check_writable, write_text
from .catalogue import demo_frames, load_truth, names
from .encoders import keypoints_from_angles
from .errors import InputError
from .formats import FORMATS, Format
from .joined import joined
from .keypoint_csv import read_keypoint_csv, write_keypoint_csv
from .loader import load
from .opensim import read_sto, read_trc, write_moments, write_sto
from .pace import bridged
from .paths import check_readable, resolved
from .plausible import check_plausible
from .recording import Recording
from .tables import read_table, write_table
from .truth import Truth, read_truth, write_truth
from .units import in_body_lengths, median_link_lengths, parse_units

__all__ = [
    "FORMATS",
    "Format",
    "InputError",
    "Recording",
    "Truth",
    "atomic_path",
    "bridged",
    "check_plausible",
    "check_readable",
    "check_writable",
    "demo_frames",
    "in_body_lengths",
    "joined",
    "keypoints_from_angles",
    "load",
    "load_truth",
    "median_link_lengths",
    "names",
    "parse_units",
    "read_keypoint_csv",
    "read_sto",
    "read_table",
    "read_trc",
    "read_truth",
    "resolved",
    "write_keypoint_csv",
    "write_moments",
    "write_sto",
    "write_table",
    "write_text",
    "write_truth",
]
