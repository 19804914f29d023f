"""The command line: `invdyn simulate | check | infer | compare | diagnose | blind | plot | view | demo`; films.

Each command checks, then works, then writes.
"""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer

from . import arviz_on_demand
from .blind_commands import blind
from .camera_commands import calibrate, triangulate
from .console import Commands, ProgressBar, check_ending, check_outputs, say
from .diagnosis_options import Diagnosed
from .excite_commands import excite
from .film_commands import label, track, train
from .inference_options import NONE, Inference, kinematic_arguments, open_workers
from .live_commands import live
from .model_commands import compare_model
from .options import FolderOut, Isolate, Method, Methods, Outputs, Replicates
from .recipes import Recipe
from .result_commands import plot, view
from .robot_commands import check
from .settings import GroupedCommand, Setting, with_settings
from .simulate_commands import demo, simulate
from .study_commands import trials

# What needs torch or matplotlib is imported inside the commands: `invdyn --help` answers at once.
arviz_on_demand.register()

app = typer.Typer(
    cls=Commands,
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 80},
)
command = partial(app.command, cls=GroupedCommand)


def show_version(wanted: bool) -> None:
    """Print the version and leave, if wanted."""
    if wanted:
        from importlib.metadata import version

        typer.echo(f"invdyn {version('invdyn')}")
        raise typer.Exit()


@app.callback()
def invdyn(
    version: Annotated[
        bool, typer.Option("--version", callback=show_version, is_eager=True, help="Show the version.")
    ] = False,
) -> None:
    """Joint torques, with their uncertainty, from the keypoints that a camera tracks."""


@command()
@with_settings
def infer(
    given: Inference,
    out: Outputs = None,
    recipe: Recipe = None,
    method: Method = "smc",
    engine: Annotated[
        str, Setting("dynamics: mujoco for contact, loops, tendons, muscles, or own; default: by the body's file")
    ] = "auto",
    drive: Annotated[
        str, Setting("what MuJoCo's engine infers: joints, actuators or wrench:BODY; default: muscles, else joints")
    ] = "auto",
) -> None:
    """Infer the torques that moved a recorded body.

    A film is tracked first, with --tracker.
    """
    given.check_exist()

    from invdyn import inference

    from .engine_input import engine_reasons, infer_by_engine
    from .outputs import OutputFiles
    from .summary import summary_text

    given.check(method, without_torque=True)
    kinematic = given.torque == NONE
    files = OutputFiles(tuple(out or ()))
    tracks = given.tracks_file(files.usual_tracks)
    files.check(*given.files, inferred=True, tracks=tracks, torques=not kinematic)
    if not kinematic and (reasons := engine_reasons(given, engine)) is not None:
        with open_workers(given.workers) as executor, ProgressBar() as progress:
            idata = infer_by_engine(given, method, drive, reasons, progress, executor)
            files.write(idata, progress)
        say(summary_text(idata))
        say(files.listing())
        return
    arguments = given.arguments
    run: Callable[..., Any] = inference.infer
    if kinematic:
        run = inference.infer_kinematics
        arguments = kinematic_arguments(arguments | {"executor": given.workers, "forces": given.forces})
    with ProgressBar() as progress:
        read, film = given.load(tracks=tracks, checkpoint=given.checkpoint, progress=progress)
    with open_workers(given.workers) as executor, ProgressBar() as progress:
        where = {} if kinematic else {"executor": executor}
        idata = run(**read, **arguments, **where, method=method, progress=progress)
        files.write(idata, progress, film)
    say(summary_text(idata))
    say(files.listing() + ("" if tracks is None else f"\n{'tracks':<10} {tracks}"))


@command()
@with_settings
def compare(
    given: Inference,
    methods: Methods,
    out: FolderOut,
    held_out: Annotated[
        float, typer.Option(min=0, max=0.9, help="Share of the frames, the last ones, to predict; 0 for none.")
    ] = 0.2,
    replicates: Replicates = 1,
    isolate: Isolate = False,
) -> None:
    """Run several methods on one recording.

    One table, one figure. On a model of your own: `invdyn compare model.py:Model rows.csv`, with the
    options of `compare-model`.
    """
    given.check_exist()

    from invdyn.inference import compare as run

    from .outputs import OutputFolder, write_comparison
    from .summary import comparison_text

    names = tuple(dict.fromkeys(name.strip() for name in methods.split(",")))
    given.check(*names)
    outputs = OutputFolder.of_comparison(out, names)
    tracks = given.tracks_file(out.with_name(f"{out.name}.tracks.csv"))
    outputs.check(*given.files)
    check_outputs([tracks], given.files)
    check_ending("a file of tracks", tracks, ".csv")
    with ProgressBar() as progress:
        read, _ = given.load(tracks=tracks, checkpoint=given.checkpoint, progress=progress)
    with open_workers(given.workers) as executor, ProgressBar() as progress:
        comparison = run(
            **read,
            **given.arguments,
            methods=names,
            held_out=held_out,
            replicates=replicates,
            isolate=isolate,
            progress=progress,
            executor=executor,
        )
    write_comparison(outputs, comparison)
    say(comparison_text(comparison))
    say(outputs.listing(comparison.failures))


@command()
@with_settings
def diagnose(
    given: Diagnosed,
    out: FolderOut,
    write_back: Annotated[
        Path | None, typer.Option(help="Corrected copy of the body's file: .xml (MJCF), .urdf or .toml.")
    ] = None,
    ensemble: Annotated[
        tuple[int, Path] | None,
        typer.Option(metavar="N DIR", help="N copies drawn from the posterior, and ranges to randomise in."),
    ] = None,
    engine: Annotated[
        str, Setting("dynamics: mujoco for contact, loops, tendons, muscles, or own; default: by the file and the log")
    ] = "auto",
) -> None:
    """Find where a simulation and a recording differ, and why.

    Which effect causes the difference, and how far the gap closes with it. A
    film is tracked first, with --tracker.
    """
    given.check_exist()

    from invdyn.diagnosis.diagnose import diagnose as run
    from invdyn.diagnosis.report.regression_sentences import interim
    from invdyn.diagnosis.report.save import save
    from invdyn.diagnosis.report.sentences import details, verdict
    from invdyn.diagnosis.write_back.ensemble import write_ensemble, write_members
    from invdyn.diagnosis.write_back.write_back import write_back as corrected
    from invdyn.recordings import new_folder, whole_set

    from .engine_input import diagnose_by_engine, engine_log_of
    from .outputs import OutputFolder

    given.check()
    outputs = OutputFolder.of_diagnosis(out)
    outputs.check(*given.files)
    tracks = given.tracks_file(out.with_name(f"{out.name}.tracks.csv"))
    check_outputs([tracks, write_back], given.files)
    check_ending("a file of tracks", tracks, ".csv")
    count, copies = ensemble or (0, None)
    _check_copies(given, write_back, count, copies)
    if (log := engine_log_of(given, engine)) is not None:
        with ProgressBar() as progress:
            diagnosis, members = diagnose_by_engine(given, *log, progress, write_back, count)
        with new_folder(out), whole_set():
            if copies is not None:
                with new_folder(copies):
                    write_members(diagnosis, Path(str(given.body)).suffix, members, copies)
            save(diagnosis, out)
        say(f"engine     {diagnosis.method['engine']}")
        say("\n".join([verdict(diagnosis), *details(diagnosis), outputs.listing()]))
        return
    with ProgressBar() as progress:
        arguments, _ = given.load(tracks=tracks, checkpoint=given.checkpoint, progress=progress)
    with ProgressBar() as progress:
        diagnosis = run(
            **arguments,
            progress=progress,
            checkpoint=given.checkpoint,
            interim=lambda found: say(f"First answer, until the final one: {interim(found)}"),
        )
    held_out, body, refined = arguments["held_out"], arguments["body"], None
    recordings = arguments["recording"] if isinstance(arguments["recording"], list) else [arguments["recording"]]
    if write_back is not None or ensemble is not None:
        from invdyn.diagnosis.write_back.output_error import refine

        workers = arguments["workers"]
        with ProgressBar() as progress:
            refined = refine(
                diagnosis, str(given.body), body, recordings, members=count, workers=workers, progress=progress
            )
    with new_folder(out), whole_set():
        if write_back is not None:
            shown = held_out or recordings[0]
            diagnosis = corrected(diagnosis, str(given.body), body, write_back, shown, held_out is not None, refined)
            if diagnosis.written is not None and diagnosis.written.refined is None:
                refined = None  # the copies follow the answer that the file follows
        if copies is not None:
            with new_folder(copies):
                write_ensemble(diagnosis, str(given.body), body, copies, count, refined)
        save(diagnosis, out, workers=arguments["workers"])
    say("\n".join([verdict(diagnosis), *details(diagnosis)]))
    say(outputs.listing() + ("" if tracks is None else f"\n{'tracks':<10} {tracks}"))
    if copies is not None:
        say(f"ensemble   {copies}")


def _check_copies(given: Diagnosed, write_back: Path | None, count: int, copies: Path | None) -> None:
    """Raise InputError, BodyError or OSError where a corrected file, or copies of it, could not be written."""
    from invdyn.diagnosis.write_back.ensemble import check_ensemble
    from invdyn.diagnosis.write_back.write_back import check_write_back
    from invdyn.recordings import InputError

    from .outputs import check_folder

    if write_back is None and copies is None:
        return
    if given.body is None:
        raise InputError("--write-back and --ensemble correct copies of a file: give --body, and no person's height")
    if write_back is not None:
        check_write_back(given.body, write_back)
    if copies is not None:
        check_ensemble(count)
        check_write_back(given.body, copies / Path(given.body).name)
        files = (copies / f"robot_{n:03d}{Path(given.body).suffix}" for n in range(count))
        check_folder(copies, [copies / "randomisation.json", *files], given.files)


OTHERS = (simulate, plot, view, demo, trials, check, live, excite, label, train, track, calibrate, triangulate)
for each in (*OTHERS, compare_model, blind):
    command()(with_settings(each))
