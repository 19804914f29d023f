"""The posterior as ``arviz.InferenceData``: torques, angles, velocities with names and units.

Layout (dims in brackets; ``chain`` is an independent filter, ``draw`` a smoothed trajectory of it):

    posterior             torque [chain, draw, time, joint] N·m (not of a kinematic model), angle rad, velocity rad/s,
                          position [chain, draw, time, keypoint, space] of the tips;
                          residual_torque if commanded
    posterior_predictive  position and angle with observation noise
    sample_stats          log_evidence [chain] (or a bound on it), log_weight [chain] (outer, normalised);
                          of particle filters also ess, resampled and log_evidence_increment
                          [chain, time]; attributes: method, bound (1: log_evidence is a lower bound),
                          seconds (see :mod:`.registry`), and the method's own diagnostics
    observed_data         position [time, keypoint, space], angle [time, joint]
    constant_data         the model's parameters, command, truth; in space smallest_singular_value [time] of the
                          tracked sites' Jacobian and unseen [time, joint], 1 where no keypoint tells a
                          coordinate (:mod:`.visibility`), which the attribute "unseen" says in words; "charts" says
                          which joints' frames were turned, and which pass a pole all the same (:mod:`.charts`)

Draws are equally weighted within a chain; chains weigh exp(log_weight). :func:`pooled` resamples
them to equal weights: what tables and figures use.
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
from invdyn.inference.posterior.initialise import Problem
from invdyn.inference.posterior.layout import check_layout, check_size
from invdyn.inference.posterior.visibility import unseen_lines, visibility
from invdyn.models import ArmModel
from invdyn.models.bodies.protocol import axes
from invdyn.recordings import InputError, atomic_path, check_readable, resolved
from invdyn.recordings.errors import about, first_line


def to_inference_data(
    problem: Problem,
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
) -> az.InferenceData:
    """Assemble InferenceData.

    Args:
        problem: model, observations, recording.
        paths: (M, R, T, D) smoothed trajectories.
        result: the filters' run; None for a method without particles, whose chains weigh the same.
        method: its name.
        seed: that was used.
        settings: fitted parameters and options, kept as JSON in the attributes.
        log_evidence, log_evidence_sd: without ``result``: log p(y) or a bound on it, nats, and its Monte
            Carlo standard error; NaN where the method has none.
        bound: whether the evidence is a lower bound.
        diagnostics: numbers for the attributes of sample_stats.
    """
    model, recording = problem.model.to(dtype=torch.float64), problem.recording
    body = model.body
    paths = paths.double()
    if result is None:
        outer = _equal_weights(len(paths), log_evidence, log_evidence_sd)
        each = torch.full((len(paths),), log_evidence, dtype=torch.float64)
    else:
        outer, each = outer_weights(result.log_evidence), result.log_evidence
    units = _units(recording.length_unit)
    _, angle, velocity = model.split(paths)
    moved = isinstance(model, ArmModel)
    torque = {"torque": (["chain", "draw", "time", "joint"], model.net_torque(paths))} if moved else {}
    posterior = torque | {
        "angle": (["chain", "draw", "time", "joint"], angle),
        "velocity": (["chain", "draw", "time", "joint"], velocity),
        "position": (
            ["chain", "draw", "time", "keypoint", "space"],
            model.dynamics.keypoints(angle, model.body_parameters()),
        ),
    }
    if moved and model.command is not None:
        residual = paths[..., : body.num_joints]
        posterior["residual_torque"] = (["chain", "draw", "time", "joint"], residual)
    rows = torch.arange(model.num_steps)
    sampled = model.emission(paths, rows).sample()
    predictive: dict[str, tuple] = {}
    observed: dict[str, tuple] = {}
    seen: dict[str, list[str]] = {}
    for sensor in model.observation.sensors:
        dims = list(sensor.coords)
        predictive[sensor.name] = (["chain", "draw", "time", *dims], model.observation.of(sensor, sampled))
        observed[sensor.name] = (["time", *dims], model.observation.of(sensor, problem.observations))
        units |= {sensor.name: recording.length_unit if sensor.unit == "length" else sensor.unit}
        seen |= {dim: list(names) for dim, names in sensor.coords.items()}
    stats = {"log_evidence": (["chain"], each), "log_weight": (["chain"], outer.log_weights)}
    if result is not None:
        stats |= {
            "ess": (["chain", "time"], result.ess.mT),
            "resampled": (["chain", "time"], result.resampled.mT),
            "log_evidence_increment": (["chain", "time"], result.log_evidence_increment.mT),
        }
    coords = {
        "time": recording.time,
        "joint": list(body.joint_names),
        "space": axes(body),
        "link": list(body.link_names),
        "keypoint": list(body.keypoint_names),
    }

    def dataset(variables: dict, own: dict[str, list[str]] | None = None) -> xr.Dataset:
        arrays = {name: (dims, np.asarray(values)) for name, (dims, values) in variables.items()}
        used = {d for dims, _ in arrays.values() for d in dims}
        out = xr.Dataset(arrays, coords={k: v for k, v in {**coords, **(own or {})}.items() if k in used})
        for dim in ("chain", "draw"):
            if dim in used:
                out = out.assign_coords({dim: np.arange(out.sizes[dim])})
        for name in out.data_vars:
            out[name].attrs["units"] = units.get(str(name), "1")
        if "time" in out.coords:
            out["time"].attrs["units"] = "s"
        return out

    constants = _constants(problem)
    notes: dict[str, Any] = {"charts": "\n".join(problem.notes)} if problem.notes else {}
    if body.space == 3:
        smallest, unseen = visibility(model, problem.observations, angle.mean((0, 1)))
        constants["smallest_singular_value"] = (["time"], smallest)
        constants["unseen"] = (["time", "joint"], unseen.astype(np.int8))
        if lines := unseen_lines(unseen, body.joint_names):
            notes["unseen"] = "\n".join(lines)
    groups: dict[str, Any] = {
        "posterior": dataset(posterior),
        "posterior_predictive": dataset(predictive, seen),
        "sample_stats": dataset(stats),
        "observed_data": dataset(observed, seen),
        "constant_data": dataset(constants),
    }
    # netCDF knows no booleans.
    groups["sample_stats"].attrs.update({"method": method, "bound": int(bound), **(diagnostics or {})})
    idata = az.InferenceData(**groups)
    idata.attrs.update(_attributes(problem, outer, method, seed, settings) | notes)
    return idata


def _equal_weights(chains: int, log_evidence: float, sd: float) -> OuterWeights:
    """Chains of a method that does not weigh them."""
    log_weights = torch.full((chains,), -math.log(chains), dtype=torch.float64)
    return OuterWeights(log_weights, float(chains), log_evidence, sd, math.nan)


def _units(length: str) -> dict[str, str]:
    torque = "N·m" if length == "m" else f"kg·({length})²/s²"
    units = {"angle": "rad", "velocity": "rad/s", "position": length, "length": length, "mass": "kg"}
    units |= dict.fromkeys(("torque", "residual_torque", "command", "truth_torque"), torque)
    units |= {"truth_angle": "rad", "truth_velocity": "rad/s", "com": length}
    units |= dict.fromkeys(("base", "origin", "sites"), length)
    units |= {"gravity": f"{length}/s²", "log_evidence": "nat", "smallest_singular_value": f"{length}/rad"}
    units |= {"inertia": f"kg·({length})²" if length != "m" else "kg·m²"}
    return units | {"log_weight": "nat", "log_evidence_increment": "nat", "ess": "particles"}


def _constants(problem: Problem) -> dict:
    model, truth = problem.model, problem.truth
    constants = dict(model.body.described(model.body_parameters()))
    if isinstance(model, ArmModel) and model.command is not None:
        constants["command"] = (["time", "joint"], model.command)
    if truth is not None:
        order = [truth.joint_names.index(name) for name in model.body.joint_names]
        for name in ("torque", "angle", "velocity"):
            constants[f"truth_{name}"] = (["time", "joint"], getattr(truth, name)[:, order])
    return constants


def _attributes(problem: Problem, outer: OuterWeights, method: str, seed: int, settings: dict) -> dict:
    return {
        "method": method,
        "seed": seed,
        "recording": problem.recording.name,
        "body": problem.model.body.name,
        "length_unit": problem.recording.length_unit,
        "model": "dynamic" if isinstance(problem.model, ArmModel) else "kinematic",
        **_outer_attributes(outer),
        "settings": json.dumps(settings, sort_keys=True),
        "invdyn_version": version("invdyn"),
    }


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
    for group in ("posterior", "posterior_predictive", "sample_stats"):
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
    idata = az.InferenceData(**groups, observed_data=parts[0]["observed_data"], constant_data=parts[0]["constant_data"])
    idata.attrs.update(parts[0].attrs | _outer_attributes(outer) | {"seed": seed})
    return idata


def pooled(idata: az.InferenceData, seed: int = 0, group: str = "posterior") -> xr.Dataset:
    """Equally weighted draws of ``group`` with dims (sample, …): chains resampled by their outer weight."""
    data = idata[group]
    draws = data.sizes["draw"]
    with seeded(seed):
        weights = torch.as_tensor(idata["sample_stats"]["log_weight"].values)
        # As many samples as there are draws, each chain's own draws taken in turn.
        chosen = resample(weights.repeat_interleave(draws).unsqueeze(0))[0].numpy()
    return data.isel(
        chain=xr.DataArray(chosen // draws, dims="sample"), draw=xr.DataArray(chosen % draws, dims="sample")
    )


def summarise(idata: az.InferenceData, seed: int = 0) -> pd.DataFrame:
    """``az.summary`` of the torques (mean, sd, 90 % interval) over outer-weighted draws, one row per time and joint."""
    data = pooled(idata, seed)[["torque"]].drop_vars(["chain", "draw"]).expand_dims("chain")
    data = data.rename(sample="draw").assign_coords(draw=np.arange(data.sizes["sample"]))
    # The draws are a weighted sample and no Markov chain: mixing diagnostics would mean nothing.
    table = az.summary(az.InferenceData(posterior=data), kind="stats", hdi_prob=0.9)
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
    return idata
