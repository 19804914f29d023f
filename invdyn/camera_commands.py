"""The commands of films of several cameras: `invdyn calibrate` and `invdyn triangulate`."""

from pathlib import Path
from typing import Annotated, Any

import typer

from .console import ProgressBar, check_ending, check_outputs, say
from .options import Calibration, FileFormat, FrameRate, Individual, Offset
from .settings import Setting


def calibrate(
    films: Annotated[
        list[str], typer.Argument(help="CAMERA=FILM for each camera, a film or a folder of pictures of one board.")
    ],
    board: Annotated[str, typer.Option(help="checkerboard:9x6 (inner corners) or charuco:7x5 (squares).")],
    square: Annotated[float, typer.Option(help="Side of a square, m.")],
    out: Annotated[Path, typer.Option(help="The calibration: .toml.")],
    marker: Annotated[float | None, Setting("side of a marker, m; default: half a square", float)] = None,
    dictionary: Annotated[str, Setting("of the markers, as OpenCV calls it; default: DICT_4X4_50")] = "DICT_4X4_50",
    every: Annotated[int, Setting("search every n-th frame of a film; default: 10", int, least=1)] = 10,
) -> None:
    """Calibrate cameras from films of a board.

    It was shown to all of them.
    """
    from invdyn.recordings import InputError
    from invdyn.recordings.cameras import Board, write_calibration
    from invdyn.recordings.cameras import calibrate as run

    sources: dict[str, Path] = {}
    for film in films:
        name, equals, place = film.partition("=")
        path = Path(place if equals else film)
        name = name if equals else path.stem
        if name in sources:
            raise InputError(f"camera {name!r} has two films: write CAMERA=FILM, each with its own name")
        sources[name] = path
    check_outputs([out], sources.values())
    check_ending("a calibration", out, ".toml")
    shown = Board.parse(board, square, marker, dictionary)
    with ProgressBar() as progress:
        calibration, lenses = run(sources, shown, every, progress)
    write_calibration(calibration, out)
    say(f"{'camera':<14} {'pictures':>8} {'error px':>8} {'focal px':>18} {'position m':>26}")
    for camera in calibration:
        lens = lenses[camera.name]
        focal = f"{lens.matrix[0, 0]:.1f} ± {lens.focal_sd[0]:.1f}"
        place = ", ".join(f"{each:.3f}" for each in camera.position)
        say(f"{camera.name:<14} {lens.pictures:>8} {lens.error:>8.3f} {focal:>18} {place:>26}")
    first = calibration.names[0]
    say(f"{len(calibration)} together: {calibration.error:.3f} px; frame and origin are those of {first}")
    say(f"calibration  {out}")


def triangulate(
    tracks: Annotated[
        list[str], typer.Argument(help="Tracks in pixels, one file a camera: CAMERA=FILE, or arm_cam1.csv for cam1.")
    ],
    calibration: Calibration,
    out: Annotated[Path, typer.Option(help="The recording in space: .csv, m.")],
    length: Annotated[
        list[str] | None,
        typer.Option(help="A known length, m: shoulder:elbow=0.28, or with --body upper_arm=0.28; repeatable."),
    ] = None,
    body: Annotated[
        str | None, typer.Option(metavar="FILE", help="Body whose links --length may name: .toml, .xml or .urdf.")
    ] = None,
    offset: Offset = None,
    find: Annotated[
        float | None,
        typer.Option("--find-offsets", min=0.001, help="Find how far clocks are ahead, up to so many seconds."),
    ] = None,
    up: Annotated[str, Setting("axis of the calibration that points up: z, -z, y, -y, x, -x; default: z")] = "z",
    refine: Annotated[bool, typer.Option("--refine", help="Adjust the cameras' poses to these tracks first.")] = False,
    fit: Annotated[
        str, typer.Option("--estimate", help="With --refine, what to fit of the lenses: focal, distortion, or both.")
    ] = "",
    fps: FrameRate = None,
    errors: Annotated[Path | None, typer.Option(help="Reprojection errors by camera and keypoint: .csv.")] = None,
    sd: Annotated[Path | None, Setting("standard deviations of all coordinates, m: .csv", Path)] = None,
    calibration_out: Annotated[
        Path | None, typer.Option(help="The cameras in the recording's frame, in metres: .toml.")
    ] = None,
    unit: Annotated[str | None, Setting("unit of the calibration, if the file does not say: m, cm, mm")] = None,
    baseline: Annotated[str | None, Setting("known distance of two cameras, m: cam1:cam2=1.2")] = None,
    noise: Annotated[float | None, Setting("scale of a pixel's error, px; default: found", float, least=1e-6)] = None,
    format: FileFormat = None,
    individual: Individual = None,
) -> None:
    """Make one recording in space from several cameras' tracks."""
    from invdyn.recordings import InputError, whole_set, write_keypoint_csv, write_table, write_text
    from invdyn.recordings.cameras import (
        Length,
        at_one_time,
        find_offsets,
        match_names,
        put_in_order,
        read_calibration,
        read_tracks,
        reconstruct,
        write_calibration,
    )
    from invdyn.recordings.cameras.reprojection import csv_text

    from .input_names import camera_offset

    calibration = calibration or []
    offsets = dict(map(camera_offset, offset or ()))
    if offsets and find is not None:
        raise InputError("--set offset states what --find-offsets looks for: choose one")
    lengths = [_length(text, body) for text in length or ()]
    cameras = read_calibration(calibration, unit)
    files = match_names(tracks, cameras.names)
    check_outputs([out, errors, sd, calibration_out], [*calibration, *files.values()])
    for table_out in (out, errors, sd):
        check_ending("a table", table_out, ".csv")
    check_ending("a calibration", calibration_out, ".toml")
    with ProgressBar() as progress:
        films = read_tracks(files, cameras, fps=fps, format=format, individual=individual)
        clocks = {} if find is None else find_offsets(films, cameras, find, progress)
        offsets |= {name: clock.seconds for name, clock in clocks.items() if clock.significant}
        views = put_in_order(at_one_time(films, cameras, offsets))
        progress(0, 1, "triangulate")
        scene = reconstruct(
            views,
            lengths=lengths,
            baseline=None if baseline is None else Length.parse(baseline),
            up=up,
            refine=refine,
            intrinsics=[word.strip() for word in fit.split(",") if word.strip()],
            scale=noise,
            name=out.stem,
        )
        progress(1, 1, "triangulate")
    with whole_set():
        write_keypoint_csv(scene.recording, out)
        if errors is not None:
            write_text(errors, csv_text(scene.rows))
        if sd is not None:
            write_table(_sd_columns(scene), sd)
        if calibration_out is not None:
            write_calibration(scene.calibration, calibration_out)
    named = {"recording": out, "errors": errors, "sds": sd, "cameras": calibration_out}
    _report(scene, offsets, clocks)
    say("\n".join(f"{name:<10} {path}" for name, path in named.items() if path is not None))


def _sd_columns(scene: Any) -> dict[str, Any]:
    """Columns of a table, "wrist_x_sd" and so on, m."""
    recording = scene.recording
    columns = {
        f"{point}_{axis}_sd": scene.sd[:, p, s]
        for p, point in enumerate(recording.keypoint_names)
        for s, axis in enumerate("xyz")
    }
    return {"time": recording.time, **columns}


def _report(scene: Any, offsets: dict[str, float], clocks: dict[str, Any]) -> None:
    """Print errors of reprojection, what is known, and clocks."""
    import numpy as np

    from invdyn.recordings.cameras.reprojection import table

    say(table(scene.rows))
    known = float(np.isfinite(scene.recording.keypoints).all(-1).mean())
    say(f"a pixel's error has a scale of {scene.scale:.2f} px; {known:.1%} of all points are known")
    for name, seconds in offsets.items():
        sd_text = f" ± {clocks[name].sd:.4f}" if name in clocks else ""
        say(f"times of {name} run ahead by {seconds:+.4f}{sd_text} s")
    for name, clock in clocks.items():
        if not clock.significant:
            say(
                f"times of {name} are taken as they are: {clock.seconds:+.4f} ± {clock.sd:.4f} s fit best, which "
                "may not be a clock, as a tracker's lasting errors look the same; --set offset states a known one"
            )
    if scene.factor != 1:
        say(f"the calibration's lengths were multiplied by {scene.factor:.6g} to be metres")


def _length(text: str, body: str | None) -> Any:
    """Read "shoulder:elbow=0.28", or a link of the body file, "upper_arm=0.28". Raises InputError for anything else."""
    from invdyn.recordings import InputError
    from invdyn.recordings.cameras import Length

    name, equals, number = text.partition("=")
    if body is not None and ":" not in name:
        from .inputs import load_body

        read = load_body(body)
        if not read.is_chain:
            raise InputError(f"--length {text}: in space write two keypoints, such as shoulder:elbow=0.28")
        links = {link.name: link for link in read.links}
        if name not in links:
            raise InputError(f"--length {text}: the body has no link {name!r}, but {', '.join(links)}")
        text = f"{links[name].joint.name}:{links[name].tip}{equals}{number}"
    return Length.parse(text)
