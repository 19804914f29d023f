"""How a study is inferred: in parts, which workers share and a checkpoint keeps.

Trials are fitted alone, sessions share the parameters of trials that fit, and each trial has its posterior at them
(:mod:`.work`). Bits are the same for any number of workers and however often it was interrupted.
"""

from collections import Counter
from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

from invdyn.inference.execution.checkpoint import Checkpoint
from invdyn.inference.execution.distribute import distribute, inside
from invdyn.inference.execution.progress import Progress, stage
from invdyn.inference.execution.records import content_digest
from invdyn.inference.execution.seeds import derived
from invdyn.inference.methods.registry import METHODS
from invdyn.inference.renamed_methods import present_name
from invdyn.inference.study.study import Study
from invdyn.inference.study.trial import How, Trial
from invdyn.inference.study.work import Part, fit_trial, infer_trial, share_session
from invdyn.recordings import InputError


def run_study(
    trials: Sequence[Trial],
    how: How | None = None,
    *,
    executor: Executor | None = None,
    checkpoint: str | Path | None = None,
    progress: Progress | None = None,
) -> Study:
    """Infer all trials, sharing within sessions.

    Args:
        trials: with names that differ.
        how: method, sizes, seed.
        executor: whose workers share trials and sessions; the result is the same to the bit.
        checkpoint: folder that keeps what is done; the same call continues from there.
        progress: called with (trials or sessions done, all, what).

    Raises InputError for no trials, two of one name, an unknown method, or a checkpoint of another study; LostWork.
    """
    how = how or How()
    how = replace(how, method=present_name(how.method))
    if how.method not in METHODS:
        raise InputError(f"expected a method among {', '.join(METHODS)}, got {how.method!r}")
    if not trials:
        raise InputError("expected one trial or more, got none")
    if twice := [name for name, count in Counter(trial.name for trial in trials).items() if count > 1]:
        raise InputError(f"expected trials with names of their own, got two called {twice[0]!r}")
    how.sizes.check()
    kept = None if checkpoint is None else Checkpoint(checkpoint, _fingerprint(trials, how))
    left_out = {place: trial.unread for place, trial in enumerate(trials) if trial.unread}

    def run(part: Any, places: Sequence[int], arguments: list[tuple], what: str) -> list[Part]:
        names = [f"{what} of {trials[place].name}" for place in places]
        own, report = inside(kept, what), stage(progress, what)
        return distribute(part, arguments, names, executor=executor, checkpoint=own, progress=report)

    read = [place for place in range(len(trials)) if place not in left_out]
    alone = run(fit_trial, read, [(trials[place], how) for place in read], "fit")
    fits = dict(zip(read, alone, strict=True))
    left_out |= _reasons(fits)

    groups = _groups(trials, {place: fit for place, fit in fits.items() if place not in left_out})
    work: list[tuple] = [([trials[i] for i in members], [fits[i] for i in members], how) for members in groups]
    shared = run(share_session, [members[0] for members in groups], work, "session")
    sessions = tuple(zip(groups, shared, strict=True))
    for members, part in sessions:
        if reason := part.get("left_out"):
            left_out |= dict.fromkeys(members, f"its session's parameters could not be fitted: {reason}")

    of = {place: part for members, part in sessions for place in members if place not in left_out}
    order = sorted(of)
    work = [(trials[i], how, fits[i], of[i], derived(how.seed, i)) for i in order]
    posteriors = dict(zip(order, run(infer_trial, order, work, "posterior"), strict=True))
    left_out |= _reasons(posteriors)
    used = tuple(each for each in sessions if "left_out" not in each[1])
    whole = {place: part for place, part in posteriors.items() if place not in left_out}
    return Study(tuple(trials), how, tuple(fits.get(i, {}) for i in range(len(trials))), used, whole, left_out)


def _reasons(parts: dict[int, Part]) -> dict[int, str]:
    return {place: reason for place, part in parts.items() if (reason := part.get("left_out"))}


def _groups(trials: Sequence[Trial], fits: dict[int, Part]) -> list[tuple[int, ...]]:
    """Places of trials that share: of one session, with one body, the same points and parameters to fit."""
    groups: dict[Any, list[int]] = {}
    for place, fit in fits.items():
        form = tuple((name, tuple(value.shape)) for name, value in fit["values"].items())
        trial = trials[place]
        points = _names(trial)
        groups.setdefault((trial.subject, trial.session, repr(trial.body), points, form), []).append(place)
    return [tuple(members) for members in groups.values()]


def _names(trial: Trial) -> tuple:
    """Of what the recording's numbers are."""
    recording = trial.recording
    return () if recording is None else (recording.keypoint_names, recording.joint_names, recording.length_unit)


def _fingerprint(trials: Sequence[Trial], how: How) -> dict[str, Any]:
    """All that the numbers depend on."""
    labels = [[*trial.labels.items(), *map(str, trial.events.items()), _names(trial)] for trial in trials]
    return {
        "version": version("invdyn"),
        "recordings": content_digest([trial.recording and replace(trial.recording, name="") for trial in trials]),
        "bodies": content_digest([repr(trial.body) for trial in trials]),
        "trials": content_digest(labels),
        "how": repr(how),
    }
