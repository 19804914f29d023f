"""The posterior as ``arviz.InferenceData``, of any problem.

Layout (dims in brackets):

    posterior             what the problem names: :mod:`.arm_contents` of an arm, else state
                          [chain, draw, time, state_name]
    posterior_predictive  the observations that each draw predicts, with noise
    log_likelihood        y [chain, draw, time], log p(y_t | x_t) of each row that holds an observation, nat
    sample_stats          log_evidence [filter] (or a bound on it), log_weight [filter] (outer, normalised);
                          of particle filters also ess, resampled and log_evidence_increment
                          [filter, time], the last of SMC² too; of NUTS ArviZ's own [chain, draw];
                          attributes: method, bound (1: log_evidence is a lower bound), usable (0: log_evidence is
                          none, and "doubt" says why), of particle filters guide, seconds (see :mod:`.registry`), and
                          the method's own diagnostics
    observed_data         as posterior_predictive, without chain and draw
    constant_data         the model's parameters, and what else is known

Draws are equally weighted (:func:`equally_weighted`), as ArviZ takes them to be. Copies of one trajectory stand next
to one another, so that ArviZ's effective sample size and R-hat count them once. Filters of few draws each are joined to
a few long chains, for ArviZ's figures of chains of four draws mean nothing.
"""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from importlib.metadata import version
from typing import Any

import arviz as az
import numpy as np
import torch
import xarray as xr
from torch import Tensor

from invdyn.inference.execution.seeds import seeded
from invdyn.inference.filters.nested import OuterWeights, outer_weights
from invdyn.inference.filters.particles import FilterResult
from invdyn.inference.filters.resampling import resample
from invdyn.inference.filters.second_opinion import evidence, scatter_doubt
from invdyn.inference.posterior.problem import DRAWS, Contents, StateSpaceProblem, Variables
from invdyn.models.state_space import StateSpaceModel


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
    diagnostics: Mapping[str, float | str] | None = None,
    statistics: Mapping[str, np.ndarray] | None = None,
    parameters: Mapping[str, Tensor] | None = None,
    log_weights: Tensor | None = None,
    log_evidence_increment: Tensor | None = None,
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
        diagnostics: numbers and words for the attributes of sample_stats.
        statistics: of each draw (M, R), for sample_stats, by the names that ArviZ knows.
        parameters: values (M, R, …) that differ between draws, which become variables of the posterior.
        log_weights: (M, R) of each draw; that of its chain by default.
        log_evidence_increment: without ``result``: (T,) log p(y_t | y_{0:t−1}), whose sum is the log-evidence.

    Draws are equally weighted at last (:func:`equally_weighted`), by random numbers of torch's global generator.
    """
    model = problem.model.to(dtype=torch.float64)
    if result is None:
        outer = _equal_weights(len(paths), log_evidence, log_evidence_sd)
        each = torch.full((len(paths),), log_evidence, dtype=torch.float64)
    else:
        outer, each = outer_weights(result.log_evidence), result.log_evidence

    contents, likelihood = _of_paths(replace(problem, model=model), paths)
    seen = ~torch.isnan(problem.observations).all(-1).numpy()

    stats: Variables = {"log_evidence": (["filter"], each), "log_weight": (["filter"], outer.log_weights)}
    if result is not None:
        stats |= {
            "ess": (["filter", "time"], result.ess.mT),
            "resampled": (["filter", "time"], result.resampled.mT),
            "log_evidence_increment": (["filter", "time"], result.log_evidence_increment.mT),
        }
    elif log_evidence_increment is not None:
        rows = log_evidence_increment.expand(len(paths), -1)
        stats["log_evidence_increment"] = (["filter", "time"], rows)
    stats |= {name: (DRAWS, values) for name, values in (statistics or {}).items()}

    own = {name: _of_draws(name, values, contents) for name, values in (parameters or {}).items()}
    posterior = _dataset(contents, contents.posterior | own)
    for name in own:  # whose unit only the caller knows
        del posterior[name].attrs["units"]

    groups: dict[str, Any] = {
        "posterior": posterior,
        "posterior_predictive": _dataset(contents, contents.predictive, contents.observed_coords),
        "log_likelihood": _dataset(
            contents,
            {"y": ([*DRAWS, "time"], likelihood[..., seen])},
            {"time": np.asarray(contents.coords["time"])[seen]},
        ),
        "sample_stats": _dataset(contents, stats),
        "observed_data": _dataset(contents, contents.observed, contents.observed_coords),
        "constant_data": _dataset(contents, contents.constants),
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
    weights = outer.log_weights.unsqueeze(-1).expand(paths.shape[:2]) if log_weights is None else log_weights
    return equally_weighted(idata, weights.flatten(), joined_chains(*paths.shape[:2]))


SINGLE_FROM, AT_ONCE = 4_000_000, 500_000
"""Numbers of drawn states from which a posterior is kept in single precision, and how many of those are a block."""
LONG_PATH = 16_000
"""The same of one path's numbers: parts of a posterior then have the precision of the whole."""


def stored_dtype(*shape: int) -> torch.dtype:
    """Precision of draws of that ``shape`` (M, R, T, D): seven digits will do where there are very many."""
    many = math.prod(shape) >= SINGLE_FROM or math.prod(shape[-2:]) >= LONG_PATH
    return torch.float32 if many else torch.float64


def _of_paths(problem: StateSpaceProblem, paths: Tensor) -> tuple[Contents, np.ndarray]:
    """What a posterior holds of paths (M, R, T, D), and log p(y_t | x_t) (M, R, T): all at once, or block by block."""
    dtype = stored_dtype(*paths.shape)
    size = max(1, len(paths) * AT_ONCE // paths.numel()) if dtype == torch.float32 else len(paths)
    stored: dict[tuple[str, str], np.ndarray] = {}
    for first in range(0, len(paths), size):
        some = paths[first : first + size]
        some = some.double() if some.is_floating_point() else some  # a finite model numbers its states
        own = replace(problem, model=_of_chains(problem.model, slice(first, first + size), len(paths)))
        contents = own.contents(some, own.model.sample_observations(some))
        likelihood = own.model.log_likelihood(some, problem.observations.double())
        if len(some) == len(paths):
            return contents, likelihood.numpy()
        of_draws: dict[str, Variables] = {"posterior": contents.posterior, "predictive": contents.predictive}
        for group, variables in (of_draws | {"likelihood": {"y": (DRAWS, likelihood)}}).items():
            for name, (_, values) in variables.items():
                values = np.asarray(values)
                if first == 0:
                    stored[group, name] = np.empty((len(paths), *values.shape[1:]), np.float32)
                stored[group, name][first : first + size] = values
    whole = {
        group: {name: (dims, stored[group, name]) for name, (dims, _) in variables.items()}
        for group, variables in of_draws.items()
    }
    return replace(contents, posterior=whole["posterior"], predictive=whole["predictive"]), stored["likelihood", "y"]


def _of_chains(model: StateSpaceModel, chains: slice, count: int) -> StateSpaceModel:
    """The model of some of ``count`` chains, where each chain has parameters of its own, (M, 1, 1, own shape)."""
    own = {name: value[chains] for name, value in model.parameters.items() if value.shape[:3] == (count, 1, 1)}
    return model.replace(**own) if own else model


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
    for dim in ("filter", *DRAWS):
        if dim in used:
            out = out.assign_coords({dim: np.arange(out.sizes[dim])})

    units = UNITS | contents.units
    for name in out.data_vars:
        out[name].attrs["units"] = units.get(str(name), "1")
    if "time" in out.coords:
        out["time"].attrs["units"] = "s"
    return out


def _of_draws(name: str, values: Tensor, contents: Contents) -> tuple[list[str], Tensor]:
    """Values (M, R, …) with their dimensions; an entry is a joint's where there are as many as joints."""
    joints = len(contents.coords.get("joint", ()))
    own = ["joint" if size == joints else f"{name}_dim_{axis}" for axis, size in enumerate(values.shape[2:])]
    return [*DRAWS, *own], values


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
    """One posterior from several sets of filters of one recording, in order, with new outer weights.

    Where the parts' bodies differ, their links' numbers become variables of the posterior. The parts lose their draws,
    so that memory never has all of them twice.
    """
    body = [str(name) for name, each in parts[0]["constant_data"].data_vars.items() if "link" in each.dims]
    varies = any(not part["constant_data"][body].equals(parts[0]["constant_data"][body]) for part in parts)

    draws = [part["posterior"].sizes["chain"] * part["posterior"].sizes["draw"] for part in parts]
    groups: dict[str, Any] = {}
    for group in DRAWN:
        pieces = [pooled(part, group) for part in parts]
        if group == "posterior" and varies:
            constants = [part["constant_data"][body] for part in parts]
            pieces = [
                piece.merge(constant.expand_dims(sample=piece.sizes["sample"]))
                for piece, constant in zip(pieces, constants, strict=True)
            ]
        joined = xr.concat(pieces, dim="sample", combine_attrs="override")
        groups[group] = joined.rename(sample="draw").expand_dims("chain")
        del pieces
        for part in parts:
            del part[group]
    statistics = xr.concat([part["sample_stats"] for part in parts], dim="filter", combine_attrs="override")
    groups["sample_stats"] = statistics.assign_coords(filter=np.arange(statistics.sizes["filter"]))

    outer = outer_weights(torch.as_tensor(statistics["log_evidence"].values))
    groups["sample_stats"]["log_weight"] = (["filter"], outer.log_weights.numpy(), {"units": "nat"})
    groups["sample_stats"].attrs.update(_doubts(parts, outer))
    idata = az.InferenceData(**groups, observed_data=parts[0]["observed_data"], constant_data=parts[0]["constant_data"])
    idata.attrs.update(parts[0].attrs | _outer_attributes(outer) | {"seed": seed})

    # Draws of a part already weigh the same: what is left to weigh is one part against another.
    filters = [part["sample_stats"].sizes["filter"] for part in parts]
    shares = [
        (weights.logsumexp(0) - math.log(count)).expand(count)
        for weights, count in zip(outer.log_weights.split(filters), draws, strict=True)
    ]
    with seeded(seed):
        return equally_weighted(idata, torch.cat(shares), joined_chains(sum(filters), sum(draws) // sum(filters)))


DRAWN = ("posterior", "posterior_predictive", "log_likelihood")
"""Groups of draws."""

MIN_OUTER_ESS = 32
"""Filters, or half of them where there are fewer: of fewer that count, the bands of another run would differ."""
LONG_CHAIN = 32
"""Draws with which a chain stands by itself: ArviZ's effective sample size of shorter ones is its upper limit."""

JOINED_CHAINS = 4
"""Chains that shorter ones are joined to: R-hat needs several."""


def joined_chains(filters: int, draws: int) -> int:
    """Number of chains that M filters of R draws become: M, or fewer and longer ones where a filter has few draws."""
    if draws >= LONG_CHAIN:
        return filters
    return next(count for count in range(min(filters, JOINED_CHAINS), 0, -1) if filters * draws % count == 0)


def equally_weighted(idata: az.InferenceData, log_weights: Tensor, chains: int) -> az.InferenceData:
    """Return ``idata`` with draws that all weigh the same, as many as before.

    Draws are resampled systematically by their weight, (S,) over all chains and draws, in order (Kitagawa 1996); ones
    that weigh the same stay as they are. Then they are laid out as so many ``chains``. Random numbers are torch's own
    (global seed).
    """
    same = torch.allclose(log_weights, log_weights[:1], rtol=0.0, atol=1e-9)
    chosen = None if same else resample(log_weights[None], "systematic")[0].numpy()

    def laid_out(values: xr.DataArray) -> xr.Variable:
        values = values.transpose(*DRAWS, ...)
        flat = values.to_numpy().reshape(-1, *values.shape[2:])  # of equal weights no copy
        flat = flat if chosen is None else flat[chosen]
        return xr.Variable(values.dims, flat.reshape(chains, -1, *flat.shape[1:]), values.attrs)

    for group in [each for each in DRAWN if each in idata.groups()]:
        data = idata[group]
        drawn = {name: laid_out(values) for name, values in data.data_vars.items() if {*DRAWS} <= {*values.dims}}
        data = data.drop_vars([*drawn, *(dim for dim in DRAWS if dim in data.coords)]).assign(drawn)
        # An item that is set would stand twice among the groups.
        setattr(idata, group, data.assign_coords({dim: np.arange(data.sizes[dim]) for dim in DRAWS}))
    idata.attrs["draws"] = "equally weighted"
    return idata


def _doubts(parts: Sequence[az.InferenceData], outer: OuterWeights) -> dict[str, Any]:
    """Usable only where all filters together are, and each part that weighs; {} of methods that do not doubt."""
    attributes = [part["sample_stats"].attrs for part in parts]
    if not all("usable" in each for each in attributes):
        return {}
    # A part of few filters may well be uneven by itself: what counts is its guide against the pilot's.
    reasons = [scatter_doubt(evidence(outer, ""))] + [
        str(each.get("contradicted", each["doubt"])) for each in attributes
    ]
    reason = next((each for each in reasons if each), "")
    return {"usable": int(not reason), "doubt": reason}


def evidence_note(idata: az.InferenceData) -> str:
    """Text "not usable: …" where the evidence does not stand, else empty."""
    attributes = idata["sample_stats"].attrs
    return "" if attributes.get("usable", 1) else f"not usable: {attributes.get('doubt', '')}"


def uneven(idata: az.InferenceData) -> str:
    """What to do where few of the filters, or of the parameter sets drawn, carry the weight; else empty.

    Without filters all draws of one set weigh the same: unequal weights are those of sets, of the body's numbers too.
    """
    filters, outer = idata["sample_stats"].sizes["filter"], idata.attrs["outer_ess"]
    if not outer < min(MIN_OUTER_ESS, filters / 2):
        return ""
    if "ess" in idata["sample_stats"]:
        return (
            f"{outer:.2g} of {filters} filters carry the weight, so that another seed's bands would differ: raise "
            "--particles, tenfold; if that does not help, the model does not fit: look at the predicted keypoints"
        )
    return (
        f"{100 * outer / filters:.2g} % of the parameter sets drawn carry the weight, so that bands may be too narrow: "
        "state the body's numbers with smaller doubts where the recording knows them better, or take --method smc"
    )


def pooled(idata: az.InferenceData, group: str = "posterior") -> xr.Dataset:
    """Draws of ``group`` of all chains with dims (sample, …)."""
    data = idata[group]
    stacked = data.drop_vars([dim for dim in DRAWS if dim in data.coords]).stack(sample=DRAWS, create_index=False)
    return stacked.transpose("sample", ...)
