"""The command of models of one's own: `invdyn compare model.py:Model rows.csv`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .options import Checkpoint, Device, FolderOut, Isolate, Methods, Replicates, Seed, Workers
from .settings import Setting

if TYPE_CHECKING:
    import numpy as np

    from invdyn.models import StateSpaceModel


def compare_model(
    model: Annotated[str, typer.Argument(metavar="FILE.py:NAME", help="A state-space model; its file is run.")],
    rows: Annotated[Path, typer.Argument(help="Its rows: .csv with a header; an empty cell is missing.")],
    methods: Methods,
    out: FolderOut,
    truth: Annotated[Path | None, Setting("true states to score against: .csv, a column each", Path)] = None,
    filters: Annotated[int | None, typer.Option(min=1, help="Filters (64), PMMH chains, SMC² runs.")] = None,
    particles: Annotated[int | None, typer.Option(min=1, help="Particles of each filter (100).")] = None,
    draws: Annotated[int | None, Setting("trajectories of each (4), or parameters", int, least=1)] = None,
    replicates: Replicates = 1,
    isolate: Isolate = False,
    seed: Seed = 0,
    workers: Workers = None,
    device: Device = "cpu",
    checkpoint: Checkpoint = None,
) -> None:
    """Run several methods on your own state-space model.

    One table, one figure. NAME is a model, a class without arguments, or a function or class of the rows, (T, O).
    """
    from invdyn.inference import compare_methods

    from .console import ProgressBar, say
    from .inference_options import open_workers
    from .outputs import OutputFolder, write_comparison
    from .summary import comparison_text

    names = tuple(dict.fromkeys(name.strip() for name in methods.split(",")))
    outputs = OutputFolder.of_comparison(out, names)
    outputs.check(rows, *([] if truth is None else [truth]))
    observed, states = read_columns(rows), None if truth is None else read_columns(truth)
    own = load_model(model, observed)
    with open_workers(workers) as executor, ProgressBar() as progress:
        comparison = compare_methods(
            own,
            observed,
            names,
            truth=states,
            seed=seed,
            num_filters=filters,
            num_particles=particles,
            num_draws=draws,
            replicates=replicates,
            isolate=isolate,
            progress=progress,
            device=device,
            executor=executor,
            checkpoint=checkpoint,
            name=rows.name,
        )
    write_comparison(outputs, comparison, states)
    say(comparison_text(comparison))
    say(outputs.listing(comparison.failures))


def read_columns(path: Path) -> "np.ndarray":
    """All columns of a table but `time`, as (rows, columns). Raises InputError or OSError."""
    import numpy as np

    from invdyn.recordings import InputError
    from invdyn.recordings.tables import read_table

    columns, _ = read_table(path)
    columns.pop("time", None)
    if not columns:
        raise InputError(f"{path}: expected a column of numbers in addition to time, got none")
    return np.stack(list(columns.values()), axis=-1)


def load_model(word: str, rows: "np.ndarray") -> "StateSpaceModel":
    """The model that FILE.py:NAME names; running the file may raise any exception.

    Raises InputError for a name that the file does not have, or that is no model.
    """
    import inspect

    import torch

    from invdyn.models import StateSpaceModel
    from invdyn.recordings import InputError

    file, _, name = word.rpartition(":")
    made: Any = getattr(run_file(Path(file)), name, None)
    if made is None:
        raise InputError(f"{file}: expected a model called {name!r}, the file has none")
    if callable(made) and not isinstance(made, StateSpaceModel):
        needed = [
            one
            for one in inspect.signature(made).parameters.values()
            if one.default is one.empty and one.kind in (one.POSITIONAL_ONLY, one.POSITIONAL_OR_KEYWORD)
        ]
        if len(needed) > 1:
            raise InputError(f"{word}: expected no argument or the rows, it takes {len(needed)}: write a function")
        made = made(torch.as_tensor(rows)) if needed else made()
    if not isinstance(made, StateSpaceModel):
        raise InputError(f"{word}: expected a StateSpaceModel, got {type(made).__name__}")
    return made


def run_file(path: Path) -> Any:
    """Run a Python file as a module, whose classes workers can be sent."""
    import importlib.util
    import sys

    import cloudpickle

    from invdyn.recordings import InputError, check_readable
    from invdyn.recordings.errors import first_line

    check_readable(path)
    spec = importlib.util.spec_from_file_location(f"model_file_{path.stem}", path)
    if spec is None or spec.loader is None:
        raise InputError(f"{path}: expected a Python file that defines a model")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    try:
        spec.loader.exec_module(module)
    except Exception as error:
        raise InputError(f"{path}: running it failed with {type(error).__name__}: {first_line(error)}") from error
    cloudpickle.register_pickle_by_value(module)
    return module
