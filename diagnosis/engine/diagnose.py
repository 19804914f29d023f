"""Diagnose a robot's log by MuJoCo's own engine: contacts, tendons, muscles, closed loops; the result is the usual one.

The commands are known. :mod:`.problem` binds the log, :mod:`.search` looks for causes among the effects of
:mod:`..catalogue.engine_effects`, and here they become a :class:`.Diagnosis`: probabilities, intervals, what of the gap
closes on rows that the numbers have not seen, and where the gap lies.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import torch

from invdyn.diagnosis.assessment.assemble import ambiguous, described, nothing_to_say, rms_of
from invdyn.diagnosis.assessment.findings import estimate, tempered_covariance
from invdyn.diagnosis.assessment.gap_closure import Closed, closed
from invdyn.diagnosis.assessment.model_posterior import too_small, weigh_by_sizes
from invdyn.diagnosis.assessment.result import (
    REFUSED,
    UNCHECKED,
    Change,
    Diagnosis,
    Finding,
    Gap,
    Outside,
    Shrinkage,
    Visibility,
    Where,
)
from invdyn.diagnosis.assessment.result import Cause as Answer
from invdyn.diagnosis.assessment.tracks import Tracks
from invdyn.diagnosis.catalogue.engine_effects import EFFECTS, candidates
from invdyn.diagnosis.check.before import check_numbers
from invdyn.diagnosis.check.check import BY_TORQUES
from invdyn.diagnosis.engine.causes import Cause, filtered_with
from invdyn.diagnosis.engine.cubature_filter import Filtered
from invdyn.diagnosis.engine.problem import EngineLog, engine_log, looked_at, sensed
from invdyn.diagnosis.engine.search import search
from invdyn.diagnosis.hypotheses.pool import HypothesisPool
from invdyn.diagnosis.prediction.predict import Scores
from invdyn.diagnosis.problem.cause import best_size
from invdyn.diagnosis.rules import DEFAULT, FIXED, Rules
from invdyn.models import Scene
from invdyn.models.divergence import Diverged
from invdyn.models.engine.drives import turning_dofs
from invdyn.recordings import InputError, Recording


def diagnose_engine(
    recording: Recording | Sequence[Recording],
    scene: Scene,
    *,
    held_out: Recording | None = None,
    passive: bool = False,
    without: Sequence[str] = (),
    most: int | None = None,
    seed: int = 0,
    rules: Rules = DEFAULT,
    force: bool = False,
    reasons: Sequence[str] = (),
    progress: Callable[[int, int, str], None] | None = None,
) -> Diagnosis:
    """Diagnose the gap between a log and MuJoCo's simulation of it.

    Args:
        recording: keypoints at sites, encoders of joints, or both, in m and rad; `torques` by the names of actuators
            (their controls) and of joints. Several of one robot are diagnosed together.
        scene: the simulation, :meth:`.Scene.of` a file.
        held_out: another recording, on which the closing of the gap is measured; by default the last third of the rows.
        passive: nothing was commanded.
        without: names of effects to leave out.
        most: effects at once, at most; by default the rules'.
        seed: of draws and bootstraps.
        rules: to follow.
        force: go on where a mistake in a recording is sure (:func:`.check_numbers`); the result says it.
        reasons: why MuJoCo's engine was taken.
        progress: called with (done, total, what).

    Raises InputError for a recording that does not fit the scene, has no commands or a mistake that is sure, or that
    the simulation runs away from.
    """
    known = {effect.name for effect in EFFECTS}
    if unknown := [name for name in without if name not in known]:
        raise InputError(f"unknown effect {unknown[0]!r}: known are {', '.join(sorted(known))}")
    report = progress or (lambda done, total, what: None)
    every = [recording] if isinstance(recording, Recording) else list(recording)
    count = sum(each.num_frames for each in every)
    if count < rules.recording.min_rows:
        reason = f"{count} rows are recorded and {rules.recording.min_rows} are needed"
        nothing = nothing_to_say(every[0], scene, seed, passive, reason, rules)
        return replace(nothing, method={"engine": _engine(reasons)})
    said = _checked([*every, *([held_out] if held_out else [])], scene, force, rules)
    report(0, 3, "bind")
    try:
        bound = partial(engine_log, scene=scene, passive=passive, rules=rules)
        log = bound([looked_at(each, rules, len(every)) for each in every])
        other = None if held_out is None else bound(looked_at(held_out, rules))
        report(1, 3, "screen and refine")
        possible = candidates(scene.model, log.pairs, log.sizes, without)
        found = search(log, possible, most or rules.search.max_effects)
    except Diverged as error:
        raise InputError(f"{every[0].name}: {error}: look at masses, units and the first pose") from error
    report(2, 3, "describe")
    result = _assembled(log, found, seed, other)
    said |= _method(log, found, len(possible), reasons, count, other is None, result.shrinkage.gap_closed is None)
    report(3, 3, "done")
    return replace(result, method=result.method | said)


def _checked(recordings: Sequence[Recording], scene: Scene, force: bool, rules: Rules) -> dict[str, str]:
    """What the result says of recordings that were checked; raises InputError where one has a mistake that is sure."""
    said = {UNCHECKED: f"Not looked at: {BY_TORQUES}, as no regression has the forces of MuJoCo's constraints"}
    refused = [
        r for each in recordings for r in check_numbers(sensed(each, scene), scene.reach, _slides(scene), force, rules)
    ]
    if refused:
        said[REFUSED] = f"By force, the diagnosis went on with a recording that is refused: {'; '.join(refused)}"
    return said


def _slides(scene: Scene) -> tuple[str, ...]:
    """Names of the degrees of freedom that shift."""
    return tuple(n for n, turns in zip(scene.joint_names, turning_dofs(scene.model), strict=True) if not turns)


def _assembled(log: EngineLog, found: HypothesisPool, seed: int, other: EngineLog | None) -> Diagnosis:
    scene, rules, weighed = log.model.scene, log.rules, weigh_by_sizes(found)
    none: Any = found.pool[""]
    best: Any = weighed.best
    first: Any = found.first
    joints = log.model.inputs.names
    shares = _closed(log, none, best, seed, other)
    before, after = _residual(log, none), _residual(log, best)
    probability, large = 1 - weighed.causes[""][1], best_size(log, none) > rules.evidence.tolerance
    weighed = weighed if large else too_small(weighed)
    answers = described(weighed, lambda cause: _findings(log, cause, found.temper_within(), seed), rules)
    rivals = ambiguous(answers, rules)
    share = (before[0] ** 2).mean(0) / log.typical**2
    located = dict(zip(joints, (share / max(share.sum(), 1e-300)).tolist(), strict=True))
    limit = rules.evidence.tolerance * log.typical
    seen = {each.key for each in best.effects}
    return Diagnosis(
        recording=log.recording.name,
        body=scene.name,
        seed=seed,
        regime=log.regime.name,
        gap=Gap(
            probability > 0.5 and large,
            probability,
            shares.per_frame,
            rms_of(joints, before[0]),
            {},
            dict(zip(joints, limit.tolist(), strict=True)),
        ),
        where=Where({"dynamics": 1.0, "observation": 0.0}, located, {}, (), ()),
        shrinkage=Shrinkage(
            shares.share if best.effects else None,
            shares.interval if best.effects else None,
            True,
            rms_of(joints, after[0]),
        ),
        joint_names=joints,
        link_names=scene.link_names,
        causes=answers,
        ambiguity_set=(rivals,) if rivals else (),
        separating_experiment=_experiment(answers),
        outside=Outside(weighed.outside),
        not_identifiable=tuple(
            sorted(each.effect.key for each in first if each.dprime < rules.evidence.min_dprime
                   and each.effect.key not in seen)
        ),
        tracks=_tracks(log, none, best, before, after),
        shifting=_slides(scene),
        screened=tuple((each.effect.key, each.log_evidence - none.log_evidence) for each in first),
        visibility=tuple(Visibility(each.effect.key, "dynamics", each.dprime) for each in first),
        rules=rules,
    )  # fmt: skip


def _residual(log: EngineLog, cause: Cause) -> tuple[np.ndarray, np.ndarray]:
    """Mean and sd (T, K) of the residual torque under the most probable size."""
    size, width = cause.likely, log.model.inputs.size
    return cause.filtered.mean[size, :, :width], cause.filtered.sd[size, :, :width]


def _findings(log: EngineLog, cause: Cause, temper: float, seed: int) -> list[Finding]:
    """Effects with intervals of draws, Gaussian, tempered, within bounds."""
    if not cause.effects:
        return []

    covariance, count = tempered_covariance(cause.covariance, cause.unknowns.sd, temper), log.rules.outcome
    draws = np.random.default_rng(seed).multivariate_normal(
        cause.values, covariance, count.num_interval_draws, method="eigh"
    )
    draws = cause.unknowns.within(draws)
    found, at = [], 0
    for each in cause.effects:
        numbers, parameters, changes = each.effect.numbers, {}, {}
        for number, unit_of in zip(numbers, each.units(log.model.scene.model), strict=True):
            own = draws[:, at]
            e = estimate(own, unit_of, float(own.std() / cause.unknowns.sd[at]), cause.values[at])
            parameters[number.name], changes[number.name] = e, Change(float(cause.unknowns.mean[at]), e)
            at += 1
        where = {each.place.kind: each.place.name}
        found.append(Finding(each.name, "dynamics", where, parameters, changes, each.effect.entry(each.place)))
    return found


def _experiment(causes: Sequence[Answer]) -> str | None:
    """Recordings that tell the most probable causes apart."""
    likely = [each for each in causes if each.effects and each.probability + each.in_part > 0.05]
    wanted = dict.fromkeys(own.entry.shown_by for each in likely for own in each.effects if own.entry)
    return f"Record {'; and '.join(wanted)}." if len(likely) > 1 else None


def _closed(log: EngineLog, none: Cause, best: Cause, seed: int, other: EngineLog | None) -> Closed:
    """Share of the gap that closes on another log; else on the last third, by what the first two thirds tell."""
    there, count, kappa = other or log, len(log.observations), float(best.kappa[0])
    first = int(log.rules.outcome.fit_share * count) if other is None else 0
    rows = np.arange(len(there.observations)) >= first
    values = _values_given_first_rows(best, first, kappa) if first and best.effects else best.values
    try:
        before = none.filtered if other is None else filtered_with(there, (), none.values)
    except Diverged as error:
        raise InputError(f"{there.recording.name}: {error}: it is not held-out data of the same robot") from error
    try:
        after = filtered_with(there, best.effects, best.unknowns.within(values)) if best.effects else before
    except Diverged:
        after = before  # with these numbers the simulation cannot follow, and closes nothing
    nothing, with_cause = (_scores(there, each, each.innovations[0], kappa) for each in (before, after))
    closing = closed(nothing, with_cause, rows, there.recording.time, seed, rules=log.rules)
    # ½ χ² of white innovations: where no more than chance is missing, as in free flight, there is nothing to close
    chance = np.sqrt(0.5 * (~there.observations[rows].isnan()).sum().item())
    gap = np.nansum((with_cause.floor - nothing.score)[rows])
    return closing if gap > FIXED.engine_gap_sds * chance else replace(closing, share=None, interval=None)


def _values_given_first_rows(cause: Cause, first: int, kappa: float) -> np.ndarray:
    """A cause's numbers (p,) by its first rows alone."""
    A, b = cause.columns[0][:first].reshape(-1, len(cause.point)), cause.filtered.innovations[0][:first].ravel()
    precision = A.T @ A / kappa**2 + np.diag(cause.unknowns.sd**-2)
    right = (cause.unknowns.mean - cause.point) / cause.unknowns.sd**2 - A.T @ b / kappa**2
    return np.asarray(cause.point + np.linalg.solve(precision, right))


def _scores(log: EngineLog, filtered: Filtered, w: np.ndarray, kappa: float) -> Scores:
    """Log densities (T,) of whitened innovations (T, O) at the smallest residual, and what is usual without a gap."""
    count = (~log.observations.isnan()).sum(-1).numpy()
    constant = -filtered.log_det[0] - count * (np.log(kappa) + 0.5 * np.log(2 * np.pi))
    score = constant - 0.5 * (w**2).sum(-1) / kappa**2
    return Scores(np.where(count > 0, score, np.nan), np.where(count > 0, constant - 0.5 * count, np.nan))


def _tracks(
    log: EngineLog,
    none: Cause,
    best: Cause,
    before: tuple[np.ndarray, np.ndarray],
    after: tuple[np.ndarray, np.ndarray],
) -> Tracks:
    """What figures show; replays are left out."""
    rows = len(log.observations)
    states = torch.as_tensor(best.filtered.mean[best.likely])
    _, tangent, velocity, _ = log.model.split(states)
    # Coordinates of the residual's joints, which are all.
    missing = np.full((rows, 0, log.model.scene.dimensions), np.nan)
    scores = [
        _scores(log, each, each.innovations[0], float(best.kappa[0])).score for each in (best.filtered, none.filtered)
    ]
    return Tracks(
        time=log.recording.time,
        observed=log.recording.keypoints,
        keypoint_names=log.recording.keypoint_names,
        base=np.zeros(log.model.scene.dimensions),
        command=None,
        angle=(torch.as_tensor(log.model.reference_angles) + tangent).numpy(),
        velocity=velocity.numpy(),
        nominal_replay=missing,
        corrected_replay=missing,
        replay_window=FIXED.replay_window,
        smoothed=missing,
        residual_before=before[0],
        residual_before_sd=before[1],
        residual_after=after[0],
        residual_after_sd=after[1],
        frame_gap=scores[0] - scores[1],
    )


def _engine(reasons: Sequence[str]) -> str:
    return "dynamics by MuJoCo's own step" + (f": {'; '.join(reasons)}" if reasons else "")


def _method(
    log: EngineLog, found: HypothesisPool, candidates: int, reasons: Sequence[str], rows: int, last: bool, untold: bool
) -> dict[str, str]:
    used, where = len(log.observations), "the last third of the rows" if last else "another recording"
    untold = untold and bool(found.best.effects)
    return {
        "engine": _engine(reasons),
        "rows": f"the first {used} of {rows} rows" if used < rows else f"{used} rows",
        "candidates": f"{candidates} effects at their places; {len(found.pool)} causes refined",
        "evidence": "by cubature Kalman filters, each about its own numbers; the residual torque's size integrated "
        "out, noise scale at its most probable",
        "held out": where + ", in which no more than chance is missing: record what shows the cause" * untold,
    }
