"""The posterior as ``arviz.InferenceData``, of any problem.

Layout (dims in brackets):

    posterior             what the problem names: :mod:`.arm_contents` of an arm, else state
                          [chain, draw, time, state_name]
    posterior_predictive  the observations that each draw predicts, with noise
    log_likelihood        y [chain, draw, time], log p(y_t | x_t) of each row, 0 where all of it is missing, nat
    sample_stats          log_evidence [chain] (or a bound on it), log_weight [chain] (outer, normalised);
                          of particle filters also ess, resampled and log_evidence_increment
                          [chain, time]; attributes: method, bound (1: log_evidence is a lower bound),
                          seconds (see :mod:`.registry`), and the method's own diagnostics
    observed_data         as posterior_predictive, without chain and draw
    constant_data         the model's parameters, and what else is known

Of a method with filters, a chain of sample_stats is a filter, with its weight. Draws of the other groups are equally
weighted (:func:`equally_weighted`), as ArviZ takes them to be. Copies of one trajectory stand next to one another, so
that ArviZ's effective sample size and R-hat count them once.
"""

import json
import math
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import arviz as az
import h5py
import numpy as np
import pandas as pd
import torch
import xarray as xr
from torch import Tensor

from invdyn.inference.execution.seeds import seeded
from invdyn.inference.filters.nested import OuterWeights, outer_weights
from invdyn.inference.filters.particles import FilterResult
from invdyn.inference.filters.resampling import resample
from invdyn.inference.posterior.layout import check_layout, check_size
from invdyn.inference.posterior.problem import DRAWS, Contents, StateSpaceProblem, Variables
from invdyn.models.observation.missing import observed_log_prob
from invdyn.recordings import InputError, atomic_path, check_readable, resolved
from invdyn.recordings.errors import about, first_line


def to_inference_data(
    problem: StateSpaceProblem,
    paths: Tensor,
    result: FilterResult | None = None,
    *,
    method: str,
    seed: int,
    settings: dict,
    log_evidence: float = math.nan,
    log_evidence_sd: float = math.nan,
    bound: bool = False,
    diagnostics: Mapping[str, float] | None = None,
    statistics: Mapping[str, np.ndarray] | None = None,
    parameters: Mapping[str, Tensor] | None = None,
) -> az.InferenceData:
    """Assemble InferenceData.

    Args:
        problem: model, observations, and what its posterior holds.
        paths: (M, R, T, D) smoothed trajectories.
        result: the filters' run; None for a method without particles, whose chains weigh the same.
        method: its name.
        seed: that was used.
        settings: fitted parameters and options, kept as JSON in the attributes.
        log_evidence, log_evidence_sd: without ``result``: log p(y) or a bound on it, nats, and its Monte
            Carlo standard error; NaN where the method has none.
        bound: whether the evidence is a lower bound.
        diagnostics: numbers for the attributes of sample_stats.
        statistics: of each draw (M, R), for sample_stats, by the names that ArviZ knows.
        parameters: values (M, …) that differ between chains, which become variables of the posterior.

    Draws are equally weighted at last (:func:`equally_weighted`), by random numbers of torch's global generator.
    """
    model = problem.model.to(dtype=torch.float64)
    paths = paths.double() if paths.is_floating_point() else paths  # a finite model numbers its states
    if result is None:
        outer = _equal_weights(len(paths), log_evidence, log_evidence_sd)
        each = torch.full((len(paths),), log_evidence, dtype=torch.float64)
    else:
        outer, each = outer_weights(result.log_evidence), result.log_evidence

    emission = model.emission(paths, torch.arange(model.num_steps))
    contents = problem.contents(paths, emission.sample())
    likelihood = observed_log_prob(emission, problem.observations.double())

    stats: Variables = {"log_evidence": (["chain"], each), "log_weight": (["chain"], outer.log_weights)}
    if result is not None:
        stats |= {
            "ess": (["chain", "time"], result.ess.mT),
            "resampled": (["chain", "time"], result.resampled.mT),
            "log_evidence_increment": (["chain", "time"], result.log_evidence_increment.mT),
        }
    stats |= {name: (DRAWS, values) for name, values in (statistics or {}).items()}

    own: Variables = {
        name: _of_chains(name, values, contents, paths.shape[1]) for name, values in (parameters or {}).items()
    }
    posterior = _dataset(contents, contents.posterior | own)
    for name in own:  # whose unit only the caller knows
        del posterior[name].attrs["units"]

    groups: dict[str, Any] = {
        "posterior": posterior,
        "posterior_predictive": _dataset(contents, contents.predictive, contents.observed_coords),
        "log_likelihood": _dataset(contents, {"y": ([*DRAWS, "time"], likelihood)}),
        "sample_stats": _dataset(contents, stats),
        "observed_data": _dataset(contents, contents.observed, contents.observed_coords),
        "constant_data": _dataset(contents, contents.constants, contents.observed_coords),
    }
    # netCDF knows no booleans.
    groups["sample_stats"].attrs.update({"method": method, "bound": int(bound), **(diagnostics or {})})
    idata = az.InferenceData(**groups)
    idata.attrs.update(
        {
            "method": method,
            "seed": seed,
            **contents.attributes,
            **_outer_attributes(outer),
            "settings": json.dumps(settings, sort_keys=True),
            "invdyn_version": version("invdyn"),
        }
    )
    return equally_weighted(idata, outer.log_weights)


UNITS = {
    **dict.fromkeys(("log_evidence", "log_weight", "log_evidence_increment", "y"), "nat"),
    "ess": "particles",
}
"""Units of what every method gives."""


def _dataset(contents: Contents, variables: Variables, coords: Mapping[str, Any] | None = None) -> xr.Dataset:
    """Variables with the coordinates of their dimensions, and with units."""
    arrays = {name: (dims, np.asarray(values)) for name, (dims, values) in variables.items()}
    used = {dim for dims, _ in arrays.values() for dim in dims}
    names = {**contents.coords, **(coords or {})}

    out = xr.Dataset(arrays, coords={dim: values for dim, values in names.items() if dim in used})
    for dim in ("chain", "draw"):
        if dim in used:
            out = out.assign_coords({dim: np.arange(out.sizes[dim])})

    units = UNITS | contents.units
    for name in out.data_vars:
        out[name].attrs["units"] = units.get(str(name), "1")
    if "time" in out.coords:
        out["time"].attrs["units"] = "s"
    return out


def _of_chains(name: str, values: Tensor, contents: Contents, draws: int) -> tuple[list[str], Tensor]:
    """A chain's values (M, …) as those of its draws; an entry is a joint's where there are as many as joints."""
    joints = len(contents.coords.get("joint", ()))
    dims = ["joint" if size == joints else f"{name}_dim_{axis}" for axis, size in enumerate(values.shape[1:])]
    return [*DRAWS, *dims], values.unsqueeze(1).expand(-1, draws, *values.shape[1:])


def _equal_weights(chains: int, log_evidence: float, sd: float) -> OuterWeights:
    """Chains of a method that does not weigh them."""
    log_weights = torch.full((chains,), -math.log(chains), dtype=torch.float64)
    return OuterWeights(log_weights, float(chains), log_evidence, sd, math.nan)


def _outer_attributes(outer: OuterWeights) -> dict[str, float]:
    return {
        "outer_ess": outer.ess,
        "log_evidence": outer.log_evidence,
        "log_evidence_sd": outer.log_evidence_sd,
        "log_evidence_spread": outer.filter_sd,
    }


def combine(parts: Sequence[az.InferenceData], seed: int) -> az.InferenceData:
    """One posterior from several sets of filters of one recording, chains in order, outer weights made anew.

    Where the parts' bodies differ, their links' numbers become variables of the posterior.
    """
    body = [str(name) for name, each in parts[0]["constant_data"].data_vars.items() if "link" in each.dims]
    varies = any(not part["constant_data"][body].equals(parts[0]["constant_data"][body]) for part in parts)
    groups: dict[str, Any] = {}
    for group in ("posterior", "posterior_predictive", "log_likelihood", "sample_stats"):
        pieces = []
        for part in parts:
            piece = part[group]
            if group == "posterior" and varies:
                constant = part["constant_data"][body]
                over = {dim: piece.sizes[dim] for dim in ("chain", "draw")}
                piece = piece.merge(constant.expand_dims(over))
            pieces.append(piece)
        joined = xr.concat(pieces, dim="chain", combine_attrs="override")
        groups[group] = joined.assign_coords(chain=np.arange(joined.sizes["chain"]))
    outer = outer_weights(torch.as_tensor(groups["sample_stats"]["log_evidence"].values))
    groups["sample_stats"]["log_weight"] = (["chain"], outer.log_weights.numpy(), {"units": "nat"})

    # Draws of a part already weigh the same: what is left to weigh is one part against another.
    sizes = [part["posterior"].sizes["chain"] for part in parts]
    shares = torch.cat(
        [part.logsumexp(0).sub(math.log(len(part))).expand(len(part)) for part in outer.log_weights.split(sizes)]
    )
    idata = az.InferenceData(**groups, observed_data=parts[0]["observed_data"], constant_data=parts[0]["constant_data"])
    idata.attrs.update(parts[0].attrs | _outer_attributes(outer) | {"seed": seed})
    with seeded(seed):
        return equally_weighted(idata, shares)


DRAWN = ("posterior", "posterior_predictive", "log_likelihood")
"""Groups of draws."""


def equally_weighted(idata: az.InferenceData, log_weights: Tensor) -> az.InferenceData:
    """Return ``idata`` with draws that all weigh the same, as many as before.

    Draws are resampled systematically by the weight of their chain (M,), in order (Kitagawa 1996). Chains that weigh
    the same stay as they are. Random numbers are torch's own (global seed).
    """
    if not bool((log_weights == log_weights[0]).all()):
        chains, draws = (idata["posterior"].sizes[dim] for dim in DRAWS)
        chosen = resample(log_weights.repeat_interleave(draws)[None], "systematic")[0]
        chain, draw = (index.reshape(chains, draws).numpy() for index in (chosen // draws, chosen % draws))
        pick = {"chain": xr.DataArray(chain, dims=DRAWS), "draw": xr.DataArray(draw, dims=DRAWS)}
        for group in [each for each in DRAWN if each in idata.groups()]:
            data = idata[group].isel(pick).transpose(*DRAWS, ...)
            idata[group] = data.assign_coords(chain=np.arange(chains), draw=np.arange(draws))
    idata.attrs["draws"] = "equally weighted"
    return idata


def pooled(idata: az.InferenceData, group: str = "posterior") -> xr.Dataset:
    """Draws of ``group`` of all chains with dims (sample, …)."""
    data = idata[group]
    stacked = data.drop_vars([dim for dim in DRAWS if dim in data.coords]).stack(sample=DRAWS, create_index=False)
    return stacked.transpose("sample", ...)


def summarise(idata: az.InferenceData) -> pd.DataFrame:
    """``az.summary`` of the torques (mean, sd, 90 % interval, mixing), one row per time and joint."""
    table = az.summary(idata, var_names=["torque"], hdi_prob=0.9)
    assert isinstance(table, pd.DataFrame)  # as its argument fmt says
    return table


def save_posterior(idata: az.InferenceData, path: str | Path) -> None:
    """Write netCDF, whole or not at all. Raises OSError when ``path`` cannot be written."""
    with atomic_path(path) as temporary:
        idata.to_netcdf(str(temporary), engine="h5netcdf")


def load_posterior(path: str | Path) -> az.InferenceData:
    """Read what :func:`save_posterior` wrote.

    Raises FileNotFoundError, or InputError when the file is damaged or is not a posterior of ours, with which of its
    variables is not as :mod:`.layout` has it.
    """
    if not resolved(path).exists():
        raise FileNotFoundError(2, "no such posterior", str(path))
    check_readable(path)
    try:
        with h5py.File(path) as store:  # where this fails, h5netcdf complains once more when it is dropped
            dict(store.attrs)
        idata = az.from_netcdf(str(path), engine="h5netcdf")
        check_size(idata, path)
        idata.load()
    except InputError:
        raise
    except Exception as error:  # a broken file fails anywhere inside HDF5, xarray or ArviZ
        raise InputError(f"{path} is damaged or not netCDF: {first_line(error)}") from error
    with about(path):
        check_layout(idata)
    if "draws" in idata.attrs:
        return idata
    # A file of version 0.2 or before: its chains still have to be weighed.
    with seeded(int(idata.attrs.get("seed", 0))):
        return equally_weighted(idata, torch.as_tensor(idata["sample_stats"]["log_weight"].values))
