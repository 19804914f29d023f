"""The command line: `invdyn simulate | check | infer | compare | diagnose | blind | plot | demo`; cameras, films.

Each command checks, then works, then writes.
"""

from pathlib import Path
from typing import Annotated

import typer

from . import blind_commands, camera_commands, film_commands, model_commands, robot_commands
from .console import Commands, ProgressBar, check_ending, check_outputs, say
from .diagnosis_options import Diagnosed
from .film_commands import ArmSide, Kept, NetworkFile, PersonSeen
from .inference_options import Inference
from .model_commands import Isolate, Replicates
from .options import BodyFile, Seed, with_option_groups

# What needs torch or matplotlib is imported inside the commands: `invdyn --help` answers at once.

app = typer.Typer(
    cls=Commands,
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)

camera_commands.register(app)
robot_commands.register(app)
film_commands.register(app)
model_commands.register(app)

FigureOut = Annotated[Path | None, typer.Option(help="Figure: .png, .pdf or .svg.")]
FilmOut = Annotated[Path | None, typer.Option(help="Film of the arm: .gif or .mp4.")]
StoOut = Annotated[Path | None, typer.Option(help="Torques for OpenSim: .sto.")]
MotOut = Annotated[Path | None, typer.Option(help="Angles for OpenSim: .mot.")]
CsvOut = Annotated[Path | None, typer.Option(help="Torques, angles and velocities with 90 % bands: .csv.")]


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
    encoders: Annotated[
        float | None, typer.Option(min=1e-9, help="Record encoders too, with this standard deviation, rad.")
    ] = None,
    torque_scale: Annotated[
        float | None,
        typer.Option(min=0, help="Standard deviation of the torques, N·m; default: by the body."),
    ] = None,
    commanded: Annotated[bool, typer.Option("--commanded", help="The torques are known commands.")] = False,
    seed: Seed = 0,
) -> None:
    """Make a recording with known truth."""
    from invdyn.recordings import whole_set, write_keypoint_csv, write_truth

    from .inputs import load_body
    from .simulate import random_arm, record

    check_outputs([out, truth], [Path(body)])
    check_ending("a recording", out, ".csv")
    check_ending("a truth", truth, ".csv")
    model = random_arm(
        load_body(body),
        duration=duration,
        fps=fps,
        noise=noise,
        encoder_noise=encoders,
        torque_scale=torque_scale,
        commanded=commanded,
        seed=seed,
    )
    recording, states = record(model, seed, out.stem)
    with whole_set():
        write_keypoint_csv(recording, out)
        if truth is not None:
            write_truth(states, truth)
    say(f"recording  {out}")
    if truth is not None:
        say(f"truth      {truth}")


@app.command()
@with_option_groups
def infer(
    given: Inference,
    out: Annotated[Path, typer.Option(help="The posterior: .nc (netCDF, ArviZ).")],
    method: Annotated[str, typer.Option(help="Inference method; an unknown name lists them all.")] = "smc",
    kinematic: Annotated[
        bool, typer.Option("--kinematic", help="Motion and lengths alone: no forces, no masses; smc or laplace.")
    ] = False,
    figure: FigureOut = None,
    film: FilmOut = None,
    sto: StoOut = None,
    mot: MotOut = None,
    csv: CsvOut = None,
    checkpoint: Kept = None,
    network: NetworkFile = None,
    arm: ArmSide = None,
    person: PersonSeen = None,
    tracks: Annotated[
        Path | None, typer.Option(help="Where a film's tracks go: .csv; default: beside the posterior.")
    ] = None,
) -> None:
    """Infer the torques that moved a recorded body; a film is tracked first, with --network or --arm."""
    given.check_exist()

    from invdyn.inference import infer as run
    from invdyn.inference import infer_kinematics

    from .inputs_from_film import TrackedFilm
    from .outputs import Outputs
    from .summary import summary_text

    given.check(method)
    if kinematic:
        given.check_kinematic(sto=sto, checkpoint=checkpoint)
    outputs = Outputs(posterior=out, figure=figure, film=film, sto=sto, mot=mot, csv=csv)
    filmed = TrackedFilm.of(given, network, arm, person, tracks or out.parent / f"{out.stem}.tracks.csv")
    outputs.check(*given.files, *([] if filmed is None else filmed.files))
    if filmed is not None:
        check_outputs([*outputs.paths, filmed.tracks], [*given.files, *filmed.files])
        check_ending("a file of tracks", filmed.tracks, ".csv")
        with ProgressBar() as progress:
            given = filmed.track(checkpoint, progress)
    arguments = given.load()
    with given.executor() as executor, ProgressBar() as progress:
        if kinematic:
            idata = infer_kinematics(**given.kinematic(arguments), method=method, progress=progress)
        else:
            idata = run(**arguments, method=method, progress=progress, executor=executor, checkpoint=checkpoint)
        outputs.write(idata, progress, None if filmed is None else filmed.overlay)
    say(summary_text(idata))
    say(outputs.listing() + ("" if filmed is None else f"\n{'tracks':<10} {filmed.tracks}"))


@app.command()
@with_option_groups
def compare(
    given: Inference,
    methods: Annotated[str, typer.Option(help="Such as smc,bootstrap; the answer to an unknown one lists them all.")],
    out: Annotated[Path, typer.Option(help="Folder for table, figure and posteriors; made when missing.")],
    held_out: Annotated[
        float, typer.Option(min=0, max=0.9, help="Share of the frames, the last ones, to predict; 0 for none.")
    ] = 0.2,
    replicates: Replicates = 1,
    isolate: Isolate = False,
    checkpoint: Kept = None,
) -> None:
    """Run several methods on one recording: one table, one figure.

    On a model of your own: `invdyn compare model.py:Model rows.csv`, with the options of `compare-model`.
    """
    given.check_exist()

    from invdyn.inference import compare as run

    from .outputs import ComparisonOutputs
    from .summary import comparison_text

    names = tuple(dict.fromkeys(name.strip() for name in methods.split(",")))
    given.check(*names)
    outputs = ComparisonOutputs(out, names)
    outputs.check(*given.files)
    arguments = given.load()
    with given.executor() as executor, ProgressBar() as progress:
        comparison = run(
            **arguments,
            methods=names,
            held_out=held_out,
            replicates=replicates,
            isolate=isolate,
            progress=progress,
            executor=executor,
            checkpoint=checkpoint,
        )
    outputs.write(comparison)
    say(comparison_text(comparison))
    say(outputs.listing(comparison))


@app.command()
@with_option_groups
def diagnose(
    given: Diagnosed,
    out: Annotated[Path, typer.Option(help="Folder for report, JSON and posterior; made when missing.")],
    write_back: Annotated[
        Path | None, typer.Option(help="Corrected copy of the body's file: .xml (MJCF), .urdf or .toml.")
    ] = None,
    checkpoint: Kept = None,
    network: NetworkFile = None,
    arm: ArmSide = None,
    person: PersonSeen = None,
    tracks: Annotated[
        Path | None, typer.Option(help="Where a film's tracks go: .csv; default: beside the folder.")
    ] = None,
) -> None:
    """Find where simulation and recording part, which effect causes it, and how far the gap closes.

    A film is tracked first, with --network or --arm.
    """
    given.check_exist()

    from invdyn.diagnosis.diagnose import diagnose as run
    from invdyn.diagnosis.diagnose import save
    from invdyn.diagnosis.report.sentences import details, verdict
    from invdyn.diagnosis.write_back.write_back import check_write_back
    from invdyn.diagnosis.write_back.write_back import write_back as corrected
    from invdyn.recordings import new_folder, whole_set

    from .inputs_from_film import TrackedFilm
    from .outputs import DiagnosisOutputs

    given.check()
    outputs = DiagnosisOutputs(out)
    filmed = TrackedFilm.of(given, network, arm, person, tracks or out.parent / f"{out.name}.tracks.csv")
    files = [*given.files, *([] if filmed is None else filmed.files)]
    outputs.check(*files)
    if write_back is not None:
        check_outputs([write_back], files)
        check_write_back(given.body, write_back)
    if filmed is not None:
        check_outputs([filmed.tracks, write_back], files)
        check_ending("a file of tracks", filmed.tracks, ".csv")
        with ProgressBar() as progress:
            given = filmed.track(checkpoint, progress)
    arguments = given.load()
    with ProgressBar() as progress:
        diagnosis = run(**arguments, progress=progress, checkpoint=checkpoint)
    with new_folder(out), whole_set():
        if write_back is not None:
            held_out, recordings = arguments["held_out"], arguments["recording"]
            shown = held_out or (recordings[0] if isinstance(recordings, list) else recordings)
            diagnosis = corrected(diagnosis, given.body, arguments["body"], write_back, shown, held_out is not None)
        save(diagnosis, out, workers=arguments["workers"])
    say(verdict(diagnosis))
    for sentence in details(diagnosis):
        say(sentence)
    say(outputs.listing() + ("" if filmed is None else f"\n{'tracks':<10} {filmed.tracks}"))


blind_commands.register(app)


@app.command()
def plot(
    posterior: Annotated[Path, typer.Argument(help="A posterior that `invdyn infer` saved: .nc.")],
    out: FigureOut = None,
    film: FilmOut = None,
    sto: StoOut = None,
    mot: MotOut = None,
    csv: CsvOut = None,
) -> None:
    """Draw a saved posterior, or export its torques."""
    from invdyn.inference import load_posterior

    from .outputs import Outputs
    from .summary import summary_text

    outputs = Outputs(figure=out, film=film, sto=sto, mot=mot, csv=csv)
    outputs.check(posterior)
    idata = load_posterior(posterior)
    with ProgressBar() as progress:
        outputs.write(idata, progress)
    say(summary_text(idata))
    say(outputs.listing())


@app.command()
def demo(
    out: Annotated[Path, typer.Option(help="Folder for all of it; made when missing.")] = Path("demo"),
    seed: Seed = 0,
) -> None:
    """Simulate an arm, infer its torques, draw them."""
    from invdyn.inference import infer as run
    from invdyn.models import Body
    from invdyn.recordings import new_folder, whole_set, write_keypoint_csv, write_truth

    from .inputs import load_body
    from .outputs import Outputs, check_folder
    from .simulate import PAPER, paper_arm, record
    from .summary import summary_text

    check_folder(out, [], [])
    arm = load_body("paper_planar_arm")
    assert isinstance(arm, Body)  # as its file says
    recording, truth = record(paper_arm(arm), seed, "planar arm")
    outputs = Outputs(
        out / "posterior.nc", out / "figure.png", out / "film.gif", out / "torques.sto", csv=out / "torques.csv"
    )
    arm_file, recording_file, truth_file = out / "arm.toml", out / "recording.csv", out / "truth.csv"
    with new_folder(out), ProgressBar() as progress:
        outputs.check()
        check_outputs([arm_file, recording_file, truth_file])
        idata = run(recording, arm, truth=truth, seed=seed, progress=progress, **PAPER)
        with whole_set():
            arm.to_toml(arm_file)
            write_keypoint_csv(recording, recording_file)
            write_truth(truth, truth_file)
            outputs.write(idata, progress)
    say(summary_text(idata))
    say(outputs.listing())
    say(f"{'input':<10} {recording_file}, {truth_file}, {arm_file}")
    say(
        f"\nA recording of your own, the same way:\n  invdyn infer {recording_file} --body {arm_file} "
        "--out posterior.nc --figure figure.png"
    )
