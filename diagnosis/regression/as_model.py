"""The simulation along a measured motion, with effects: which torque it misses, and where it runs to by itself.

    e = (D(θ) + I_own) (θ̈ − θ̈_model(θ, θ̇, u))        N·m, rows of the motion, through the regression's low-pass filter

Of a passive log D is the file's for every model: where no torque is known, a lighter arm would miss less of it.
A replay starts at the smoothed angles and velocities and runs for `replay_horizons` seconds.

Shapes: R rows, K joints, W windows. Units: rad, s, N·m.
"""

import math
from collections.abc import Mapping
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import torch
from torch import Tensor

from invdyn.diagnosis.catalogue.linear_laws import INERTIAL, WITHIN
from invdyn.diagnosis.regression.low_pass import low_passed
from invdyn.diagnosis.regression.measured_motion import MeasuredMotion
from invdyn.diagnosis.regression.regressors import link_axes, nominal_link_numbers
from invdyn.diagnosis.regression.shaped_effects import SHARE
from invdyn.diagnosis.rules import FIXED
from invdyn.inference.posterior.initialise import arm_problem
from invdyn.models import ArmModel, ArticulatedBody, Body
from invdyn.models.bodies.point_mass import point_moments
from invdyn.models.effects import EFFECTS
from invdyn.models.effects.base import ABRUPT, Effect
from invdyn.models.effects.composition import own_values
from invdyn.recordings import Recording

Coefficients = Mapping[tuple[str, str, str], float]
"""By effect, place and parameter."""


def model_on(motion: MeasuredMotion, body: ArticulatedBody, passive: bool) -> ArmModel:
    """The simulation as it is on the rows of a motion, under its commands.

    A command is the mean of half a step to each side of a row, and constant there. Each number of a link is its own:
    no moment of inertia follows a mass.
    """
    if isinstance(body, Body) and body.is_chain:
        stated = [replace(e, com=e.nominal("com"), inertia=e.nominal("inertia")) for e in body.links]
        body = replace(body, links=tuple(stated), uncertainty={})
    nothing = np.empty((len(motion.time), 0, body.dimensions))
    rows = Recording(motion.time, nothing, (), None, motion.q, motion.command, body.joint_names)
    step = float(np.median(np.diff(motion.time)))
    model = arm_problem(rows, body, passive=passive, substeps=1).model
    model = model.in_substeps(max(1, math.ceil(step / ABRUPT - 1e-9)))
    if model.command is None:
        return model
    return model.driven_by(model.time - step / 2, model.command)


def with_coefficients(model: ArmModel, found: Coefficients) -> ArmModel:
    """The model with what a regression found."""
    effects: dict[str, Effect] = {}
    values: dict[str, float] = {}

    def add(kind: str, place: str, **parameters: float) -> None:
        every = EFFECTS[kind].everywhere(model.body, [])
        effect = effects.setdefault(f"{kind}.{place}", next(e for e in every if ".".join(e.where) == place))
        for name, value in parameters.items():
            key = f"effect.{effect.key}.{name}"
            values[key] = values.get(key, 0.0) + value

    for (kind, place, name), value in found.items():
        if kind == INERTIAL or name == SHARE.name:
            continue  # a law that is there in part is there
        if kind in WITHIN:
            add(WITHIN[kind], place, stiffness=0.0, torque=-value)
        else:
            add(kind, place, **{name: value})
    changed = {name: torch.tensor([value], dtype=torch.float64) for name, value in values.items()}
    links = {key: value for key, value in found.items() if key[0] == INERTIAL}
    if links:
        changed |= _links(model, links)
    return model.with_effects(*effects.values()).replace(**changed)


def _links(model: ArmModel, found: Coefficients) -> dict[str, Tensor]:
    """Masses, centres and inertias of links whose m, m c and J are others; what is no body's is kept above nothing."""
    body = model.body
    names = {name: n for n, name in enumerate(body.link_names)}
    mass, first, second = (each.copy() for each in nominal_link_numbers(body))
    order = {"mass": mass, "first moment": first, "second moment": second}
    rows = {word: [f"{word} {a}".strip() for a in axes] for word, axes in zip(order, link_axes(body), strict=True)}
    for (_, place, name), value in found.items():
        word = next(each for each in order if name.startswith(each))
        order[word][rows[word].index(name), names[place]] += value
    mass = np.maximum(mass, FIXED.min_link_left * model.parameters["body.mass"].numpy())
    com = torch.as_tensor((first / mass).T)
    own = torch.as_tensor(second.T) - torch.as_tensor(mass.T) * point_moments(com)
    least = FIXED.min_link_left * model.parameters["body.inertia"].reshape(own.shape)
    size = 1 if own.shape[-1] == 1 else 3
    own[:, :size] = torch.maximum(own[:, :size], least[:, :size])
    return {
        "body.mass": torch.as_tensor(mass[0]),
        "body.com": com.reshape(model.parameters["body.com"].shape).contiguous(),
        "body.inertia": own.reshape(model.parameters["body.inertia"].shape).contiguous(),
    }


def torque_missed(model: ArmModel, motion: MeasuredMotion, cutoff: float, file: ArmModel | None = None) -> np.ndarray:
    """E (R, K) of the top of the file, with the inertia of ``file`` where it is given."""
    rows, body, q = torch.arange(len(motion.time)), model.body_parameters(), _true_angles(model, motion.q)
    still = np.zeros((len(motion.time), model.state_dim - 2 * motion.q.shape[1]))
    state = torch.as_tensor(np.concatenate([still, q, motion.qd], -1))
    with torch.no_grad():
        missing = torch.as_tensor(motion.qdd) - model.acceleration(state, rows, body)
        by = file or model
        inertia = by.dynamics.inertia_matrix(q, by.body_parameters())
        own = by.effects.inertia(by.parameters, motion.q.shape[1])
    inertia = inertia if own is None else inertia + torch.diag_embed(own)
    return low_passed((inertia @ missing.unsqueeze(-1))[..., 0].numpy(), motion, cutoff)


def _true_angles(model: ArmModel, q: np.ndarray) -> Tensor:
    """Angles (R, K) of joints whose encoders, with what an effect adds to each, show ``q``."""
    true = shown = torch.as_tensor(q)
    for effect in model.effects:
        if effect.sensor == "encoders" and hasattr(effect, "angles"):
            values = own_values(effect, model.parameters)
            true = true + shown - effect.angles(values, SimpleNamespace(angles=shown))
    return true


def windows(motion: MeasuredMotion) -> np.ndarray:
    """Rows (W,) at which replays start: a quarter of the longest horizon apart, with room for all of it."""
    step = float(np.median(np.diff(motion.time)))
    length = round(FIXED.replay_horizons[-1] / step)
    found = []
    for number in np.unique(motion.stretch):
        rows = np.flatnonzero(motion.stretch == number)
        found += list(rows[: max(len(rows) - length, 0) : max(length // 4, 1)])
    return np.array(found, dtype=int)


def replay_errors(model: ArmModel, motion: MeasuredMotion, starts: np.ndarray) -> np.ndarray:
    """Rms (H, W) rad of angles over each horizon of replays from ``starts`` (W,); a half turn where one runs away."""
    step = float(np.median(np.diff(motion.time)))
    lengths = [max(round(horizon / step), 1) for horizon in FIXED.replay_horizons]
    still = np.zeros((len(starts), model.state_dim - 2 * motion.q.shape[1]))
    q = _true_angles(model, motion.q).numpy()
    state = torch.as_tensor(np.concatenate([still, q[starts], motion.qd[starts]], -1))
    total, found = np.zeros(len(starts)), []
    with torch.no_grad():
        for n in range(1, lengths[-1] + 1):
            rows = np.minimum(starts + n, len(motion.time) - 1)
            state = model.transition_mean(state, torch.as_tensor(rows))
            off = np.nan_to_num(model.split(state)[1].numpy() - q[rows], nan=np.pi, posinf=np.pi, neginf=np.pi)
            total += (np.minimum(np.abs(off), np.pi) ** 2).mean(-1)
            if n in lengths:
                found.append(np.sqrt(total / n))
    return np.array(found)
