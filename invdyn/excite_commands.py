"""The command of motions to record next: `invdyn excite`."""

from pathlib import Path
from typing import Annotated

import typer

from .console import ProgressBar, check_ending, check_outputs, say
from .options import Seed
from .settings import Setting

ENDINGS = (".csv", ".yaml", ".parquet", ".json", ".png", ".pdf", ".svg")


def excite(
    robot: Annotated[str, typer.Argument(help="Robot: .xml (MJCF), .urdf, .toml, or one that comes with us.")],
    out: Annotated[
        list[Path],
        typer.Option(
            metavar="FILE",
            help="What to write, by its ending; repeatable: .csv (the motion), .yaml (ROS JointTrajectory), "
            ".parquet (LeRobot actions), .json (what it will tell), .png, .pdf or .svg (figure).",
        ),
    ],
    limits: Annotated[
        Path | None, typer.Option(help="Ranges, speeds and torques of joints, and space: .toml; default: the robot's.")
    ] = None,
    joints: Annotated[str | None, typer.Option(help="Joints that move, such as shoulder,elbow; default: all.")] = None,
    about: Annotated[
        str | None, typer.Option(help="Effects that it is to tell, such as coulomb_friction; default: all.")
    ] = None,
    diagnosis: Annotated[Path | None, typer.Option(help="A diagnosis.json: tell what it has left open.")] = None,
    seconds: Annotated[float, typer.Option(help="How long, s.")] = 20.0,
    seed: Seed = 0,
    noise: Annotated[
        float | None, Setting("noise of a torque, N·m; default: a fiftieth of each joint's load", float, least=1e-9)
    ] = None,
    starts: Annotated[int, Setting("searches from different random motions", int, least=1)] = 2,
) -> None:
    """Design the motion to record next.

    The most informative one within the robot's limits. It starts and ends at
    rest.
    """
    from .input_names import body_file, check_exist

    check_exist(body=robot)

    from invdyn.diagnosis import design_motion
    from invdyn.diagnosis.excite.open_questions import open_effects
    from invdyn.models import load_body
    from invdyn.recordings import InputError, whole_set

    from .excite_outputs import excitation_text, write_excitation

    inputs = [Path(robot), *(each for each in (limits, diagnosis) if each is not None)]
    check_outputs(out, inputs)
    for each in out:
        check_ending("an output", each, *ENDINGS)
    wanted = [] if about is None else [name.strip() for name in about.split(",")]
    if diagnosis is not None:
        rivals = open_effects(diagnosis)
        wanted += rivals
        if not rivals:
            raise InputError(f"{diagnosis}: nothing is open that a motion's torque tells: leave --diagnosis out")
    with ProgressBar() as progress, body_file(robot) as path:
        found = design_motion(
            load_body(path, filmed=False),
            path,
            limits=limits,
            joints=[] if joints is None else [name.strip() for name in joints.split(",")],
            about=wanted,
            seconds=seconds,
            noise=noise,
            starts=starts,
            seed=seed,
            report=lambda done, total: progress(done, total, "search"),
        )
    with whole_set():
        for each in out:
            write_excitation(found, each)
    say(excitation_text(found))
    for each in out:
        say(f"{'written':<10} {each}")
