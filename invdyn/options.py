"""Options that commands share, each declared once."""

from pathlib import Path
from typing import Annotated

import typer

from .settings import Setting, yes

MAX_SEED = 2**63 - 1  # what torch and netCDF can hold
MAX_WORKERS = 1024  # processes


def present_names(methods: str) -> str:
    """Names of methods, of a renamed one the new name: `compare --out` has a file of each."""
    from invdyn.inference.renamed_methods import present_name

    return ",".join(present_name(name.strip()) for name in methods.split(","))


BodyFile = Annotated[
    str,
    typer.Option("--body", metavar="FILE", help="Body: .toml, .xml (MJCF), .urdf, .osim, or the name of one of ours."),
]
Units = Annotated[str | None, typer.Option(help="Units of the file: px, mm, cm, m; deg, rad; s, ms, us …, frames.")]
FrameRate = Annotated[float | None, typer.Option("--fps", help="Frames a second, if the file has no times.")]
Frames = Annotated[str, typer.Option(help="Rows to use of the first recording, such as 50:250.")]
Mapping = Annotated[
    str | None, typer.Option("--map", metavar="FILE", help="Which track of a robot's log is which joint's: .toml.")
]
Calibration = Annotated[
    list[Path] | None,
    typer.Option(help="The cameras' calibration: .toml, .qca.txt (Qualisys), .yml or .json (OpenCV; repeatable)."),
]
Offset = Annotated[
    list[str] | None, Setting("how far a camera's clock is ahead, s: offset=cam2=0.02; repeatable", repeatable=True)
]
HideTorque = Annotated[bool, Setting("yes: ignore the recording's commands; default: no", yes)]
Tracker = Annotated[
    str | None,
    typer.Option(help="What tracks a film: the left or right arm of a person, or a network of `invdyn train`."),
]
ZeroTorque = Annotated[bool, typer.Option("--zero-torque", help="No torque acts: the body moves freely.")]
Method = Annotated[str, typer.Option(callback=present_names, help="Inference method; an unknown name lists them all.")]
Methods = Annotated[
    str, typer.Option(callback=present_names, help="Such as smc,bootstrap; an unknown name lists them all.")
]
Replicates = Annotated[int, typer.Option(min=1, help="Runs of each method, with different seeds.")]
Isolate = Annotated[bool, Setting("yes: each method in a process of its own, so that its memory is measured", yes)]
Filters = Annotated[int, typer.Option(min=1, help="Independent filters.")]
Particles = Annotated[int, typer.Option(min=1, help="Particles of each filter.")]
Workers = Annotated[
    str | None, typer.Option(help="Processes that share the filters; or a Dask scheduler (tcp://host:8786), or mpi.")
]
Processes = Annotated[
    int,
    typer.Option(
        "--workers", min=1, max=MAX_WORKERS, help="Processes, with the same result (on Linux; one elsewhere)."
    ),
]
Seed = Annotated[int, typer.Option(min=0, max=MAX_SEED, help="Same seed, same result.")]
Checkpoint = Annotated[
    Path | None, typer.Option(help="Folder that keeps what is done; the same call continues from there.")
]
Outputs = Annotated[
    list[Path] | None,
    typer.Option(
        "--out",
        metavar="FILE",
        help="What to write, by its ending; repeatable: .nc (the posterior, ArviZ), .png, .pdf or .svg "
        "(figure), .gif or .mp4 (film of the arm), .csv (curves with 90 % bands), functionals.csv (peaks, "
        "impulses, work), .sto (torques for OpenSim), .nwb (torques and keypoints), .mot (angles for OpenSim).",
    ),
]
FolderOut = Annotated[Path, typer.Option("--out", metavar="FOLDER", help="Folder for all of it; made if missing.")]

Person = Annotated[
    str | None, Setting("which of several people in a film: left, right, largest, or a box u,v,width,height, px")
]
Individual = Annotated[str | None, Setting("which animal, in a file of several")]
FileFormat = Annotated[str | None, Setting("format of the file, if its name does not say")]
Device = Annotated[str, Setting("where particle filters compute: cpu or cuda")]
