"""An effect of a refined cause in the words of the result: place, and parameters with units and intervals."""

import numpy as np
import torch

from invdyn.diagnosis.noise import is_searched
from invdyn.diagnosis.refine import Refined
from invdyn.diagnosis.result import Estimate, Finding
from invdyn.diagnosis.setting import Setting
from invdyn.diagnosis.unknowns import unknowns
from invdyn.models.effects.base import Effect
from invdyn.models.effects.joint_limit import JointLimit

DRAWS = 4000


def place(effect: Effect) -> dict[str, str]:
    """Where an effect acts, "joint", "link" or "keypoint" → name, "partner" for pairs, "stop" for limits."""
    names = list(effect.where)
    if isinstance(effect, JointLimit):
        return {"joint": names[0], "stop": names[1]}
    if effect.site == "pair":  # the torque acts on the outer one
        return {"joint": names[1], "partner": names[0]}
    if effect.site == "keypoints":
        return {"keypoint": names[0], "partner": names[1]}
    if not names:
        return {}
    return {"joint" if effect.site == "arm" else effect.site: names[0]}


def key(effect: Effect) -> str:
    """Effect and place as :attr:`.Finding.key` has it."""
    return ".".join([effect.name, *place(effect).values()])


def finding(setting: Setting, cause: Refined, effect: Effect, seed: int) -> Finding:
    """Posterior of one effect's parameters, by draws from the refined Gaussian within the bounds."""
    parameters = effect.parameters(setting.model.scale)
    draws = _draws(setting, cause, effect, seed)
    described = {
        name: (values.reshape(-1).numpy(), unit)
        for name, (values, unit) in effect.described({n: torch.as_tensor(v)[:, None] for n, v in draws.items()}).items()
    } or {p.name: (draws[p.name], p.unit) for p in parameters}
    estimates = {}
    for name, (values, unit) in described.items():
        low, high = np.quantile(values, [0.05, 0.95])
        estimates[name] = Estimate(float(values.mean()), float(values.std()), (float(low), float(high)), unit)
    return Finding(effect.name, effect.side, place(effect), estimates)


def _draws(setting: Setting, cause: Refined, effect: Effect, seed: int) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    names = [f"{effect.key}.{p.name}" for p in effect.parameters(setting.model.scale)]
    if is_searched(effect):
        return {
            name.rsplit(".", 1)[1]: cause.noise[name]
            * np.exp(np.nan_to_num(cause.noise_sd.get(name, 0.0)) / cause.noise[name] * rng.standard_normal(DRAWS))
            for name in names
        }
    among = unknowns(setting, cause.effects)
    drawn = rng.multivariate_normal(cause.mean, cause.covariance, DRAWS, method="eigh")
    drawn = np.clip(drawn, among.lower, among.upper)
    return {name.rsplit(".", 1)[1]: drawn[:, among.names.index(name)] for name in names}
