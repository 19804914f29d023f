"""invdyn: joint torques, with their uncertainty, from the keypoints that a camera tracks."""

from pathlib import Path

ROOMS = ("recordings", "models", "inference", "diagnosis", "blindcheck")

if _plain := [room for room in ROOMS if (Path(__file__).parent / room).is_file()]:
    # A checkout without symbolic links has short text files in their place.
    raise ImportError(
        f"invdyn/{_plain[0]} should be a link to ../{_plain[0]}, but this checkout has no symbolic links; "
        "set 'git config core.symlinks true' and check out again, or install the wheel"
    )
