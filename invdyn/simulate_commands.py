"""Commands that simulate a body: `invdyn simulate` and `invdyn demo`."""

from pathlib import Path
from typing import Annotated

import typer

from .console import ProgressBar, check_ending, check_outputs, say
from .options import BodyFile, FolderOut, Seed
from .settings import Setting


def simulate(
    body: BodyFile,
    out: Annotated[Path, typer.Option(help="The recording: .csv.")],
    truth: Annotated[Path | None, typer.Option(help="Its true torques, angles and velocities: .csv.")] = None,
    duration: Annotated[float, typer.Option(min=0, help="s.")] = 6.0,
    fps: Annotated[float, typer.Option(min=0.1, help="Frames a second.")] = 30.0,
    noise: Annotated[float, typer.Option(min=1e-9, help="Standard deviation of a keypoint, m.")] = 0.005,
    encoders: Annotated[
        float | None, Setting("record encoders too, with this standard deviation, rad", float, least=1e-9)
    ] = None,
    torque_scale: Annotated[
        float | None, Setting("standard deviation of the torques, N·m; default: by the body", float, least=0)
    ] = None,
    commanded: Annotated[bool, typer.Option("--commanded", help="The torques are known commands.")] = False,
    seed: Seed = 0,
) -> None:
    """Make a recording with known truth."""
    from .input_names import check_exist

    check_exist(body=body)

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


def demo(out: FolderOut = Path("demo"), seed: Seed = 0) -> None:
    """Simulate a person's arm, infer its torques, draw them."""
    from invdyn.inference import infer as run
    from invdyn.recordings import new_folder, whole_set, write_keypoint_csv, write_truth

    from .outputs import OutputFiles, check_folder
    from .simulate import person_arm, random_arm, record
    from .summary import summary_text

    check_folder(out, [], [])
    arm = person_arm()
    recording, truth = record(random_arm(arm, duration=4.0, noise=0.008, seed=seed), seed, "arm of a person")
    names = ("posterior.nc", "figure.png", "film.gif", "torques.sto", "torques.csv")
    files = OutputFiles(tuple(out / name for name in names))
    arm_file, recording_file, truth_file = out / "arm.toml", out / "recording.csv", out / "truth.csv"
    with new_folder(out), ProgressBar() as progress:
        files.check()
        check_outputs([arm_file, recording_file, truth_file])
        idata = run(recording, arm, truth=truth, seed=seed, progress=progress)
        with whole_set():
            arm.to_toml(arm_file)
            write_keypoint_csv(recording, recording_file)
            write_truth(truth, truth_file)
            files.write(idata, progress)
    say(summary_text(idata))
    say(files.listing())
    say(f"{'input':<10} {recording_file}, {truth_file}, {arm_file}")
    say(
        f"\nA recording of your own, the same way:\n  invdyn infer {recording_file} --body {arm_file} "
        "--out posterior.nc --out figure.png"
    )
