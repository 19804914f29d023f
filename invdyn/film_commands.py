"""The commands from films to tracks: `invdyn label`, `invdyn train` and `invdyn track`."""

import hashlib
from pathlib import Path
from typing import Annotated, Any

import typer

from .console import ProgressBar, check_outputs
from .options import Seed

FilmFile = Annotated[Path, typer.Argument(metavar="FILM", help="Film: .mp4, .mov, .avi, .mkv …")]
Kept = Annotated[
    Path | None, typer.Option(help="Folder that keeps what is done; the same call again goes on from there.")
]
NetworkFile = Annotated[Path | None, typer.Option(help="Network of `invdyn train`: .safetensors.")]
ArmSide = Annotated[str | None, typer.Option(help="Without a network: which arm of a person, left or right.")]
PersonSeen = Annotated[
    str | None, typer.Option(help="Which one, of several people: left, right, largest, or a box u,v,width,height, px.")
]


def register(app: typer.Typer) -> None:
    """Add the commands."""
    app.command()(train)
    app.command()(track)


def train(
    films: Annotated[list[Path], typer.Argument(metavar="FILM", help="Film with labels, or several of them.")],
    labels: Annotated[
        list[Path],
        typer.Option(help="Its labels, of `invdyn label`, DeepLabCut or SLEAP; once for each film, in their order."),
    ],
    out: Annotated[Path, typer.Option(help="The network: .safetensors.")],
    steps: Annotated[int, typer.Option(min=1, help="Steps of training, of eight pictures each.")] = 800,
    size: Annotated[int, typer.Option(help="Longer side of the pictures that the network sees, px.")] = 288,
    seed: Seed = 0,
    individual: Annotated[str | None, typer.Option(help="Which animal, in labels of several.")] = None,
    checkpoint: Kept = None,
) -> None:
    """Train a network on labelled pictures of a film; then `invdyn track` tracks all of it."""
    from invdyn.recordings import InputError
    from invdyn.recordings.tracking.film import Film
    from invdyn.recordings.tracking.heatmap import import_safetensors
    from invdyn.recordings.tracking.labels import read_labels
    from invdyn.recordings.tracking.training import examples
    from invdyn.recordings.tracking.training import train as run

    if len(labels) != len(films):
        raise InputError(f"{len(films)} films and {len(labels)} files of labels: give --labels once for each film")
    check_outputs([out], [*films, *labels])
    import_safetensors()
    told = [read_labels(path, individual) for path in labels]
    given = examples([Film(path) for path in films], told, size)
    keeper = None
    if checkpoint is not None:
        import torch

        from invdyn.inference.execution.checkpoint import Checkpoint, digest

        data = digest(torch.from_numpy(given.pictures), torch.from_numpy(given.points))
        keeper = Checkpoint(checkpoint, {"labels": data, "steps": steps, "seed": seed}, "train")
    with ProgressBar() as progress:
        trained = run(given, steps=steps, seed=seed, progress=progress, keeper=keeper)
    trained.tracker.save(out)
    typer.echo(f"{len(given.pictures)} labelled pictures of {', '.join(given.names)}")
    typer.echo(_quality(trained))
    typer.echo(f"network    {out}")


def _quality(trained: Any) -> str:
    import numpy as np

    errors, tolerance = trained.errors, trained.tracker.tolerance
    if not len(errors):
        return "too few labels to hold some out: confidence is not calibrated"
    return (
        f"on {len(errors)} labels held out: median error {np.median(errors):.1f} px, "
        f"{np.mean(errors > tolerance):.1%} off by more than {tolerance:.0f} px; "
        f"their confidence is {trained.confidence.mean():.2f}"
    )


def track(
    film: FilmFile,
    out: Annotated[Path, typer.Option(help="The tracks, in px: .csv.")],
    network: NetworkFile = None,
    arm: ArmSide = None,
    person: PersonSeen = None,
    checkpoint: Kept = None,
) -> None:
    """Track the joints in a film, by a network of your own, or those of a person's arm without one."""
    import numpy as np

    inputs = [film, *([] if network is None else [network])]
    check_outputs([out], inputs)
    with ProgressBar() as progress:
        names, tracks = tracks_of(film, out, network, arm, person, checkpoint, progress)
    known = np.isfinite(tracks[..., 0])
    for p, name in enumerate(names):
        seen = tracks[known[:, p], p, 2]
        told = f"; confidence {np.median(seen):.2f}, under .5 in {np.mean(seen < 0.5):.1%}" if len(seen) else ""
        typer.echo(f"{name:<14} found in {known[:, p].mean():.1%} of {len(tracks)} pictures{told}")
    typer.echo(f"tracks     {out}")


def tracks_of(
    path: Path,
    out: Path,
    network: Path | None,
    arm: str | None,
    person: str | None,
    checkpoint: Path | None,
    progress: Any,
) -> tuple[tuple[str, ...], Any]:
    """Track a film into the file `out`; names of the keypoints, and (T, P, 3).

    Raises InputError unless there is one of network and arm, and as film and tracker do.
    """
    from invdyn.recordings import InputError
    from invdyn.recordings.tracking.film import Film
    from invdyn.recordings.tracking.heatmap import HeatmapTracker
    from invdyn.recordings.tracking.tracker import Tracker, track_film, write_tracks

    if (network is None) == (arm is None):
        raise InputError(
            f"{path}: who is to be tracked? give --network (of `invdyn train`), or --arm left or right for a person's"
        )
    if person is not None and arm is None:
        raise InputError("--person chooses whose --arm is tracked; a --network knows what it was trained on")
    film = Film(path)
    tracker: Tracker
    if network is not None:
        tracker = HeatmapTracker.load(network)
    else:
        from invdyn.recordings.tracking.blazepose import person_tracker

        tracker = person_tracker(str(arm), person, progress)
    keeper = None
    if checkpoint is not None:
        from invdyn.inference.execution.checkpoint import Checkpoint

        with path.open("rb") as file:
            run = {"film": hashlib.file_digest(file, "sha256").hexdigest(), "arm": arm, "person": person}
        if network is not None:
            run["network"] = hashlib.sha256(network.read_bytes()).hexdigest()
        keeper = Checkpoint(checkpoint, run, "track")
    times, tracks = track_film(film, tracker, progress, keeper)
    write_tracks(tracker.keypoint_names, times, tracks, out)
    return tracker.keypoint_names, tracks
