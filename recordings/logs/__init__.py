"""Logs of robots: tables, LeRobot data sets, ROS 2 bags and MCAP files, as tracks of numbers that a mapping names."""

from .mapping import JointMap, LogMap
from .read import LOG_FORMATS, read_log, recordings_of
from .tracks import Episode, Track

__all__ = ["LOG_FORMATS", "Episode", "JointMap", "LogMap", "Track", "read_log", "recordings_of"]
