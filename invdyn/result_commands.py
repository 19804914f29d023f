"""Commands that show a result: `invdyn plot` and `invdyn view`."""

from pathlib import Path
from typing import Annotated

import typer

from .console import ProgressBar, check_ending, check_outputs, say
from .options import Outputs


def plot(
    posterior: Annotated[Path, typer.Argument(help="A posterior that `invdyn infer` saved: .nc.")], out: Outputs = None
) -> None:
    """Draw a saved posterior, or export its torques."""
    from .input_names import check_exist

    check_exist(str(posterior))

    from invdyn.inference import load_posterior

    from .outputs import OutputFiles
    from .summary import summary_text

    files = OutputFiles(tuple(out or ()))
    files.check(posterior)
    idata = load_posterior(posterior)
    with ProgressBar() as progress:
        files.write(idata, progress)
    say(summary_text(idata))
    say(files.listing())


def view(
    file: Annotated[
        Path, typer.Argument(help="A posterior, .nc, of `invdyn infer`; the folder of `invdyn diagnose` or `trials`.")
    ],
    out: Annotated[Path, typer.Option(help="The page: .html.")],
    align: Annotated[
        str | None, typer.Option(help="Event at which a study's trials are aligned; default: the first one.")
    ] = None,
    rerun: Annotated[Path | None, typer.Option(help="The same for the viewer Rerun: .rrd (extra `rerun`).")] = None,
) -> None:
    """One page of a result, to look at and to send.

    The body and its curves move on one time axis. It opens without a server
    and without a network.
    """
    from .input_names import check_exist

    check_exist(str(file))

    from invdyn.recordings import whole_set, write_text

    from .page import write_rerun
    from .view import view_of

    check_outputs([out, rerun], [file])
    check_ending("a page", out, ".html")
    check_ending("a recording of Rerun", rerun, ".rrd")
    shown = view_of(file, align)
    with whole_set():
        if rerun is not None:
            write_rerun(shown, rerun)
        write_text(out, shown.html())
    say(f"page       {out}" + ("" if rerun is None else f"\nRerun      {rerun}"))
