"""The command of an arm that moves now: `invdyn live`."""

import json
import math
import socket
import sys
from collections.abc import Callable, Iterator
from contextlib import nullcontext, suppress
from pathlib import Path
from typing import IO, Annotated, Any

import typer

from .console import ProgressBar, print_line
from .options import BodyFile, FrameRate, HideTorque
from .settings import Setting

PACKET = 65536
"""Bytes of a UDP packet at most."""
NAMED = 5
"""Rows that cannot be used which are named; all are counted."""


def live(
    body: BodyFile,
    source: Annotated[str, typer.Argument(metavar="ROWS", help="The rows: a file, or - for standard input.")] = "-",
    *,
    calibration: Annotated[
        Path, typer.Option(help="A recording of the same arm and sensors, on which noise and scales are fitted: .csv.")
    ],
    fps: FrameRate = None,
    lag: Annotated[float, typer.Option(min=0, max=5, help="How long to wait for later rows, s.")] = 0.05,
    udp: Annotated[
        int | None, typer.Option(min=1, max=65535, help="Listen to this port, a row a packet, in place of stdin.")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Where the answers go: .csv; default: standard output.")] = None,
    hide_torque: HideTorque = False,
    address: Annotated[str, Setting("address to listen at; 0.0.0.0 is all of them")] = "127.0.0.1",
    hours: Annotated[float, Setting("per false alarm of a change, at least, in the mean", float, least=0.001)] = 2.0,
) -> None:
    """Torques with bands while the arm moves.

    Rows come as lines of CSV or JSON, torques go out as lines of CSV:
    `tail -f rows.csv | invdyn live --body arm.toml --calibration before.csv`
    """
    from .input_names import check_exist

    check_exist(str(calibration), *([] if source == "-" else [source]), body=body)

    from invdyn.inference import LiveArm
    from invdyn.inference.execution.progress import stage
    from invdyn.recordings import InputError

    from .console import check_ending, check_outputs
    from .inputs import load_body, read_recordings

    if udp is not None and source != "-":
        raise InputError(f"expected rows from one place, got {source} and --udp {udp}: leave one of them out")
    check_outputs([out], [Path(body), calibration, Path(source)])
    check_ending("the answers", out, ".csv")
    arm = load_body(body)
    (reading,) = read_recordings([str(calibration)], arm, fps=fps)
    with ProgressBar() as bar:
        report = stage(bar, "fit")
        following = LiveArm(reading.recording, arm, lag=lag, hide_torque=hide_torque, hours=hours, report=report)
    names = ["time", *following.columns, *following.commands]
    refused: list[InputError] = []

    def refuse(error: InputError) -> None:
        if udp is None:  # a file and a pipe lose nothing: the sender errs
            raise error from None
        refused.append(error)
        if len(refused) <= NAMED:
            print_line("warning", f"left out: {error}")

    with (
        nullcontext(sys.stdin) if source == "-" else Path(source).open(encoding="utf-8", errors="replace") as lines,
        nullcontext(sys.stdout) if out is None else out.open("w", encoding="utf-8") as sheet,
        suppress(KeyboardInterrupt),  # as a run without an end is ended
    ):
        given = iter(lines) if udp is None else _packets(address, udp)
        _write(following, answers(following, given, names, refuse), sheet)
    counts = following.smoother.counts
    print_line(
        "live",
        f"{counts.rows} rows answered, {counts.lost} lost, {counts.late} too late, {counts.doubled} doubled, "
        f"{counts.restarts} restarts" + (f", {len(refused)} left out as they cannot be used" if refused else ""),
    )


def answers(following: Any, source: Iterator[str], names: list[str], refuse: Callable[[Any], None]) -> Iterator[Any]:
    """Answers of a :class:`invdyn.inference.LiveArm` to lines; ``refuse`` is called with the InputError of a line that
    cannot be used, and raises it or lets the next one come.
    """
    from invdyn.recordings import InputError

    for time, values in rows(source, names, refuse):
        try:
            found = following.add(time, values)
        except InputError as error:
            refuse(error)
        else:
            yield from found
    yield from following.finish()


def _write(following: Any, answers: Iterator[Any], sheet: IO[str]) -> None:
    """Each answer at once, as a line of a table, and what is to be said of it."""
    head = False
    for row in answers:
        line = following.table_row(row)
        if not head:
            print(",".join(line), file=sheet)
            head = True
        time, *values = line.values()  # the time may be a Unix time: nine digits would not do
        print(round(time, 6), *(f"{value:.9g}" for value in values), sep=",", file=sheet, flush=True)
        if row.changed:
            print_line("warning", f"at {row.time:.3f} s the body has changed, or moves otherwise than calibrated")


def rows(
    source: Iterator[str], names: list[str], refuse: Callable[[Any], None]
) -> Iterator[tuple[float, dict[str, float]]]:
    """Times and values of lines: JSON objects, or CSV in the order of a header or, without one, of ``names``.

    ``refuse`` is called with an InputError that names the line, for one that is neither.
    """
    from invdyn.recordings import InputError

    for number, line in enumerate(source, 1):
        if not (line := line.strip("\ufeff \t\r\n")):  # some programs begin a file with a mark
            continue
        try:
            if line.startswith("{"):
                values = {str(name): _number(value) for name, value in json.loads(line).items()}
            else:
                cells = [cell.strip() for cell in line.split(",")]
                if "time" in cells:
                    names = cells
                    continue
                values = dict(zip(names, map(_number, cells), strict=True))
            time = values.pop("time")
        except (ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError):
            refuse(
                InputError(
                    f"line {number}: expected {len(names)} numbers ({', '.join(names)}) or a JSON object with a time, "
                    f"got {line[:60]!r}"
                )
            )
            continue
        yield time, values


def _number(cell: object) -> float:
    return math.nan if cell is None or cell == "" else float(cell)  # type: ignore[arg-type]  # raises ValueError


def _packets(address: str, port: int) -> Iterator[str]:
    """Lines of UDP packets, until an empty one."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind((address, port))
        while packet := receiver.recv(PACKET):
            yield from packet.decode("utf-8", errors="replace").splitlines()
