"""What a diagnosis says, and `diagnosis.json`.

SI units and radians.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import arviz as az
import numpy as np
from cattrs import Converter
from cattrs.gen import make_dict_unstructure_fn, override

from invdyn.diagnosis.assessment.closing_measures import Closing
from invdyn.diagnosis.assessment.posture import Posture
from invdyn.diagnosis.assessment.tracks import Tracks
from invdyn.diagnosis.catalogue import CATALOGUE, CatalogueEntry
from invdyn.diagnosis.problem.regime import REGIMES
from invdyn.diagnosis.regression.regress import Regression
from invdyn.diagnosis.rules import DEFAULT, Rules

SCHEMA = 2
"""Of `diagnosis.json`: 2 has all of 1, and adds what of a file changes, what was learned of it, and the budget."""
LEFT_OUT = "left out"
"""Key of `Diagnosis.method`: what was not looked at of a long recording."""
REFUSED = "refused"
"""Key of `Diagnosis.method`: mistakes of the recording that were gone past, by force."""
UNCHECKED = "not looked at"
"""Key of `Diagnosis.method`: mistakes that such a recording was not looked through for."""
STEPS = "steps"
"""Key of `Diagnosis.method`: that a recording is as of the file's own engine."""
NO_SEARCH = "search"
"""Key of `Diagnosis.method`: why no causes were searched for."""


@dataclass(frozen=True)
class Estimate:
    """A parameter's posterior: mean, standard deviation, and central 90 % interval.

    `draws` (N,) are of the joint posterior: the n-th of all of a cause's numbers belong together. `narrowed` is the
    posterior's sd as a share of the prior's, NaN where it is not known: 1 where the log says nothing of it.
    """

    mean: float
    sd: float
    interval_90: tuple[float, float]
    unit: str
    draws: np.ndarray = field(default_factory=lambda: np.zeros(0), compare=False, repr=False)
    narrowed: float = field(default=math.nan, compare=False, repr=False)


@dataclass(frozen=True)
class Change:
    """A number that the simulation's own file has, and what it is with the effect: from `before` to `after`."""

    before: float
    after: Estimate


@dataclass(frozen=True)
class Learned:
    """A number of the body's file that is not known exactly: from the file's to what a cause has it be.

    Such as the "damping" of a joint or the "mass" of a link, whose name is `place`.
    """

    place: str
    quantity: str
    change: Change


@dataclass(frozen=True)
class Written:
    """A corrected copy of the simulation's file.

    Attributes:
        file: its path.
        changes: numbers of it: place, quantity, from, to, interval_90, unit, effect.
        unsaid: what the file cannot say, or was not written: words → why.
        nothing: why there was nothing to write; None where there is a file.
        rollout: what MuJoCo itself is off by with the file and with the copy; None where it does not read such files.
        refined: of an output-error fit, what replays of held-out windows are off by; None where none was made.
    """

    file: str
    changes: tuple[dict, ...]
    unsaid: dict[str, str]
    nothing: str | None = None
    rollout: dict | None = None
    refined: dict | None = None


@dataclass(frozen=True)
class Finding:
    """One effect at one place, with its parameters' posterior.

    `where` maps "joint", "link" or "keypoint" (and "partner" for pairs, "stop" for a joint's stops) to a name, and
    "form" to that of an effect that has several; empty for the whole arm. `changes` has those parameters that add to a
    number of the simulation's own file. `own` is the entry of an effect that only the diagnosis' own catalogue has.
    """

    effect: str
    side: str
    where: dict[str, str]
    parameters: dict[str, Estimate]
    changes: dict[str, Change] = field(default_factory=dict)
    own: CatalogueEntry | None = field(default=None, compare=False, repr=False)

    @property
    def entry(self) -> CatalogueEntry | None:
        """What the catalogue has of the effect."""
        return self.own or CATALOGUE.get(self.effect)

    @property
    def key(self) -> str:
        """Effect and place, "viscous_friction.elbow"."""
        return ".".join([self.effect, *self.where.values()])


@dataclass(frozen=True)
class Cause:
    """A candidate cause: one effect, several together, or none for "no gap".

    Attributes:
        effects: what is at work.
        probability: of their being at work and nothing else.
        log_evidence, log_evidence_sd: nats; the second is NaN without SMC.
        in_part: probability of their being at work with something that the catalogue lacks.
        learned: the body's own numbers that were uncertain, learned with them.
    """

    effects: tuple[Finding, ...]
    probability: float
    log_evidence: float
    log_evidence_sd: float
    in_part: float = 0.0
    learned: tuple[Learned, ...] = ()


@dataclass(frozen=True)
class Gap:
    """Whether there is a gap, with what probability, and its size in the units that people use.

    `detected` says that there is one and that it matters, which a torque under `tolerated_torque`, joint to N·m, does
    not. `elpd_per_frame` and `replay_rms_m` map "nominal", "corrected" (and "noise_floor") to numbers;
    `residual_torque_rms` joint to N·m.
    """

    detected: bool
    probability: float
    elpd_per_frame: dict[str, float]
    residual_torque_rms: dict[str, float]
    replay_rms_m: dict[str, float]
    tolerated_torque: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Interval:
    """A stretch of time that holds `share` of the gap."""

    start: float
    stop: float
    share: float


@dataclass(frozen=True)
class Where:
    """Posterior shares by side, joint and keypoint; the intervals that hold most of it; what the gap depends on."""

    side: dict[str, float]
    joints: dict[str, float]
    keypoints: dict[str, float]
    intervals: tuple[Interval, ...]
    depends_on: tuple[str, ...]


@dataclass(frozen=True)
class Outside:
    """What the catalogue does not explain.

    `description`: a short formula, or None; `terms` its terms, name → (coefficient, sd, unit); `gain_per_frame` the
    nats that it gains a withheld row.
    """

    probability: float
    description: str | None = None
    terms: dict[str, tuple[float, float, str]] = field(default_factory=dict)
    gain_per_frame: float | None = None


@dataclass(frozen=True)
class Noise:
    """What the observations' errors are like with the best cause.

    `factor` on the noise that the recording shows at rest; `memory`, what an error keeps of that in the row before;
    `degrees_of_freedom` of Student's t, or None for a normal law.
    """

    factor: float
    memory: float
    degrees_of_freedom: float | None


@dataclass(frozen=True)
class Part:
    """Share of the gap that one effect closes and the others of its cause leave, with its central 90 % interval."""

    gap_closed: float | None
    interval_90: tuple[float, float] | None


@dataclass(frozen=True)
class Shrinkage:
    """How far the gap closes once the cause is in, on withheld data where `held_out`; `by_effect` of it, by key."""

    gap_closed: float | None
    interval_90: tuple[float, float] | None
    held_out: bool
    residual_torque_rms_after: dict[str, float]
    by_effect: dict[str, Part] = field(default_factory=dict)


@dataclass(frozen=True)
class Visibility:
    """Whether the recording could have shown an effect of typical size: `dprime`, its change over the noise."""

    key: str
    side: str
    dprime: float


@dataclass(frozen=True)
class Diagnosis:
    """All that :func:`.diagnose.diagnose` finds.

    `regime` is "commanded", "passive" or "unknown_torque". `ambiguity_set` lists causes that the recording cannot tell
    apart, each as its effects' keys. `overlaps` says how similarly two of them change it (:mod:`.confusability`), and
    `separating_experiment` which recording would tell them apart. `not_identifiable` lists the keys of effects that the
    recording could not have shown. `not_looked_at` counts the candidates that the search had not tried when its budget
    was spent, 0 where it was not. `screened` has every candidate's key and log evidence against "no gap", best first;
    `visibility` one entry a candidate; `method` what was computed and how (seconds are left out: the report must not
    change from run to run). `planar_only` names effects that are known for a chain in the plane alone, and so are not
    looked for in space. `posture` is what a picture of the body draws. `regression` says what a regression of the
    torque does, and `closing` how much of the missing torque, and of a replay's error, it and the search explain; None
    where torques are unknown. `regressed` is the regression as a cause, where it is the answer.
    `shifting` names the joints that slide: N, m and m/s are theirs in place of N·m, rad and rad/s.
    `length_unit` is the recording's, such as "body length": m stands for it in all units, of torques too. In
    :meth:`to_json` `Cause.in_part` is
    "probability_in_part", `outside` "outside_catalogue" and an interval's `stop` its "end".
    """

    recording: str
    body: str
    seed: int
    regime: str
    gap: Gap
    where: Where
    shrinkage: Shrinkage
    joint_names: tuple[str, ...]
    link_names: tuple[str, ...]
    causes: tuple[Cause, ...] = ()
    ambiguity_set: tuple[tuple[str, ...], ...] = ()
    separating_experiment: str | None = None
    outside: Outside = Outside(math.nan)
    not_identifiable: tuple[str, ...] = ()
    tracks: Tracks | None = None
    screened: tuple[tuple[str, float], ...] = ()
    visibility: tuple[Visibility, ...] = ()
    method: dict[str, str] = field(default_factory=dict)
    overlaps: tuple[tuple[str, str, float], ...] = ()
    not_enough_data: str | None = None
    not_looked_at: int = 0
    posterior: az.InferenceData | None = None
    written: Written | None = None
    posture: Posture | None = None
    planar_only: tuple[str, ...] = ()
    noise: Noise | None = None
    length_unit: str = "m"
    shifting: tuple[str, ...] = ()
    regression: Regression | None = field(default=None, compare=False)
    closing: Closing | None = field(default=None, compare=False)
    regressed: Cause | None = field(default=None, compare=False, repr=False)
    rules: Rules = DEFAULT

    @property
    def knows_torque(self) -> bool:
        """Whether torques are known, so that any residual is a gap."""
        return REGIMES[self.regime].knows_torque

    def torque_unit(self, joint: str) -> str:
        """N·m, or N of a joint that slides."""
        return "N" if joint in self.shifting else "N·m"

    def to_json(self) -> dict:
        """The contract: what others read. Numbers that are not known are null."""
        written = {} if self.written is None else {"write_back": plain(self.written)}
        stopped, why = self.not_looked_at > 0, self.method.get(NO_SEARCH)
        search = {"stopped_at_the_budget": stopped, "not_looked_at": self.not_looked_at, "not_begun": why}
        return {
            "schema": SCHEMA,
            "recording": self.recording,
            "seed": self.seed,
            "regime": self.regime,
            "length_unit": self.length_unit,
            "not_enough_data": self.not_enough_data,
            "gap": plain(self.gap),
            "where": plain(self.where),
            "causes": plain(self.causes),
            "ambiguity_set": plain(self.ambiguity_set),
            "overlaps": [{"causes": [one, other], "share": plain(share)} for one, other, share in self.overlaps],
            "separating_experiment": self.separating_experiment,
            "outside_catalogue": plain(self.outside),
            "noise": plain(self.noise),
            "not_identifiable": list(self.not_identifiable),
            "search": {**search, "planar_only": list(self.planar_only)},
            "shrinkage": plain(self.shrinkage),
            "regression": None if self.regression is None else plain(self.regression.to_json()),
            "closing": None if self.closing is None else plain(self.closing.to_json()),
            **written,
        }


CONVERTER = Converter(unstruct_collection_overrides={tuple: list})
"""Results to what JSON can hold. Its keys follow the order of fields, but for what is said below."""


def plain(value: Any) -> Any:
    """A part of a result as dictionaries, lists, texts and numbers, None for numbers that are not finite."""
    return CONVERTER.unstructure(value)


def _finding(finding: Finding) -> dict:
    parameters: dict[str, dict] = plain(finding.parameters)
    for name, change in finding.changes.items():
        after = plain(change.after)
        parameters[name] |= {"from": plain(change.before), "to": after["mean"], "to_interval_90": after["interval_90"]}
    return {"effect": finding.effect, "side": finding.side, **finding.where, "parameters": parameters}


def _estimate(estimate: Estimate) -> dict:
    numbers = plain([estimate.mean, estimate.sd, estimate.interval_90])
    return dict(zip(("mean", "sd", "interval_90"), numbers, strict=True)) | {"unit": estimate.unit}


def _learned(number: Learned) -> dict:
    after = plain(number.change.after)
    return {
        "place": number.place,
        "quantity": number.quantity,
        "from": plain(number.change.before),
        "to": after["mean"],
        "sd": after["sd"],
        "to_interval_90": after["interval_90"],
        "unit": after["unit"],
    }


def _cause(cause: Cause) -> dict:
    return {
        "effects": plain(cause.effects),
        "learned": plain(cause.learned),
        "probability": plain(cause.probability),
        "probability_in_part": plain(cause.in_part),
        "log_evidence": plain(cause.log_evidence),
        "log_evidence_sd": plain(cause.log_evidence_sd),
    }


def _gap(gap: Gap) -> dict:
    fields = GAP(gap)
    tolerated = fields.pop("tolerated_torque")
    return fields | {"matters": gap.detected, "tolerated_torque": tolerated}


CONVERTER.register_unstructure_hook(float, lambda value: value if math.isfinite(value) else None)
GAP = make_dict_unstructure_fn(Gap, CONVERTER)
HOOKS: dict[type, Callable[[Any], dict]] = {
    Finding: _finding,
    Learned: _learned,
    Cause: _cause,
    Gap: _gap,
    Estimate: _estimate,
    Interval: make_dict_unstructure_fn(Interval, CONVERTER, stop=override(rename="end")),
    Outside: make_dict_unstructure_fn(Outside, CONVERTER, terms=override(omit=True)),
}
for kind, hook in HOOKS.items():
    CONVERTER.register_unstructure_hook(kind, hook)


def named(words: Sequence[str]) -> str:
    """Words as a list in a sentence: "a", "a and b", "a, b and c"."""
    words = list(words)
    return words[0] if len(words) == 1 else ", ".join(words[:-1]) + " and " + words[-1] if words else "nothing"
