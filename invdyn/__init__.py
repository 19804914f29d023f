"""invdyn: joint torques, with their uncertainty, from the keypoints that a camera tracks."""

import os
from pathlib import Path

# Threads that wait must sleep: spinning, they halve the speed of all other work on a shared machine, and of ours.
# OpenMP reads this when torch is loaded, so it has no effect where torch came first.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

ROOMS = ("recordings", "models", "inference", "diagnosis", "blindcheck")

if _missing := [room for room in ROOMS if not (Path(__file__).parent / room).is_dir()]:
    # A checkout without symbolic links has short text files in their place, and what is installed from it has nothing.
    raise ImportError(
        f"invdyn/{_missing[0]} should be a link to ../{_missing[0]}, but this checkout has no symbolic links: "
        "set 'git config core.symlinks true' and check out again, or install the wheel"
    )
