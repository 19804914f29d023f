"""The commands from films to tracks: `invdyn label`, `invdyn train` and `invdyn track`."""

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any

import typer

from .console import ProgressBar, check_ending, check_outputs, say
from .options import Checkpoint, Individual, Person, Seed, Tracker
from .settings import Setting, yes

FilmFile = Annotated[Path, typer.Argument(metavar="FILM", help="Film: .mp4, .mov, .avi, .mkv …")]


def label(
    film: FilmFile,
    out: Annotated[Path, typer.Option(help="The labels: .csv; a file that is there is continued.")],
    keypoints: Annotated[
        str | None, typer.Option(help="Names, such as shoulder,elbow,wrist; default: those in the labels' file.")
    ] = None,
    count: Annotated[int, typer.Option(min=1, max=1000, help="Pictures to label now.")] = 20,
    posterior: Annotated[
        Path | None,
        typer.Option(help="Posterior of this film, by `invdyn infer`: offer the pictures that surprise it most."),
    ] = None,
    tracker: Annotated[
        Path | None,
        typer.Option(help="Network of `invdyn train`; the page shows its points, for you to take or correct."),
    ] = None,
    browser: Annotated[bool, Setting("no: leave the page for you to open; default: yes", yes)] = True,
) -> None:
    """Label joints in a film, in a page of your browser.

    It offers the pictures that teach most.
    """
    import webbrowser

    from invdyn.recordings import InputError
    from invdyn.recordings.errors import about
    from invdyn.recordings.tracking.choose import different
    from invdyn.recordings.tracking.film import Film, read_pictures
    from invdyn.recordings.tracking.labels import read_labels

    from .label_server import LabelServer

    check_outputs([out], [path for path in (film, posterior, tracker) if path is not None])
    check_ending("a file of labels", out, ".csv")
    before = read_labels(out) if out.exists() else None
    names = tuple(name.strip() for name in (keypoints or "").split(",") if name.strip())
    names = names or (() if before is None else before.names)
    if not names or len(set(names)) < len(names):
        raise InputError("expected --keypoints, the joints to label, such as shoulder,elbow,wrist, each name once")
    if before is not None and set(names) != set(before.names):
        raise InputError(
            f"{out}: labels of {', '.join(before.names)} are there: go on with these, or name another file"
        )
    source = Film(film)
    if before is not None:
        with about(out):
            before.check_within(source.width, source.height)
    suggest = None if tracker is None else _suggestions(tracker, names, source)
    labelled = set() if before is None else set(before.frames.tolist())
    with ProgressBar() as progress:
        if posterior is None:
            numbers = different(source, count, labelled, progress)
        else:
            numbers = _surprising(source, posterior, count, labelled)
    server = LabelServer(numbers, read_pictures(source, numbers), names, out, suggest)
    with server:
        say(f"{len(numbers)} pictures to label: {server.address} (Ctrl-C ends it, too)")
        if browser:
            webbrowser.open(server.address)
        with suppress(KeyboardInterrupt):  # each label is written when it is set
            server.serve_forever()
    say(f"{len(server.labels)} labelled pictures" + (f"\nlabels     {out}" if out.exists() else ""))


def _suggestions(path: Path, names: tuple[str, ...], film: Any) -> Callable[[Any], Any]:
    """From a picture of the film to (P, 3) of a network. Raises InputError for a keypoint that it does not know."""
    import numpy as np
    from PIL import Image

    from invdyn.recordings import InputError
    from invdyn.recordings.tracking.heatmap import HeatmapTracker

    network = HeatmapTracker.load(path)
    if missing := [name for name in names if name not in network.keypoint_names]:
        raise InputError(f"{path}: it does not track {missing[0]!r}, but {', '.join(network.keypoint_names)}")
    places = [network.keypoint_names.index(name) for name in names]
    height, width = network.picture_size

    def suggest(picture: Any) -> Any:
        small = Image.fromarray(picture).resize((width, height), Image.Resampling.BOX)
        found = network.track(np.array(small))[places]
        found[:, :2] = (found[:, :2] + 0.5) * [film.width / width, film.height / height] - 0.5
        return found

    return suggest


def _surprising(film: Any, posterior: Path, count: int, labelled: set[int]) -> list[int]:
    """Pictures in which what was tracked surprised the model most. Raises InputError where there are none."""
    import numpy as np

    from invdyn.inference import load_posterior
    from invdyn.recordings import InputError
    from invdyn.recordings.tracking.choose import surprising

    from .surprise import surprise

    idata = load_posterior(posterior)
    times = np.array([picture.time for picture in film.pictures((2, 2))])
    numbers = np.abs(idata["posterior"]["time"].values[:, None] - times).argmin(1)
    chosen = surprising(surprise(idata), numbers, count, labelled)
    if not chosen:
        raise InputError(f"{posterior}: every picture that it knows of is labelled")
    return chosen


def train(
    films: Annotated[list[Path], typer.Argument(metavar="FILM", help="Film with labels, or several of them.")],
    labels: Annotated[
        list[Path],
        typer.Option(help="Its labels, of `invdyn label`, DeepLabCut or SLEAP; once for each film, in their order."),
    ],
    out: Annotated[Path, typer.Option(help="The network: .safetensors.")],
    steps: Annotated[int, typer.Option(min=1, help="Steps of training, of eight pictures each.")] = 500,
    size: Annotated[int, Setting("longer side of the pictures that the network sees, px; default: 288", int)] = 288,
    seed: Seed = 0,
    individual: Individual = None,
    checkpoint: Checkpoint = None,
) -> None:
    """Train a network on labelled pictures, for `invdyn track`."""
    from invdyn.recordings import InputError
    from invdyn.recordings.tracking.film import Film
    from invdyn.recordings.tracking.heatmap import import_safetensors
    from invdyn.recordings.tracking.labels import read_labels
    from invdyn.recordings.tracking.training import examples
    from invdyn.recordings.tracking.training import train as run

    if len(labels) != len(films):
        raise InputError(f"{len(films)} films and {len(labels)} files of labels: give --labels once for each film")
    check_outputs([out], [*films, *labels])
    check_ending("a network", out, ".safetensors")
    import_safetensors()
    labelled = [read_labels(path, individual) for path in labels]
    given = examples([Film(path) for path in films], labelled, size)
    keeper = None
    if checkpoint is not None:
        import torch

        from invdyn.inference.execution.checkpoint import Checkpoint, digest

        data = digest(torch.from_numpy(given.pictures), torch.from_numpy(given.points))
        keeper = Checkpoint(checkpoint, {"labels": data, "steps": steps, "seed": seed}, "train")
    with ProgressBar() as progress:
        trained = run(given, steps=steps, seed=seed, progress=progress, keeper=keeper)
    trained.tracker.save(out)
    say(f"{len(given.pictures)} labelled pictures of {', '.join(given.names)}")
    say(_quality(trained))
    say(f"network    {out}")


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
    out: Annotated[Path, typer.Option("--out", help="The tracks, in px: .csv.")],
    tracker: Tracker = None,
    person: Person = None,
    checkpoint: Checkpoint = None,
) -> None:
    """Track the joints in a film.

    By your own network, or those of a person's arm without one.
    """
    from .input_names import check_exist

    check_exist(str(film))

    import numpy as np

    from invdyn.recordings.tracking.film import Film

    from .film_input import SIDES, track_into

    check_outputs([out], [film, *([] if tracker is None or tracker in SIDES else [Path(tracker)])])
    check_ending("a file of tracks", out, ".csv")
    with ProgressBar() as progress:
        names, tracks = track_into(out, Film(film), tracker, person, checkpoint, progress)
    known = np.isfinite(tracks[..., 0])
    for p, name in enumerate(names):
        seen = tracks[known[:, p], p, 2]
        confidence = f"; confidence {np.median(seen):.2f}, under .5 in {np.mean(seen < 0.5):.1%}" if len(seen) else ""
        say(f"{name:<14} found in {known[:, p].mean():.1%} of {len(tracks)} pictures{confidence}")
    say(f"tracks     {out}")
