"""Diagnose the gap between simulation and recording: measure, locate, screen, confirm, add the cause, measure again.

The parts are files of this room: :mod:`.setting` binds the recording, :mod:`.search` looks for causes by linearised
evidence, :mod:`.confirm` weighs the best by SMC, :mod:`.shrinkage` measures how far the gap closes on held-out data,
:mod:`.describe` puts into a formula what no cause explains, :mod:`.where` says where it lies.

Probabilities. Each cause has a posterior probability p_c by evidence and prior (:mod:`.prior`), and within it the share
s_c of residuals that are next to nothing: little is left once the cause is in. With "no gap" among the causes,

    P(c and nothing else) = p_c s_c,    P(c in part) = p_c (1 − s_c),    P(outside the catalogue) = Σ_c p_c (1 − s_c).

With unknown torque there is always a torque left, which is the limb's own: s_c = 1; and a cause that does not improve
the prediction of held-out rows is taken back.
"""

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import arviz as az
import numpy as np
import torch
from scipy.special import logsumexp

from invdyn.diagnosis.confirm import Confirmed, confirm, posterior
from invdyn.diagnosis.describe import Formula, describe
from invdyn.diagnosis.findings import finding, key
from invdyn.diagnosis.noise import is_noise
from invdyn.diagnosis.predict import WINDOW, best_size, replay, replay_rms, residual, scores, seen_tips, smoothed
from invdyn.diagnosis.refine import Refined
from invdyn.diagnosis.report import write_report
from invdyn.diagnosis.result import (
    Cause,
    Diagnosis,
    Gap,
    Outside,
    Shrinkage,
    Tracks,
    Visibility,
    Where,
)
from invdyn.diagnosis.screen import log_prior, sizes
from invdyn.diagnosis.search import FAINT, Search, data_path, imitable, search
from invdyn.diagnosis.separate import separating_experiment
from invdyn.diagnosis.setting import NotEnoughData, Setting, setting
from invdyn.diagnosis.shrinkage import Closed, closed, held_out_scores
from invdyn.diagnosis.where import where
from invdyn.inference import save_posterior
from invdyn.models import Body
from invdyn.recordings import Recording, joined, write_text

NEAR = 3.0
"""Nats behind the best within which causes are confirmed by SMC, and how many at most."""
CONFIRMED = 2
LITTLE = 0.1
"""Of the residual that the simulation without a cause needs: what is left under a cause that explains the gap."""
CREDIBLE = 0.95
"""Probability that the ambiguity set holds."""
Progress = Callable[[int, int, str], None]


@dataclass(frozen=True)
class _Weighed:
    """Causes with probabilities, sorted, and those of their explaining a part; what the catalogue lacks; SMC by key."""

    causes: dict[str, tuple[Refined, float]]
    in_part: dict[str, float]
    outside: float
    confirmed: dict[str, Confirmed]
    log_evidence: dict[str, float]

    @property
    def best(self) -> Refined:
        """The most probable cause, whatever is left besides it."""
        return next(iter(self.causes.values()))[0]


def diagnose(
    recording: Recording | Sequence[Recording],
    body: Body,
    *,
    held_out: Recording | Sequence[Recording] | None = None,
    passive: bool = False,
    without: Sequence[str] = (),
    seed: int = 0,
    progress: Progress | None = None,
) -> Diagnosis:
    """Diagnose the gap.

    Args:
        recording: keypoints, encoders or both, with the commanded torques where they are known; or several of one arm,
            which then have their causes in common.
        body: the simulation.
        held_out: another recording of the same arm, or several, to measure how far the gap closes; by default the last
            third.
        passive: the torque is known to be zero.
        without: names of effects to leave out of the catalogue.
        seed: same seed, same result.
        progress: called with (done, total, what).

    Raises InputError when the recording does not fit the body. Too few frames are no error but an answer:
    :attr:`.Diagnosis.not_enough_data`.
    """

    def report(stage: int, what: str) -> None:
        if progress is not None:
            progress(stage, 5, what)

    report(0, "bind")
    try:
        bound = setting(recording, body, passive=passive)
        other = None if held_out is None else setting(held_out, body, passive=passive)
    except NotEnoughData as error:
        whole, _ = joined([recording] if isinstance(recording, Recording) else recording)
        return _nothing_to_say(whole, body, seed, passive, str(error))
    report(1, "screen and refine")
    path, stray = data_path(bound)
    bound = bound.shaped(path)
    found = search(bound, path, stray, without)
    report(2, "confirm")
    weighed = _weigh(bound, found, seed)
    report(3, "held out")
    none, time = found.pool[""], (other or bound).model.time.numpy()
    shares = closed(*held_out_scores(bound, none, weighed.best, other), time, seed)
    if bound.regime == "unknown_torque" and shares.per_frame["corrected"] < shares.per_frame["nominal"]:
        # Evidence there rests on the torque's prior, which no limb obeys: a cause must predict what it has not seen.
        weighed = _Weighed({"": (none, 1.0)}, {"": 0.0}, 0.0, {}, weighed.log_evidence)
        shares = closed(*held_out_scores(bound, none, none, other), time, seed)
    best = weighed.best
    report(4, "describe")
    formula = describe(bound, best, best.path) if weighed.outside > 0.2 and bound.regime != "unknown_torque" else None
    result = _assemble(bound, found, weighed, shares, formula, seed, held_out)
    report(5, "done")
    return result


def save(diagnosis: Diagnosis, folder: str | Path) -> None:
    """Write diagnosis.json, report.html and posterior.nc into ``folder``, which exists; each whole or not at all."""
    folder = Path(folder)
    write_text(folder / "diagnosis.json", json.dumps(diagnosis.to_json(), indent=1, ensure_ascii=False) + "\n")
    write_report(diagnosis, folder / "report.html")
    if diagnosis.posterior is not None:
        save_posterior(diagnosis.posterior, folder / "posterior.nc")


def _share_alone(bound: Setting, found: Search, cause: Refined) -> float:
    """Posterior share of residuals that are nothing, or little beside the one that the simulation needs."""
    if bound.regime == "unknown_torque":
        return 1.0
    levels = sizes(bound.regime)
    prior = log_prior(levels)
    weight = found.temper * (cause.by_size - prior) + prior
    little = levels <= max(levels[0], LITTLE * best_size(bound, found.pool[""]))
    return float(np.exp(logsumexp(weight[little]) - logsumexp(weight)))


def _weigh(bound: Setting, found: Search, seed: int) -> _Weighed:
    """Confirm the best by SMC, and turn scores into probabilities."""
    ranked = found.ranked
    close = [c for c in ranked if found.score(c) > found.score(ranked[0]) - NEAR][:CONFIRMED]
    confirmed = {c.key: confirm(bound, c, seed) for c in close}
    evidence = {c.key: c.log_evidence for c in ranked}
    # Filters that collapsed say less than the linearised evidence does; among the others SMC weighs, and they as a
    # whole stand beside those that were not confirmed where the linearised evidence has them.
    if all(np.isfinite(run.log_evidence) and run.log_evidence_sd < 0.3 for run in confirmed.values()):
        apart = evidence[close[0].key] - confirmed[close[0].key].log_evidence
        evidence |= {name: run.log_evidence + apart for name, run in confirmed.items()}
    score = np.array([found.score(c) + found.temper * (evidence[c.key] - c.log_evidence) for c in ranked])
    probability = np.exp(score - logsumexp(score))
    share = np.array([_share_alone(bound, found, c) for c in ranked])
    order = np.argsort(-probability, kind="stable")
    causes = {ranked[i].key: (ranked[i], float(probability[i] * share[i])) for i in order}
    in_part = {ranked[i].key: float(probability[i] * (1 - share[i])) for i in order}
    return _Weighed(causes, in_part, min(sum(in_part.values()), 1.0), confirmed, evidence)


def _assemble(
    bound: Setting,
    found: Search,
    weighed: _Weighed,
    shares: Closed,
    formula: Formula | None,
    seed: int,
    held_out: object,
) -> Diagnosis:
    model, body = bound.model, bound.model.body
    none, best = found.pool[""], weighed.best
    before, before_sd = residual(bound, none)
    after, after_sd = (before, before_sd) if best is none else residual(bound, best)
    path = smoothed(bound, best).path
    _, q, qd = best.model.split(path)
    tips = best.model.dynamics.keypoints(q, best.model.body_parameters()).numpy()
    replays = {
        "nominal": replay(model, _without_hidden(model, path), bound.starts),
        "corrected": replay(best.model, path, bound.starts),
    }
    frame_gap = scores(bound, best).score - scores(bound, none).score
    moved = seen_tips(best.model, path) - tips[:, model.emission_model.tips]
    shifts = (
        np.sqrt((moved**2).sum(-1).mean(0))
        / model.parameters.get("emission.keypoint_scale", torch.ones(moved.shape[1])).numpy()
        if moved.size
        else np.zeros(moved.shape[1])
    )
    causes = tuple(
        Cause(
            tuple(finding(bound, cause, effect, seed) for effect in cause.effects),
            probability,
            weighed.log_evidence[cause.key],
            weighed.confirmed[cause.key].log_evidence_sd if cause.key in weighed.confirmed else float("nan"),
            weighed.in_part[cause.key],
        )
        for cause, probability in weighed.causes.values()
        if probability + weighed.in_part[cause.key] > 1e-4 or cause is best
    )
    causes = tuple(sorted(causes, key=lambda cause: (-cause.probability, -cause.in_part)))
    nothing = weighed.causes.get("", (none, 0.0))[1]
    rivals = _ambiguous(causes)
    joints = body.joint_names
    visibility = tuple(
        Visibility(key(s.effect), s.effect.side, float(s.dprime)) for s in found.first if s.effect is not None
    )
    probability = 1.0 - nothing
    return Diagnosis(
        recording=bound.problem.recording.name,
        body=body.name,
        seed=seed,
        regime=bound.regime,
        gap=Gap(
            detected=probability > 0.5,
            probability=probability,
            elpd_per_frame=shares.per_frame,
            residual_torque_rms=_rms(joints, before),
            replay_rms_m={name: replay_rms(r, tips) for name, r in replays.items()},
        ),
        where=where(
            model,
            weighed.causes,
            weighed.outside,
            before,
            bound.typical.numpy(),
            shifts,
            frame_gap,
            formula.variables if formula else (),
        ),
        causes=causes,
        ambiguity_set=(rivals,) if rivals else (),
        separating_experiment=separating_experiment(
            [f.effect for cause in causes if "+".join(f.key for f in cause.effects) in rivals for f in cause.effects]
        ),
        outside=Outside(
            weighed.outside,
            formula.text if formula else None,
            formula.terms if formula else {},
            float(formula.gain_per_frame) if formula else None,
        ),
        not_identifiable=tuple(
            sorted(
                key(s.effect)
                for s in found.first
                if s.effect is not None
                and (s.dprime < FAINT or (bound.regime == "unknown_torque" and imitable(s.effect)))
            )
        ),
        shrinkage=Shrinkage(
            shares.share if best.effects else None,
            shares.interval if best.effects else None,
            True,
            _rms(joints, after),
        ),
        joint_names=joints,
        link_names=tuple(link.name for link in body.links),
        lengths=tuple(model.body_parameters().length.tolist()),
        tracks=Tracks(
            time=model.time.numpy(),
            observed=bound.observations[:, : 2 * len(model.emission_model.tips)].unflatten(-1, (-1, 2)).numpy(),
            keypoint_names=tuple(body.keypoint_names[tip] for tip in model.emission_model.tips),
            base=np.asarray(body.base, dtype=float),
            command=None if model.command is None or bound.regime == "passive" else model.command.numpy(),
            angle=q.numpy(),
            velocity=qd.numpy(),
            nominal_replay=replays["nominal"],
            corrected_replay=replays["corrected"],
            replay_window=WINDOW,
            smoothed=tips,
            residual_before=before,
            residual_before_sd=before_sd,
            residual_after=after,
            residual_after_sd=after_sd,
            frame_gap=frame_gap,
        ),
        screened=tuple(
            (key(s.effect), float(s.log_evidence - _nothing(found))) for s in found.first if s.effect is not None
        ),
        visibility=visibility,
        method=_method(bound, found, held_out),
        posterior=_posterior(bound, best, weighed, seed),
    )


def _posterior(bound: Setting, best: Refined, weighed: _Weighed, seed: int) -> az.InferenceData:
    run = weighed.confirmed.get(best.key) or confirm(bound, best, seed)
    return posterior(bound, best, run, seed)


def _nothing(found: Search) -> float:
    return next(s.log_evidence for s in found.first if s.effect is None)


def _without_hidden(model, path: torch.Tensor) -> torch.Tensor:
    extra = path.shape[-1] - model.state_dim
    return path if extra <= 0 else torch.cat([path[:, : model.torque_size], path[:, model.torque_size + extra :]], -1)


def _ambiguous(causes: Sequence[Cause]) -> tuple[str, ...]:
    """Keys of the causes that together hold most of the probability of all that name one; none for a single one."""
    named = [cause for cause in causes if cause.effects]
    total = sum(cause.probability for cause in named)
    held, rivals = 0.0, []
    for cause in named:
        if total <= 0 or held > CREDIBLE * total:
            break
        rivals.append("+".join(f.key for f in cause.effects))
        held += cause.probability
    return tuple(rivals) if len(rivals) > 1 else ()


def _rms(joints: Sequence[str], torque: np.ndarray) -> dict[str, float]:
    return dict(zip(joints, np.sqrt((torque**2).mean(0)).tolist(), strict=True))


def _method(bound: Setting, found: Search, held_out: object) -> dict[str, str]:
    model = bound.model
    return {
        "rows": f"{model.num_steps} rows with an observation, {model.integrator} with {model.substeps} sub-step(s) a "
        "row, chosen so that the integrator's own error stays a tenth of what can be noticed",
        "candidates": f"{len(found.candidates)} effects at their places; {len(found.pool)} causes refined",
        "evidence": "linearised about each cause's own path and parameters, residual torque's size and noise scale "
        "integrated out; the best confirmed by nested sequential Monte Carlo with parameters integrated out",
        "held out": "another recording" if held_out is not None else "the last third of the rows",
        "scatter": ", ".join(sorted({e.name for e in found.candidates if is_noise(e)})) or "none",
    }


def _nothing_to_say(recording: Recording, body: Body, seed: int, passive: bool, reason: str) -> Diagnosis:
    """The answer "not enough data"."""
    joints = body.joint_names
    nan = float("nan")
    known = recording.torques is not None and np.isfinite(recording.torques).any()
    empty = dict.fromkeys(joints, nan)
    return Diagnosis(
        recording=recording.name,
        body=body.name,
        seed=seed,
        regime="passive" if passive else "commanded" if known else "unknown_torque",
        gap=Gap(
            False,
            nan,
            dict.fromkeys(("nominal", "corrected", "noise_floor"), nan),
            empty,
            {"nominal": nan, "corrected": nan},
        ),
        where=Where({"dynamics": nan, "observation": nan}, empty, {}, (), ()),
        causes=(),
        ambiguity_set=(),
        separating_experiment=None,
        outside=Outside(nan),
        not_identifiable=(),
        shrinkage=Shrinkage(None, None, False, empty),
        joint_names=joints,
        link_names=tuple(link.name for link in body.links),
        lengths=tuple(link.nominal("length") for link in body.links),
        tracks=None,
        screened=(),
        visibility=(),
        method={},
        not_enough_data=reason,
    )
