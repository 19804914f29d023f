"""Many trials in one command, `invdyn trials`, and in one object, :func:`invdyn.trials`."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .console import ProgressBar, say
from .inference_options import Inference, open_workers
from .options import FolderOut, Method
from .study_table import ManyTrials, checked, read_rows, read_trials

if TYPE_CHECKING:
    import pandas as pd

    from invdyn.inference.study.study import Study
    from invdyn.models import Body

MAX_LINES = 20
"""Of trials that are left out, and of those in doubt, that are printed."""


def trials(
    given: ManyTrials,
    out: FolderOut,
    method: Method = "laplace",
    nwb: Annotated[bool, typer.Option("--nwb", help="Write torques and keypoints of each session as NWB too.")] = False,
) -> None:
    """Infer many trials, sharing within sessions.

    One table, averages at events, differences between conditions. Trials that do not fit are named and left out.
    """
    from invdyn.inference.study.run import run_study
    from invdyn.recordings import InputError, check_nwb

    from .outputs import check_folder

    if (folder := Path(given.recording).resolve()).is_dir() and folder in (out.resolve(), *out.resolve().parents):
        raise InputError(f"{out}: expected a folder outside of {given.recording}, whose files are read as recordings")
    rows = read_rows(given)
    given.check(method)
    check_folder(out, [out / "trials.csv"], [Path(given.recording)])
    if nwb:
        check_nwb(out)
    with ProgressBar() as progress:
        read = read_trials(rows, given, None, progress)
    with open_workers(given.workers) as executor, ProgressBar() as progress:
        study = run_study(read, how(given, method), executor=executor, checkpoint=given.checkpoint, progress=progress)
    study.save(out, nwb=nwb)
    say(study_text(study))
    say(f"\nstudy      {out}")


def run_trials(
    table: "str | Path | pd.DataFrame",
    body: "str | Path | Body | None" = None,
    *,
    method: str = "laplace",
    workers: int | str | None = None,
    progress: Callable[[int, int, str], None] | None = None,
    **options: Any,
) -> "Study":
    """What :func:`invdyn.trials` does."""
    where = "." if not isinstance(table, str | Path) else str(table)
    given = ManyTrials(recordings=[where], body=str(body) if isinstance(body, str | Path) else None, **options)
    given.check(method)
    rows = read_rows(given) if isinstance(table, str | Path) else checked(_texts(table), "table")
    from invdyn.inference.study.run import run_study

    read = read_trials(rows, given, None if isinstance(body, str | Path) else body, progress)
    with open_workers(None if workers is None else str(workers)) as executor:
        kept = given.checkpoint
        return run_study(read, how(given, method), executor=executor, checkpoint=kept, progress=progress)


def _texts(table: "pd.DataFrame") -> list[dict[str, Any]]:
    """Rows of a frame as texts; what is missing in it is empty."""
    return table.astype(object).where(table.notna(), "").astype(str).rename(columns=str).to_dict("records")


def how(given: Inference, method: str) -> Any:
    """How each trial is inferred. Raises InputError for an option that has no part in a study."""
    from invdyn.inference.filters.filtering import SMCOptions
    from invdyn.inference.study.trial import How
    from invdyn.recordings import InputError

    if given.truth is not None or given.forces is not None:
        raise InputError("--set truth and --set forces are of one recording: leave them out of a study")
    arguments = given.arguments
    sizes = SMCOptions(
        given.filters, given.particles, given.draws, device=given.device, filters_per_task=given.filters_per_task
    )
    names = ("torque", "family", "passive", "hide_torque", "learn_cameras")
    binding = {name: arguments[name] for name in names}
    return How(method, sizes, given.seed, arguments["learn_lengths"], None, binding)


def study_text(study: "Study") -> str:
    """What a study found, in a few lines."""
    from invdyn.recordings import InputError

    lines = [f"{len(study.posteriors)} of {len(study.trials)} trials, {len(study.sessions)} sessions"]
    for what, table, why in (("left out", study.reasons, "reason"), ("in doubt", study.doubts, "doubt")):
        lines += [f"{what}: {trial}: {said}" for trial, said in table[["trial", why]].head(MAX_LINES).values]
        if (more := len(table) - MAX_LINES) > 0:
            lines.append(f"{what}: {more} more, named in {what.replace(' ', '_')}.csv")
    for factor in dict.fromkeys(name for trial in study.trials for name in trial.factors):
        try:
            differences = study.difference(factor)
        except InputError:  # of one level, or no joint has two
            continue
        for row in differences.itertuples():
            if row.quantity in ("peak", "impulse", "mean_power"):
                word = "differs" if row.found else "not distinguished"
                word += f", or its {row.confounded} does" if row.found and row.confounded else ""
                lines.append(
                    f"{factor} {row.second} − {row.first}: {row.quantity} of {row.joint} {row.mean:+.3g} {row.unit} "
                    f"({row.q05:.3g} to {row.q95:.3g}, 90 %), {word} (P = {row.direction:.3f})"
                )
    return "\n".join(lines)
