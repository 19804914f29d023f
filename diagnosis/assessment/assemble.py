"""The result of a diagnosis, put together from the causes and their probabilities; and the answer "not enough data"."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import torch

from invdyn.diagnosis.assessment.confirm import confirm, posterior
from invdyn.diagnosis.assessment.confusability import overlaps
from invdyn.diagnosis.assessment.findings import finding, key, learned
from invdyn.diagnosis.assessment.gap_closure import Closed
from invdyn.diagnosis.assessment.localisation import where
from invdyn.diagnosis.assessment.matters import matters, tolerated
from invdyn.diagnosis.assessment.model_posterior import Weighed, too_small
from invdyn.diagnosis.assessment.posture import base_of, posture, typical_row
from invdyn.diagnosis.assessment.result import (
    STEPS,
    Cause,
    Diagnosis,
    Finding,
    Gap,
    Learned,
    Noise,
    Outside,
    Part,
    Shrinkage,
    Visibility,
    Where,
)
from invdyn.diagnosis.assessment.symbolic_regression import Formula
from invdyn.diagnosis.assessment.tracks import Tracks
from invdyn.diagnosis.hypotheses.continuation import lifted
from invdyn.diagnosis.hypotheses.pool import HypothesisPool
from invdyn.diagnosis.prediction.predict import replay, replay_rms, residual, scores, seen_tips
from invdyn.diagnosis.problem.cause import FittedHypothesis
from invdyn.diagnosis.problem.diagnosis_problem import DiagnosisProblem
from invdyn.diagnosis.problem.noise import is_noise
from invdyn.diagnosis.problem.regime import regime_of
from invdyn.diagnosis.rules import DEFAULT, FIXED, Rules
from invdyn.diagnosis.sensitivity.screen import added
from invdyn.diagnosis.side_by_side import side_by_side
from invdyn.inference.plausible_for_body import slides
from invdyn.models import ArticulatedBody
from invdyn.models.effects.base import side_of
from invdyn.recordings import Recording


def assembled(
    bound: DiagnosisProblem,
    found: HypothesisPool,
    weighed: Weighed,
    shares: Closed,
    fresh: bool,
    by_effect: Mapping[str, Closed],
    formula: Formula | None,
    follows: Sequence[str],
    seed: int,
    held_out: str,
) -> Diagnosis:
    """Everything that a diagnosis says; ``formula`` is of what no cause explains, None where nothing is left.

    ``fresh`` says whether the share that the best cause closes is of rows that its parameters do not know, and
    ``by_effect`` has the share that each effect of the best cause closes, by its key.
    ``follows`` are the variables that what the simulation lacks depends on, and ``held_out`` says in words what was.
    """
    body = bound.model.body
    none, best = found.pool[""], weighed.best
    along = _along_the_path(bound, found, best)
    probability = 1.0 - weighed.causes.get("", (none, 0.0))[1]
    limit = tolerated(bound, along.path_without)
    large = matters(bound, none, best, along.before, limit)
    if not large:
        weighed = too_small(weighed)
    causes = described(
        weighed,
        lambda cause: [finding(bound, cause, effect, seed, found.temper_within(effect)) for effect in cause.effects],
        bound.rules,
        lambda cause: learned(bound, cause, seed, found.temper_within()),
    )
    rivals = ambiguous(causes, bound.rules)
    joints = body.joint_names
    return Diagnosis(
        recording=bound.problem.recording.name,
        body=body.name,
        seed=seed,
        regime=bound.regime.name,
        gap=Gap(
            detected=probability > 0.5 and large,
            probability=probability,
            elpd_per_frame=shares.per_frame,
            residual_torque_rms=rms_of(joints, along.before),
            replay_rms_m={name: replay_rms(r, along.tips) for name, r in along.replays.items()},
            tolerated_torque=dict(zip(joints, limit.tolist(), strict=True)) if bound.regime.knows_torque else {},
        ),
        where=_located(bound, weighed, along, follows),
        causes=causes,
        ambiguity_set=(rivals,) if rivals else (),
        overlaps=overlaps(bound, rivals, found.first),
        separating_experiment=bound.catalogue.separating_experiment(
            [f.effect for cause in causes if "+".join(f.key for f in cause.effects) in rivals for f in cause.effects]
        ),
        outside=Outside(
            weighed.outside,
            formula.text if formula else None,
            formula.terms if formula else {},
            float(formula.gain_per_frame) if formula else None,
        ),
        not_identifiable=tuple(sorted(unseen_effects(bound, found) - {key(effect) for effect in best.effects})),
        shrinkage=Shrinkage(
            shares.share if best.effects else None,
            shares.interval if best.effects else None,
            fresh,
            rms_of(joints, along.after),
            {name: Part(part.share, part.interval) for name, part in by_effect.items()},
        ),
        joint_names=joints,
        link_names=body.link_names,
        tracks=_tracks(bound, along),
        screened=tuple((key(s.effect), float(s.log_evidence - _nothing(found))) for s in added(found.first)),
        visibility=tuple(Visibility(key(s.effect), side_of(s.effect), float(s.dprime)) for s in added(found.first)),
        method=_method(bound, found, weighed, held_out),
        not_looked_at=found.missed,
        posterior=posterior(bound, best, weighed.confirmed.get(best.key) or confirm(bound, best, seed), seed),
        planar_only=_planar_only(bound),
        posture=posture(body, along.angle[row] if (row := typical_row(along.angle)) is not None else None),
        noise=_noise(best),
        length_unit=bound.problem.recording.length_unit,
        shifting=tuple(sorted(slides(body))),
        rules=bound.rules,
    )


@dataclass(frozen=True)
class _Along:
    """Without and with the best cause, along its smoothed path: T rows, K joints, S sites, P tracked ones, d axes.

    Angles and velocities (T, K); sites (T, S, d) m, smoothed and replayed; the torque that each lacks with its sd,
    (T, K) N·m; the path without a cause, (T, D); nats (T,) by which the cause predicts each row better; and by how much
    the camera sees a site elsewhere, (P,), as a share of its noise.
    """

    angle: np.ndarray
    velocity: np.ndarray
    tips: np.ndarray
    replays: Mapping[str, np.ndarray]
    before: np.ndarray
    before_sd: np.ndarray
    path_without: torch.Tensor
    after: np.ndarray
    after_sd: np.ndarray
    frame_gap: np.ndarray
    shifts: np.ndarray


def _along_the_path(bound: DiagnosisProblem, found: HypothesisPool, best: FittedHypothesis) -> _Along:
    model, none = bound.model, found.pool[""]
    after, after_sd, path = residual(bound, best)
    _, q, qd = best.model.split(path)
    tips = best.model.dynamics.keypoints(q, best.model.body_parameters()).numpy()
    parts: list[Callable[[], Any]] = [  # what takes longest first
        partial(replay, best.model, path, bound.starts),
        partial(replay, model, lifted(model, path), bound.starts),
        partial(residual, bound, none),
        *(partial(scores, bound, cause) for cause in (none, best)),
    ]
    corrected, nominal, (before, before_sd, path_without), scored, improved = side_by_side(parts, found.workers)
    moved = seen_tips(best.model, path) - tips[:, list(model.observation.tracked)]
    shifts = (
        np.sqrt((moved**2).sum(-1).mean(0))
        / model.parameters.get("emission.keypoint_scale", torch.ones(moved.shape[1])).numpy()
        if moved.size
        else np.zeros(moved.shape[1])
    )
    replays, frame_gap = {"nominal": nominal, "corrected": corrected}, improved.score - scored.score
    angle, velocity = q.numpy(), qd.numpy()
    return _Along(angle, velocity, tips, replays, before, before_sd, path_without, after, after_sd, frame_gap, shifts)


def described(
    weighed: Weighed,
    findings: Callable[[Any], Sequence[Finding]],
    rules: Rules,
    learned_with: Callable[[Any], tuple[Learned, ...]] = lambda cause: (),
) -> tuple[Cause, ...]:
    """Causes that are credible, and the best; the most probable first."""
    causes = (
        Cause(
            tuple(findings(cause)),
            probability,
            weighed.log_evidence[cause.key],
            weighed.confirmed[cause.key].log_evidence_sd if cause.key in weighed.confirmed else float("nan"),
            weighed.in_part[cause.key],
            learned_with(cause),
        )
        for cause, probability in weighed.causes.values()
        if probability + weighed.in_part[cause.key] > rules.evidence.min_probability or cause is weighed.best
    )
    return tuple(sorted(causes, key=lambda cause: (-cause.probability, -cause.in_part)))


def _located(bound: DiagnosisProblem, weighed: Weighed, along: _Along, follows: Sequence[str]) -> Where:
    """Where the gap is; intervals are in the recording's times, s, which are ``origin`` at the model's 0."""
    located = where(
        bound.model,
        {name: (cause, alone + weighed.in_part[name]) for name, (cause, alone) in weighed.causes.items()},
        weighed.in_part.get("", 0.0),
        bound.regime,
        along.before,
        bound.typical.numpy(),
        along.shifts,
        along.frame_gap,
        follows,
        bound.rules,
    )
    origin = bound.problem.origin
    on_its_clock = tuple(replace(i, start=i.start + origin, stop=i.stop + origin) for i in located.intervals)
    return replace(located, intervals=on_its_clock)


def _tracks(bound: DiagnosisProblem, along: _Along) -> Tracks:
    model = bound.model
    return Tracks(
        time=model.time.numpy() + bound.problem.origin,
        observed=_observed(bound),
        keypoint_names=model.observation.tracked_names,
        base=base_of(model.body),
        command=None if model.command is None or not bound.regime.commanded else model.command.numpy(),
        angle=along.angle,
        velocity=along.velocity,
        nominal_replay=along.replays["nominal"],
        corrected_replay=along.replays["corrected"],
        replay_window=FIXED.replay_window,
        smoothed=along.tips,
        residual_before=along.before,
        residual_before_sd=along.before_sd,
        residual_after=along.after,
        residual_after_sd=along.after_sd,
        frame_gap=along.frame_gap,
    )


def _noise(best: FittedHypothesis) -> Noise:
    tails = best.model.parameters.get("emission.df")
    return Noise(best.kappa, best.memory, None if tails is None else tails.item())


def _observed(bound: DiagnosisProblem) -> np.ndarray:
    """(T, P, d) m, of no keypoints too."""
    points, body = bound.model.observation.points(bound.observations).numpy(), bound.model.body
    return points.reshape(*points.shape[:2], body.dimensions)


def unseen_effects(bound: DiagnosisProblem, found: HypothesisPool) -> set[str]:
    """Keys of the effects that this recording could not have shown.

    Without commands all of the actuators', and all that an unknown torque could do; a base that shakes only if too weak
    to see.
    """
    regime, body = bound.regime, bound.model.body
    shown = added(found.first)
    unseen = {key(s.effect) for s in shown if s.dprime < bound.rules.evidence.min_dprime or regime.hides(s.effect)}
    if not regime.commanded:
        every = bound.catalogue.everywhere(body, [])
        unseen |= {key(e) for entry, e in every if entry.of_motors(e) or regime.hides(e)}
    return unseen


def _nothing(found: HypothesisPool) -> float:
    return next(s.log_evidence for s in found.first if s.effect is None)


def ambiguous(causes: Sequence[Cause], rules: Rules = DEFAULT) -> tuple[str, ...]:
    """Keys of the causes that together hold most of the probability of all that name one; none for a single one.

    None, either, where there is no gap more probably than one.
    """
    named = [cause for cause in causes if cause.effects]
    total = sum(cause.probability for cause in named)
    if any(not cause.effects and cause.probability > 0.5 for cause in causes):
        return ()
    mass, rivals = 0.0, []
    for cause in named:
        if total <= 0 or mass > rules.evidence.credible_mass * total:
            break
        rivals.append("+".join(f.key for f in cause.effects))
        mass += cause.probability
    return tuple(rivals) if len(rivals) > 1 else ()


def rms_of(joints: Sequence[str], torque: np.ndarray) -> dict[str, float]:
    """Of torques (T, K), by joint."""
    return dict(zip(joints, np.sqrt((torque**2).mean(0)).tolist(), strict=True))


def _method(bound: DiagnosisProblem, found: HypothesisPool, weighed: Weighed, held_out: str) -> dict[str, str]:
    flat, tails = _planar_only(bound), _noise(weighed.best).degrees_of_freedom
    law = "normal" if tails is None else f"Student's t of {tails:.0f} degrees of freedom"
    model, counted = bound.model, sum(np.isfinite(run.log_evidence) for run in weighed.confirmed.values())
    return {
        "rows": f"{model.num_steps} rows with an observation, {model.integrator} with {model.substeps} sub-step(s) a "
        "row, chosen so that the integrator's own error stays a tenth of what can be noticed, adds up to next to no "
        "evidence over the recording, and favours none of the causes",
        "candidates": f"{len(found.candidates)} effects at their places; {len(found.pool)} causes refined, of "
        f"at most {bound.rules.search.max_effects} effects",
        "evidence": "linearised about each cause's own path and parameters, residual torque's size integrated out, "
        "noise scale at its most probable (its integral adds the same to each), what errors remember of the row before "
        f"integrated out (most probably {weighed.best.memory:.2f}), their law {law}; "
        f"{counted or 'none'} confirmed by nested sequential Monte Carlo with parameters integrated out",
        "budget": f"{bound.budget.allowed}, the search three quarters of it; {_looked_at(found.missed)}",
        "held out": held_out,
        **({"not looked for": f"{', '.join(flat)}: known for a chain in the plane alone"} if flat else {}),
        **({STEPS: _steps(bound.engine_step)} if bound.engine_step else {}),
        "scatter": ", ".join(sorted({e.name for e in found.candidates if is_noise(e)})) or "none",
    }


def _steps(step: float) -> str:
    return (
        f"The recording moves as in first-order steps of {1e3 * step:g} ms, as the file's own engine takes them: what "
        "these do to commands and dampers is no gap"
    )


def _looked_at(missed: int) -> str:
    if not missed:
        return "every candidate was looked at"
    return f"{missed} candidate{'s were' if missed > 1 else ' was'} not looked at"


def _planar_only(bound: DiagnosisProblem) -> tuple[str, ...]:
    """Which effects of the catalogue are not known for a body of this kind."""
    return tuple(name for name, entry in bound.catalogue.items() if not entry.effect.fits(bound.model.body))


def nothing_to_say(
    recording: Recording, body: ArticulatedBody, seed: int, passive: bool, reason: str, rules: Rules
) -> Diagnosis:
    """The answer "not enough data"."""
    joints = body.joint_names
    nan = float("nan")
    empty = dict.fromkeys(joints, nan)
    return Diagnosis(
        recording=recording.name,
        body=body.name,
        seed=seed,
        regime=regime_of(recording.torques, passive, rules).name,
        gap=Gap(
            False,
            nan,
            dict.fromkeys(("nominal", "corrected", "noise_floor"), nan),
            empty,
            {"nominal": nan, "corrected": nan},
        ),
        where=Where({"dynamics": nan, "observation": nan}, empty, {}, (), ()),
        shrinkage=Shrinkage(None, None, False, empty),
        joint_names=joints,
        link_names=body.link_names,
        posture=posture(body),
        not_enough_data=reason,
        length_unit=recording.length_unit,
        rules=rules,
    )
