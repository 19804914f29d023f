"""The command line: `invdyn simulate | infer | plot | demo`. Each command checks, then works, then writes."""

from pathlib import Path
from typing import Annotated

import typer

from .console import Commands, ProgressBar, check_outputs

# What needs torch or matplotlib is imported inside the commands: `invdyn --help` answers at once.

app = typer.Typer(
    cls=Commands,
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)

BodyFile = Annotated[str, typer.Option("--body", metavar="TOML", help="Body file, or a body that comes with us.")]
Seed = Annotated[int, typer.Option(min=0, help="Same seed, same result.")]
FigureOut = Annotated[Path | None, typer.Option(help="Figure: .png, .pdf or .svg.")]
FilmOut = Annotated[Path | None, typer.Option(help="Film of the arm: .gif or .mp4.")]
StoOut = Annotated[Path | None, typer.Option(help="Torques for OpenSim: .sto.")]
CsvOut = Annotated[Path | None, typer.Option(help="Torques, angles and velocities with 90 % bands: .csv.")]
TruthFile = Annotated[str | None, typer.Option(help="Torques to compare with: .csv, or a known recording's name.")]


def show_version(wanted: bool) -> None:
    """Print the version and leave, if wanted."""
    if wanted:
        from importlib.metadata import version

        typer.echo(f"invdyn {version('invdyn')}")
        raise typer.Exit()


@app.callback()
def options(
    version: Annotated[
        bool, typer.Option("--version", callback=show_version, is_eager=True, help="Show the version.")
    ] = False,
) -> None:
    """Joint torques, with their uncertainty, from the keypoints that a camera tracks."""


@app.command()
def simulate(
    body: BodyFile,
    out: Annotated[Path, typer.Option(help="The recording: .csv.")],
    truth: Annotated[Path | None, typer.Option(help="Its true torques, angles and velocities: .csv.")] = None,
    duration: Annotated[float, typer.Option(min=0, help="s.")] = 6.0,
    fps: Annotated[float, typer.Option(min=0.1, help="Frames a second.")] = 30.0,
    noise: Annotated[float, typer.Option(min=1e-9, help="Standard deviation of a keypoint, m.")] = 0.005,
    torque_scale: Annotated[
        float | None,
        typer.Option(min=0, help="Standard deviation of the torques, N·m; default: by the body."),
    ] = None,
    commanded: Annotated[bool, typer.Option("--commanded", help="The torques are known commands.")] = False,
    seed: Seed = 0,
) -> None:
    """Make a recording with known truth."""
    from invdyn.recordings import write_keypoint_csv, write_truth

    from .inputs import load_body
    from .simulate import random_arm, record

    check_outputs([out, truth], [Path(body)])
    model = random_arm(
        load_body(body),
        duration=duration,
        fps=fps,
        noise=noise,
        torque_scale=torque_scale,
        commanded=commanded,
        seed=seed,
    )
    recording, states = record(model, seed, out.stem)
    write_keypoint_csv(recording, out)
    typer.echo(f"recording  {out}")
    if truth is not None:
        write_truth(states, truth)
        typer.echo(f"truth      {truth}")


@app.command()
def infer(
    recording: Annotated[str, typer.Argument(help="File of keypoints, or the name of a known recording.")],
    body: BodyFile,
    out: Annotated[Path, typer.Option(help="The posterior: .nc (netCDF, ArviZ).")],
    method: Annotated[str, typer.Option(help="smc or bootstrap.")] = "smc",
    figure: FigureOut = None,
    film: FilmOut = None,
    sto: StoOut = None,
    csv: CsvOut = None,
    truth: TruthFile = None,
    units: Annotated[str | None, typer.Option(help="Of the file's numbers: px, mm, cm, m; deg, rad.")] = None,
    fps: Annotated[float | None, typer.Option(help="Frames a second, if the file does not say.")] = None,
    format: Annotated[str | None, typer.Option(help="Of the file, if it is not plain from it.")] = None,
    scale: Annotated[float | None, typer.Option(help="Metres a pixel.")] = None,
    body_lengths: Annotated[
        bool, typer.Option("--body-lengths", help="No scale known: divide by the body's own length.")
    ] = False,
    base: Annotated[
        str | None, typer.Option(help="Keypoint to subtract; default: the first joint's, where tracked.")
    ] = None,
    frames: Annotated[str, typer.Option(help="Which frames to use, such as 50:250.")] = ":",
    learn_lengths: Annotated[bool, typer.Option("--learn-lengths", help="Learn the links' lengths.")] = False,
    torque: Annotated[
        str,
        typer.Option(help="Torque process: ornstein_uhlenbeck, random_walk, matern32, matern52, recurrent."),
    ] = "ornstein_uhlenbeck",
    noise: Annotated[str, typer.Option(help="Observation noise: gaussian or student_t.")] = "gaussian",
    passive: Annotated[bool, typer.Option("--passive", help="No torque acts: the body moves freely.")] = False,
    hide_torque: Annotated[bool, typer.Option("--hide-torque", help="Ignore the recording's commands.")] = False,
    filters: Annotated[int, typer.Option(min=1, help="Independent filters.")] = 64,
    particles: Annotated[int, typer.Option(min=1, help="Particles of each.")] = 100,
    draws: Annotated[int, typer.Option(min=1, help="Trajectories drawn from each.")] = 4,
    seed: Seed = 0,
) -> None:
    """Infer the torques that moved a recorded body."""
    from invdyn.inference import METHODS
    from invdyn.inference import infer as run
    from invdyn.models import FAMILIES, TORQUE_PROCESSES
    from invdyn.recordings import InputError

    from .inputs import frame_range, load_body, load_known, load_recording
    from .outputs import Outputs
    from .summary import summary_text

    for what, given, known in (
        ("method", method, METHODS),
        ("torque process", torque, TORQUE_PROCESSES),
        ("noise", noise, FAMILIES),
    ):
        if given not in known:
            raise InputError(f"unknown {what} {given!r}: known are {', '.join(known)}")
    outputs = Outputs(posterior=out, figure=figure, film=film, sto=sto, csv=csv)
    outputs.check(*(Path(name) for name in (recording, body, truth) if name is not None))
    arm = load_body(body)
    tracks = load_recording(recording, arm, base, body_lengths, units=units, fps=fps, format=format, scale=scale)
    start, stop = frame_range(frames)
    tracks = tracks.select(start, stop)
    known = None if truth is None else load_known(truth, arm)
    with ProgressBar() as progress:
        idata = run(
            tracks,
            arm,
            method=method,
            num_filters=filters,
            num_particles=particles,
            num_draws=draws,
            seed=seed,
            learn_lengths=learn_lengths,
            truth=known,
            torque=TORQUE_PROCESSES[torque](),
            family=noise,
            passive=passive,
            hide_torque=hide_torque,
            progress=progress,
        )
        outputs.write(idata, progress)
    typer.echo(summary_text(idata))
    typer.echo(outputs.listing())


@app.command()
def plot(
    posterior: Annotated[Path, typer.Argument(help="A posterior that `invdyn infer` saved: .nc.")],
    out: FigureOut = None,
    film: FilmOut = None,
    sto: StoOut = None,
    csv: CsvOut = None,
) -> None:
    """Draw a saved posterior, or export its torques."""
    from invdyn.inference import load_posterior

    from .outputs import Outputs
    from .summary import summary_text

    outputs = Outputs(figure=out, film=film, sto=sto, csv=csv)
    outputs.check(posterior)
    idata = load_posterior(posterior)
    with ProgressBar() as progress:
        outputs.write(idata, progress)
    typer.echo(summary_text(idata))
    typer.echo(outputs.listing())


@app.command()
def demo(
    out: Annotated[Path, typer.Option(help="Folder for all of it; made when missing.")] = Path("demo"),
    seed: Seed = 0,
) -> None:
    """Simulate an arm, infer its torques, draw them."""
    from invdyn.inference import infer as run
    from invdyn.recordings import write_keypoint_csv, write_truth

    from .inputs import load_body
    from .outputs import Outputs
    from .simulate import PAPER, paper_arm, record
    from .summary import summary_text

    out.mkdir(parents=True, exist_ok=True)
    outputs = Outputs(
        out / "posterior.nc", out / "figure.png", out / "film.gif", out / "torques.sto", out / "torques.csv"
    )
    arm_file, recording_file, truth_file = out / "arm.toml", out / "recording.csv", out / "truth.csv"
    outputs.check()
    check_outputs([arm_file, recording_file, truth_file])
    arm = load_body("paper_planar_arm")
    recording, truth = record(paper_arm(arm), seed, "planar arm")
    arm.to_toml(arm_file)
    write_keypoint_csv(recording, recording_file)
    write_truth(truth, truth_file)
    with ProgressBar() as progress:
        idata = run(recording, arm, truth=truth, seed=seed, progress=progress, **PAPER)
        outputs.write(idata, progress)
    typer.echo(summary_text(idata))
    typer.echo(outputs.listing())
    typer.echo(f"{'input':<10} {recording_file}, {truth_file}, {arm_file}")
    typer.echo(
        f"\nA recording of your own, the same way:\n  invdyn infer {recording_file} --body {arm_file} "
        "--out posterior.nc --figure figure.png"
    )
