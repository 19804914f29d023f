"""All numbers of a diagnosis that were chosen, each with value, unit, meaning and source.

:class:`Rules` is an immutable tree of groups, and an argument: `diagnose(…, rules=Rules().replace(tolerance=0.2))`. A
problem, a pool and a motion carry it. :data:`FIXED` has what no run changes: how noise is measured, what work costs,
guards of floating-point arithmetic, sizes of pictures. docs/numbers.md lists both, with the files in which each acts.

A source is one of six. *odds*: an argument about probabilities. *chance*: the level of a one-sided test under a right
simulation. *measured*: on opened runs of the blind check or recordings, as said. *stated*: the meaning of a word, so
that a user may want another value. *chosen*: by hand, then tested by the blind check. *effort*: how hard to look; with
more of it, an answer should not change.
"""

import math
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np

from invdyn.recordings import InputError
from invdyn.recordings.naming import closest

COLUMNS = ("unit", "meaning", "source")


def number(value: Any, unit: str, meaning: str, source: str) -> Any:
    """A field with its value, and what a reader must know of it."""
    return field(default=value, metadata={"unit": unit, "meaning": meaning, "source": source})


@dataclass(frozen=True)
class EvidenceRules:
    """Priors of causes, and how evidence becomes an answer."""

    effect_count_prior: tuple[float, ...] = number(
        (0.4, 0.5, 0.08, 0.016, 0.004), "1", "P(n effects), n = 0, 1, …; a quarter for each further one", "odds"
    )
    places_prior: tuple[float, float, float] = number(
        (0.5, 0.1, 0.4),
        "1",
        "P(one), P(several) and P(all) joints of an effect in a regression",
        "odds: a robot's joints are equal",
    )
    temper_scale: float = number(1000.0, "nats", "largest evidence that counts between causes", "chosen")
    temper_scale_within: float = number(
        8000.0, "nats", "the same for intervals of parameters", "measured: 740 intervals, .90 cover the truth"
    )
    tolerance: float = number(0.005, "typical torque", "torques below it do not matter", "stated")
    robot_tolerance: float = number(0.03, "typical torque", "the same of a real robot's log", "stated")
    engine_error_step: float = number(0.002, "s", "first-order step whose error does not matter", "MuJoCo's default")
    worst_window: float = number(1.0, "s", "a torque is averaged over so long, then compared", "stated")
    detectable_torque: float = number(0.2, "typical torque", 'the answer "no gap" must rule it out', "stated")
    ruled_out_gap: float = number(3.0, "nats", "by which a less likely torque is ruled out", "odds: 20 to 1")
    credible_mass: float = number(0.95, "1", "probability of an ambiguity set", "stated")
    min_probability: float = number(1e-4, "1", "less probable causes are neither tested nor listed", "effort")
    min_dprime: float = number(
        3.0, "d′", "smaller changes by an effect of typical size cannot be seen", "chance: .0013"
    )
    clear_dprime: float = number(5.0, "d′", "larger ones are plain", "stated")
    confirm_within: float = number(3.0, "nats", "SMC confirms causes so close to the best", "odds: e³")
    max_confirmed: int = number(2, "causes", "SMC confirms at most", "effort: seconds each")
    max_smc_se: float = number(0.7, "nats", "larger standard errors leave the linearised evidence in place", "odds: 2")
    clear_se: float = number(0.2, "nats", "tempered standard error with which SMC needs no second run", "effort")
    max_filter_se: float = number(0.9, "nats", "larger ones come from a single filter, and count for nothing", "chosen")


@dataclass(frozen=True)
class ResidualRules:
    """The residual torque and the observations' errors: their priors, and when they show that something is left."""

    spike_size: float = number(1e-4, "typical torque", "size of the residual that counts as none", "chosen")
    slab_sizes: tuple[float, ...] = number(
        tuple(np.geomspace(2e-3, 1.0, 6).tolist()), "typical torque", "sizes of the residual, if there is one", "chosen"
    )
    limb_sizes: tuple[float, ...] = number(
        tuple(np.geomspace(0.03, 30.0, 15).tolist()), "typical torque", "sizes of a limb's own torque", "chosen"
    )
    min_path_size: float = number(1e-3, "typical torque", "smallest residual under which a path is found", "effort")
    residual_decay: float = number(20.0, "1/s", "of the residual: friction changes several times a swing", "chosen")
    limb_decay: float = number(4.0, "1/s", "of a limb's own torque", "chosen")
    data_path_size: float = number(0.3, "typical torque", "residual of the data's path, torques known", "chosen")
    limb_path_size: float = number(3.0, "typical torque", "the same, torques unknown", "chosen")
    dynamics_noise: float = number(0.3, "of inference's", "noise of the dynamics: what it follows is no gap", "chosen")
    initial_torque: float = number(0.3, "typical torque", "left by commands before the first row", "chosen")
    min_joint_size: float = number(0.1, "of the largest", "smallest residual of another joint", "chosen")
    max_share_left: float = number(
        0.1, "1", "of the torque that is missing without a cause, so much may stay", "stated"
    )
    min_residual_gain: float = number(
        5.0, "nats", "a residual gains by chance, besides share² of the gap's", "odds: e⁵"
    )
    max_error_ratio: float = number(1.5, "noise", "larger errors of prediction show that something is left", "stated")
    max_error_correlation: float = number(0.3, "1", "the same for errors of neighbouring rows", "stated")
    max_shared_outliers: float = number(0.25, "1", "the same for outliers of several keypoints in one row", "chosen")
    max_excess_along: float = number(0.05, "1", "the same for errors along the motion, beyond a half", "chosen")
    error_margin: float = number(2.0, "sd", "by which each of these three may exceed its limit", "chance: .023")
    limb_margin: float = number(
        3.0, "1", "times its most probable size, a limb's torque when errors are tested", "stated"
    )
    max_memory: float = number(0.6, "1", "largest correlation of a tracker's errors from row to row", "chosen")
    min_memory_gain: float = number(1.0, "nats", "that a memory must be able to gain to be integrated", "effort")
    max_interval_ratio: float = number(1.5, "intervals", "rows further apart share no memory", "chosen")
    tail_degrees: tuple[float, ...] = number((4.0, 8.0, 16.0), "1", "degrees of freedom of heavy tails", "chosen")
    max_prior_sds: float = number(4.0, "sd", "parameters stay so close to their priors' centres", "chosen")
    max_prior_sds_one_sided: float = number(8.0, "sd", "the same for HalfNormal and Beta priors", "chosen")
    max_prior_sds_heavy: float = number(10.0, "sd", "the same for StudentT priors", "chosen")
    edge_margin: float = number(1e-3, "1", "share of an upper edge that parameters stay below it", "chosen")


@dataclass(frozen=True)
class RecordingRules:
    """Which rows of a recording are used."""

    min_rows: int = number(20, "rows", "with an observation; fewer are not enough data", "stated")
    max_rows: int = number(2000, "rows", "with an observation, of one recording", "effort")
    max_row_spacing: float = number(0.04, "s", "between rows that are used: 25 a second", "chosen")
    num_windows: int = number(20, "windows", "chosen from a long recording", "chosen")
    window_prior: float = number(1e-3, "1", "of the windows' mean information, known before the first", "chosen")
    max_torque_ratio: float = number(
        100.0, "1", "times the torque that the motion needs; more is another unit", "measured: 1.5 of 40, stalled 50"
    )
    motion_share: float = number(0.5, "1", "of the largest velocity, that counts as the motion's rms", "chosen")
    path_outlier_sds: float = number(5.0, "sd", "a detection further from the first path is an outlier", "chosen")


@dataclass(frozen=True)
class ScreeningRules:
    """Columns of candidates along one path."""

    burst_window: float = number(0.1, "s", "length of the windows in which a burst is tried", "effort")
    num_peaks: int = number(2, "windows", "kept for each size of the residual", "effort")
    num_short_windows: int = number(11, "windows", "shorter ones that are tried within one", "effort")
    min_short_gain: float = number(10.0, "2 nats", "that a short window must explain beyond the long one", "chosen")
    secant_step: float = number(0.5, "prior sd", "of an effect's column", "chosen")
    slope_step: float = number(0.05, "sd", "of differences in a parameter", "chosen")
    slope_turn: float = number(0.2, "rad", "of the joints between rows whose slopes are computed", "effort")


@dataclass(frozen=True)
class SearchRules:
    """Which candidates are refined."""

    max_effects: int = number(4, "effects", "of one cause", "effort: 4 is where the prior ends")
    max_candidates_alone: int = number(10, "candidates", "refined without another effect", "effort")
    max_candidates_added: int = number(4, "candidates", "refined together with other effects", "effort")
    max_candidates_exchanged: int = number(2, "candidates", "refined in place of an effect", "effort")
    max_candidates_for_outliers: int = number(2, "candidates", "refined in place of outliers", "effort")
    batch_size: int = number(2, "candidates", "refined before the next are compared with them", "effort")
    min_exchange_share: float = number(
        0.3, "1", "of the best effect's gain, to be exchanged for a full cause", "effort"
    )
    screen_error: float = number(5.0, "nats", "of the screen where there is little to gain", "measured: 99 in 100")
    large_screen_error: float = number(
        60.0, "nats", "of the screen where there is much, at least", "measured: 95 in 100"
    )
    unexplained_factor: float = number(10.0, "1", "times the screen's gain, while nothing explains the gap", "measured")
    rival_factor: float = number(2.0, "1", "times the screen's gain, of a rival of what explains it", "measured")
    equal_gain: float = number(1.0, "nats", "causes closer than that are equally good", "effort")
    max_variants: int = number(3, "causes", "of one effect whose regularised forms are refined", "effort")
    min_variant_size: float = number(0.01, "typical torque", "residual under which such a form is refined", "effort")
    burst_shifts: tuple[float, ...] = number(
        (-1.5, -1.0, -0.5, -0.25, 0.0, 0.25, 0.5, 1.0, 1.5), "durations", "by which a burst is moved", "effort"
    )
    burst_factors: tuple[float, ...] = number((0.4, 0.63, 1.0, 1.6), "1", "by which it is made longer", "effort")
    min_burst: float = number(0.03, "s", "shortest unit of these shifts", "effort")
    min_gain: float = number(2.0, "nats", "that a searched effect must gain", "odds: e²")
    num_tail_fits: int = number(3, "fits", "of the width of heavy tails", "effort")
    max_tail_gap: float = number(30.0, "nats", "causes further behind are not refined under heavy tails", "effort")
    max_step_loss: float = number(0.5, "nats", "that errors of integration may cost", "chosen")
    max_step_factor: int = number(2, "1", "times the sub-steps that errors in an angle need", "effort")
    passes_per_row: float = number(11000.0, "passes", "of work, by default", "effort: 102 to 213 s in nine logs")
    min_budget_rows: int = number(1000, "rows", "that a budget counts at least", "effort")
    started_share: float = number(0.2, "1", "of the budget, for the search from what is usual", "effort")
    search_share: float = number(0.75, "1", "of the budget, for the search", "effort")


@dataclass(frozen=True)
class DescentRules:
    """How a candidate's path and parameters are refined."""

    max_rounds: int = number(6, "rounds", "of path and parameters", "effort")
    path_steps: int = number(3, "steps", "of Gauss–Newton in a round", "effort")
    path_tolerance: float = number(0.3, "nats", "smaller gains end Gauss–Newton", "effort")
    max_short_steps: int = number(25, "steps", "of decreasing length, where none was a gain", "effort")
    max_unfitted_kappa: float = number(2.0, "noise", "larger errors: the path is not found yet", "effort")
    settled_sds: float = number(0.1, "sd", "smaller changes of a parameter end a descent", "effort")
    unseen_gain: float = number(0.5, "nats", "that a last step may promise", "effort")
    lead_slack: tuple[float, ...] = number(
        (1000.0, 100.0, 10.0, 1.0), "1", "factors on the dynamics' noise, one after the other", "effort"
    )
    lead_steps: int = number(6, "steps", "of Gauss–Newton at each factor", "effort")
    quiet_steps: int = number(20, "steps", "of Gauss–Newton under a smaller residual", "effort")
    transfer_steps: int = number(50, "steps", "of Gauss–Newton on another recording", "effort")
    wide_backlash: float = number(0.1, "rad", "a wider gap needs a path of its own", "effort")
    width_step: float = number(0.4, "log", "first step of a gap's width", "effort")
    min_width_step: float = number(0.012, "log", "last step", "effort")
    max_parabola_loss: float = number(4.0, "nats", "that a step may cost for a parabola to hold", "effort")
    max_width_evaluations: int = number(24, "widths", "that are tried", "effort")
    width_rounds: int = number(4, "rounds", "of each width; two lose forty nats at a stop", "effort")
    near_width: float = number(0.15, "log", "widths so close start from each other's path", "effort")
    max_searches: int = number(4, "searches", "of each of several effects on the scatter", "effort")
    min_repeat_gain: float = number(50.0, "nats", "that an effect must gain for the others to be repeated", "effort")
    simplex_evaluations: int = number(16, "per parameter", "of the simplex search", "effort")
    prior_quantiles: tuple[float, ...] = number((0.1, 0.3, 0.6, 0.9), "1", "of a prior, as grid points", "effort")
    num_prior_draws: int = number(2000, "draws", "from which quantiles of a prior come", "effort")


@dataclass(frozen=True)
class OutcomeRules:
    """SMC, withheld rows, places and formulas."""

    num_filters: int = number(8, "filters", "of an SMC run", "effort")
    num_particles: int = number(20, "particles", "of each filter", "effort")
    paths_per_filter: int = number(4, "paths", "of the posterior", "effort")
    proposal_degrees: float = number(
        8.0, "1", "degrees of freedom of the proposal, heavier than the posterior", "chosen"
    )
    num_interval_draws: int = number(4000, "draws", "behind parameters' intervals", "effort")
    num_noise_draws: int = number(8, "recordings", "drawn to measure their noise", "effort")
    bootstrap_block: float = number(0.4, "s", "length of the bootstrap's blocks", "stated")
    num_bootstraps: int = number(1000, "draws", "of the bootstrap", "effort")
    fit_share: float = number(2 / 3, "rows", "fitted where the last ones are withheld", "stated")
    max_sd_growth: float = number(
        4.0, "1", "growth of a parameter's sd; more: only withheld rows show it", "measured: 1.2 elsewhere"
    )
    min_effects_tested: int = number(3, "effects", "of a set, each tested by withheld rows", "odds: P(3) = .016")
    interval_mass: float = number(0.8, "1", "of the gap, in the intervals of time together", "stated")
    max_interval_share: float = number(0.4, "1", "of the recording; longer intervals say nothing", "stated")
    gap_smoothing: float = number(0.1, "s", "over which the gap is averaged", "chosen")
    max_terms: int = number(3, "terms", "of a formula", "stated")
    product_cost: float = number(5.0, "nats", "that a term of two factors must gain more", "chosen")
    num_left_out: int = number(10, "parts", "of the rows, left out in turn for a coefficient's error", "effort")
    path_bias: float = number(0.03, "1", "by which the path's errors shrink a coefficient", "measured: 1 to 3 %")


@dataclass(frozen=True)
class CheckRules:
    """Mistakes in a log: signs, zeros, units, columns, gears, offsets."""

    max_mistakes: int = number(3, "mistakes", "in one log", "chosen")
    min_misfit: float = number(0.05, "1", "of the torque; under less nothing is wrong", "measured: 98 logs")
    max_remaining: float = number(0.55, "1", "of the misfit, once a mistake is put right", "measured: 98 logs")
    max_right_misfit: float = number(0.4, "1", "of the torque, in a log that is right", "measured: 98 logs")
    max_joint_misfit: float = number(
        0.15, "1", "of a joint's torque, once its mistake is put right", "measured: 98 logs, right < .1, wrong > .22"
    )
    sure_misfit: float = number(0.2, "1", "of the torque, from which on a mistake is sure", "chosen")
    sure_remaining: float = number(0.3, "1", "of the misfit, once a sure mistake is put right", "chosen")
    equal_misfit: float = number(1.15, "1", "times the smallest: other mistakes explain it as well", "chosen")
    zero_grid: tuple[float, ...] = number(
        tuple(np.radians(np.arange(-150, 181, 30)).tolist()), "rad", "zeros that are tried first", "effort"
    )
    factor_grid: tuple[float, ...] = number(
        (1e-3, 1e-2, 0.1, 0.2, 0.35, 3, 5, 8, 13, 20, 32, 50, 80, 125, 200, 320, 1000.0),
        "1",
        "gears and units that are tried first",
        "effort",
    )
    max_gain: float = number(2.0, "1", "smaller factors on torques are a gain, for the diagnosis", "stated")
    min_zero: float = number(math.radians(7), "rad", "smaller zeros are an effect, for the diagnosis", "stated")
    min_turn: float = number(0.05, "rad or m", "of a joint whose torque may be off all along", "chosen")
    min_offset: float = number(0.2, "rms torque", "smaller constant torques are an effect", "stated")
    min_column_rows: int = number(50, "rows", "of a column, for outliers, wraps and repeats to be looked for", "chosen")
    max_outlier_run: float = number(3.0, "rows", "that another publisher's number stands on average", "chosen")
    min_outliers: int = number(3, "rows", "of one value, for another publisher's", "chosen")
    min_outlier_share: float = number(0.002, "1", "of all rows, for another publisher's", "chosen")
    min_outlier_step: float = number(10.0, "usual steps", "from the rows around to another publisher's", "chosen")
    min_jump: float = number(0.75, "1", "of a column's range, from which on a step is a wrap", "chosen")
    modulus_tolerance: float = number(0.03, "1", "by which a jump may miss a modulus that encoders have", "chosen")
    min_regular: float = number(
        0.8, "1", "of the changes that come at equal distances, where values are held", "chosen"
    )
    max_delay: float = number(0.1, "s", "from a command to its torque; longer ones are a clock's", "stated")
    max_lead: float = number(1.5, "rows", "by which a command may follow its motion, by rounding of times", "chosen")
    delay_growth: float = number(1.2, "1", "from one delay that is tried to the next", "effort")
    max_shift: float = number(0.2, "of the log", "by which its commands may come late or early", "chosen")
    gear_tolerance: float = number(0.05, "1", "gears closer than that are the same", "chosen")
    max_gear: float = number(300.0, "1", "of a robot, of which the largest have 160", "stated")
    max_tilt: float = number(0.45, "rad", "of gravity: three sds of its prior", "stated")
    min_motor_limit: float = number(0.18, "1", "of the largest command: three sds of its prior", "stated")
    max_encoder_offset: float = number(math.radians(10), "rad", "between encoders and keypoints", "stated")
    max_first_offset: float = number(math.radians(20), "rad", "at the first joint: a camera may be rolled", "stated")
    min_resultant: float = number(0.95, "1", "mean resultant length of a constant difference", "chosen")
    min_direction_rows: int = number(11, "rows", "with a link's direction, to test its zero", "chosen")
    min_link_length: float = number(0.02, "reach", "as seen, for a link's direction to count", "chosen")
    degrees_misfit: float = number(0.1, "1", "of the torque, which confirms that angles are degrees", "chosen")
    range_tolerance: float = number(0.5, "of ±100", "by which a number is at the end of its range", "stated")
    cubic_windows: tuple[int, ...] = number((7, 13, 25, 49, 97), "rows", "of the local cubic of a motion", "effort")
    max_fit_rows: int = number(1200, "rows", "of two joints; fewer of more", "effort")
    scan_rows: int = number(150, "rows", "on which all mistakes are tried first", "effort")
    max_refitted: int = number(8, "mistakes", "that are tried on all rows then", "effort")
    link_sd: float = number(0.3, "1", "by which a file's number of a link may be off", "stated")
    ridge: float = number(1e-3, "1", "weight of the prior: two sds cost 6 % of the torque", "chosen")
    slow_velocity: float = number(0.1, "rms velocity", "smaller ones have no dry friction's sign", "chosen")
    min_torque_scale: float = number(0.1, "largest torque", "that any joint's scale has at least", "chosen")
    min_part: float = number(0.02, "1", "of a base parameter, for another number to be named in it", "stated")
    min_noise_share: float = number(0.02, "rms torque", "left by any body", "chosen")
    max_look_rows: int = number(600, "rows", "on which the visible effects are computed", "effort")
    min_clock_overlap: float = number(
        0.5, "1", "of the shorter recording, for a camera's clock; largest misfit", "chosen"
    )
    min_clock_points: int = number(20, "points", "in both recordings", "chosen")
    max_grid_frames: int = number(400, "frames", "on the grid of offsets", "effort")
    max_point_misfit: float = number(3.0, "medians", "that one point counts at most", "chosen")
    min_contrast: float = number(1.5, "1", "times the smallest misfit, that other offsets must leave", "chosen")
    num_clock_blocks: int = number(10, "blocks", "of a film, for the offset's error", "effort")
    max_log_gap: float = number(3.0, "intervals", "of a log; nothing is known within longer gaps", "chosen")


@dataclass(frozen=True)
class Rules:
    """The tree of numbers that a diagnosis follows."""

    evidence: EvidenceRules = EvidenceRules()
    residual: ResidualRules = ResidualRules()
    recording: RecordingRules = RecordingRules()
    screening: ScreeningRules = ScreeningRules()
    search: SearchRules = SearchRules()
    descent: DescentRules = DescentRules()
    outcome: OutcomeRules = OutcomeRules()
    check: CheckRules = CheckRules()

    def replace(self, **values: Any) -> "Rules":
        """The rules with other values, by the numbers' own names; raises InputError for a name that there is not."""
        groups = {each.name: getattr(self, each.name) for each in fields(self)}
        known = [name for group in groups.values() for name in vars(group)]
        for name in values:
            if name not in known:
                raise InputError(f"unknown rule {name!r}{closest(name, known)}: docs/numbers.md lists all")
        return replace(
            self,
            **{
                key: replace(group, **{name: value for name, value in values.items() if name in vars(group)})
                for key, group in groups.items()
            },
        )


@dataclass(frozen=True)
class Fixed:
    """Numbers that no run changes."""

    # -- how the noise of a recording is measured
    label_misfit_ratio: float = number(7.0, "medians", "of links' lengths, of exchanged labels", "chosen")
    neighbour_rows: tuple[int, ...] = number((-3, -2, -1, 1, 2, 3), "rows", "whose parabolas predict a row", "chosen")
    outlier_rank: int = number(4, "parabolas", "without two of the six neighbours", "combinatorics")
    min_parabolas: int = number(10, "parabolas", "known of a row, of twenty", "chosen")
    outlier_ratio: float = number(7.0, "quartiles", "of the distances, beyond which a row is an outlier", "chosen")
    edge_outlier_ratio: float = number(5.0, "quartiles", "the same for one parabola", "chosen")
    outlier_quantile: float = number(0.75, "1", "of the distances, that these count", "chosen")
    num_speed_bins: int = number(8, "bins", "of speed", "chosen")
    min_bin_rows: int = number(10, "rows", "of each bin", "chosen")
    velocity_span: float = number(0.2, "s", "of the polynomial whose slope is a velocity", "chosen")
    velocity_degree: int = number(3, "1", "of that polynomial", "chosen")
    min_growth_gain: float = number(16.0, "variances", "of the misfit, from which on noise grows", "chance")
    difference_overlap: float = number(2.0, "1", "on a median's variance, as differences share rows", "chosen")
    growth_log_sd: float = number(1 / 3, "log", "sd of a noise at rest that was extrapolated", "measured")
    # -- what work costs, in passes
    first_fit_passes: float = number(60.0, "passes", "until no effect is fitted", "measured")
    usual_joints: int = number(
        3, "joints", "in space, up to which a pass takes the same time for each state", "measured"
    )
    work_per_second: tuple[float, float] = number(
        (5e5, 1e5), "passes · rows/s", "of a usual machine, in the plane and in space", "measured"
    )
    column_cost: float = number(0.6, "passes", "of a column", "measured")
    linearise_cost: float = number(0.75, "passes", "of a linearisation", "measured")
    filter_cost: float = number(0.2, "passes", "of a filter of one size", "measured")
    rowwise_cost: float = number(10.0, "1", "times a pass, of a model whose gap is solved row by row", "measured")
    refused_steps: int = number(2, "passes", "of a round, for refused steps and the last linearisation", "measured")
    quiet_cost: int = number(3, "passes", "of a path under a smaller residual", "measured")
    hinge_cost: int = number(10, "1", "times a column, of a hidden hinge", "measured")
    effect_cost: int = number(20, "columns", "of any effect, besides its own", "measured")
    # -- what is credible of an effect, and values from which a search starts
    credible_sds: float = number(4.0, "sd", "by which a parameter may be off, in favour of the effect", "chosen")
    special_case_sds: float = number(3.0, "sd", "from a special case, up to which parameters allow it", "chance")
    max_rest_angle: float = number(4 * math.pi, "rad", "of a spring, as it is reported", "stated: two revolutions")
    min_lever_ratio: float = number(0.1, "1", "of a coupling; under it one joint has a spring", "measured: .52 or more")
    max_stop_damping: float = number(3.0, "1", "ratio of a stop that pushes a joint back", "measured: .48 at most")
    min_free_range: float = number(0.5, "range seen", "that a stop leaves free", "measured: .79 or more")
    min_stop_room: float = number(0.1, "range seen", "that two stops of a joint leave between them", "chosen")
    start_softness: float = number(0.3, "1", "of a regularised stop", "chosen")
    min_ripple_periods: float = number(3.0, "periods", "in a revolution; motors' builds have four or more", "stated")
    max_mistimed_frames: float = number(5.0, "frames", "sd of a mistimed one; farther off it is lost", "stated")
    # -- memory and floating-point arithmetic
    max_block_columns: int = number(200, "columns", "whitened together", "memory")
    max_block_rows: int = number(1500, "rows", "for so many columns; fewer for more", "memory")
    max_parameter_sets: int = number(64, "sets", "propagated together", "memory")
    max_whitened: int = number(2**25, "numbers", "for all sizes at once: 256 MB", "memory")
    rounding: float = number(1e-9, "1", "smaller relative differences are rounding", "float64")
    negligible: float = number(1e-6, "1", "smaller relative differences, angles and rates are none", "float64")
    time_slack: float = number(
        1e-3, "steps", "by which equal times differ: seconds since 1970 come to .2 µs", "float64"
    )
    uneven_spacing: float = number(1e-3, "1", "relative; less is even", "chosen")
    diverged_sds: float = number(1e10, "sd", "larger changes of the data leave no digits", "float64")
    failed_score: float = number(-1e9, "nats", "of a width with which the simulation does not run", "float64")
    kappa_rounds: int = number(6, "rounds", "of EM for the noise scale", "effort")
    jerk_span: float = number(0.1, "s", "of the cubic whose third derivative is a motion's", "chosen")
    jerk_points: int = number(11, "points", "in that span", "chosen")
    # -- the fit of torques that a check makes
    kept_equations: int = number(4, "motions", "whose normal equations are kept", "effort")
    max_link_sds: float = number(3.0, "prior sds", "by which a link's number may be off", "chosen")
    max_joint_sds: float = number(10.0, "prior sds", "by which a joint's friction or rotor may be", "chosen")
    # -- the regression
    max_likelihood_rows: int = number(1500, "rows", "from which noise and roughness of an angle come", "effort")
    roughness_decades: tuple[float, float, float] = number(
        (-6.0, 1.5, 0.25), "log10", "s/r of the smoother: first, last and step, where rows are 1 s apart", "effort"
    )
    moments_of_a_row: int = number(16, "1", "at which a servo with limits is looked at", "effort")
    clear_torque: float = number(3.0, "1", "times what is tolerated, a missing torque is a gap", "chosen")
    inertia_rows: int = number(20, "rows", "of which one tells how noise in accelerations is torque", "effort")
    max_regression_rows: int = number(4000, "rows", "of smoothed angles; more are averaged", "effort")
    regressor_rows: int = number(1000, "rows", "of links' regressors that are made at once", "effort")
    min_moving_share: float = number(0.2, "rows", "in which a joint turns, for those at rest not to count", "chosen")
    regression_draws: int = number(64, "draws", "of a regression's numbers, for a file and its ensemble", "effort")
    equal_servo_gain: float = number(0.1, "log", "of servos' gains, that two regressions agree to", "stated")
    servo_gain_passes: int = number(4, "regressions", "about servos' gains, at most", "effort")
    servo_gain_sd: float = number(1.0, "log", "of a servo's gain of which a log tells nothing", "stated")
    linear_servo_gain: float = number(
        0.7, "log", "of a servo's gain, that a regression about the file's takes", "stated"
    )
    servo_column_weight: float = number(
        100.0, "1", "times a column's size, for a servo's gain to be taken before it", "chosen"
    )
    velocity_power: float = number(0.95, "1", "of a velocity's power, that a motion's frequencies have", "stated")
    cutoff_factor: float = number(2.5, "1", "times those, a regression's frequencies", "measured: DFKI 01 and 03, WAM")
    cross_validation_folds: int = number(6, "folds", "of neighbouring rows, each predicted by the others", "effort")
    min_cutoff: float = number(3.0, "Hz", "of the regression's filter: dry friction changes sign at once", "chosen")
    max_behind_plain: float = number(1.05, "1", "times a plain fit's error, for what evidence chooses", "stated")
    min_plain_gain: float = number(
        0.02, "of the gap", "that a plain fit must explain besides, to be preferred", "stated"
    )
    regression_sizes: tuple[float, ...] = number(
        (0.03, 0.1, 0.3, 1.0), "of the torque needed", "prior sds of an effect in a regression", "chosen"
    )
    odd_size: float = number(0.3, "of the torque needed", "prior sd of an effect beside all usual ones", "chosen")
    plain_size: float = number(10.0, "of the torque needed", "the same of a plain fit: next to no prior", "chosen")
    sure_probability: float = number(0.9, "1", 'of what a regression names without a "perhaps"', "stated")
    disagreement: float = number(
        0.05, "1", "of regressions that say that parts of a log differ where none does", "chance"
    )
    usual_start: float = number(0.1, "prior sd", "of a usual effect that a regression has no size of", "effort")
    shape_passes: int = number(3, "regressions", "with shapes that get nearer", "effort")
    shape_grid: int = number(25, "values", "of the shape of an effect that a regression chose", "effort")
    equal_shape: float = number(0.02, "log", "of a shape, that two regressions agree to", "stated")
    near_shape: float = number(2.5, "1", "times a shape and back, that they reach to", "effort")
    finest_shape: float = number(0.02, "1", "times a delay's prior, where it is as good as none", "stated")
    regression_tail: float = number(4.0, "1", "degrees of freedom of what a regression leaves", "chosen")
    max_gap_steps: float = number(20.0, "steps", "beyond which a recording has a gap", "chosen")
    max_edge_sd: float = number(2.0, "medians", "of an acceleration's sd; rows at edges have more", "chosen")
    min_link_left: float = number(0.02, "of the file's", "mass and inertia that a regression leaves a link", "chosen")
    min_link_share: float = number(0.01, "of the largest", "that a link's number is uncertain by at least", "chosen")
    # -- motions to record next
    excite_highest_frequency: float = number(1.0, "Hz", "of a motion's waves", "chosen")
    excite_rise: float = number(1.5, "s", "in which a motion sets in, and ends", "chosen")
    excite_centre: float = number(0.7, "half ranges", "that a motion's centre is off the middle by at most", "chosen")
    excite_noise: float = number(0.02, "of the load", "noise of a torque, where none is stated", "chosen")
    excite_slow: float = number(0.02, "of the speed limit", "below which dry friction is not whole", "chosen")
    excite_share: float = number(0.1, "of the load", "prior sd of an effect's torque at the limits", "chosen")
    excite_link_share: float = number(0.3, "of its size", "prior sd of a link's number", "chosen")
    excite_least_load: float = number(0.01, "of the largest", "that a joint's load is at least", "chosen")
    excite_steps: int = number(150, "steps", "of a search from one start", "measured: the last fifty gain .5 nats")
    excite_rate: float = number(0.06, "1", "of these steps (Adam)", "chosen")
    excite_penalty: float = number(300.0, "nats", "for a torque of twice its limit all along", "chosen")
    excite_search_rate: float = number(10.0, "rows/s", "of a motion that is looked for", "ten rows a wave")
    excite_check_rate: float = number(100.0, "rows/s", "of a motion that is checked, and written", "chosen")
    excite_shrink: float = number(0.93, "1", "on the swings of a motion that exceeds a limit", "chosen")
    excite_usual_speed: float = number(1.0, "rad/s", "of a joint whose speed nothing limits", "chosen")
    excite_usual_rise: float = number(0.25, "s", "in which a joint may reach its speed", "chosen")
    excite_sure: float = number(0.95, "1", "probability from which on an effect is taken to act", "chosen")
    excite_min_sd: float = number(0.5, "prior sd", "of a number's sd, from which on a motion tells little", "chosen")
    # -- ensembles
    max_members: int = number(10_000, "files", "of an ensemble", "stated")
    min_unknown_share: float = number(0.9, "prior sd", "of a number's sd, from which on the log says nothing", "stated")
    # -- replays
    replay_horizons: tuple[float, float] = number((0.5, 2.0), "s", "that a replay of angles runs for", "stated")
    replay_window: float = number(1.0, "s", "between the states that a replay is set to", "stated")
    max_replay_windows: int = number(30, "windows", "whose states are found; of more, evenly chosen ones", "effort")
    replay_rounds: int = number(3, "rounds", "of Gauss–Newton on a window's first state", "effort")
    min_replay_noise: float = number(1e-5, "rad", "of an angle, that is taken for noise at least", "chosen")
    replay_runs_away: float = number(1.0, "rad", "rms, from which on a replay without restarts says nothing", "chosen")
    max_replay_angle: float = number(1e4, "rad", "beyond which a replay has run away", "chosen")
    min_replay_rows: int = number(13, "rows", "with all angles", "chosen")
    # -- the diagnosis on MuJoCo's engine
    engine_step: float = number(0.02, "prior sd", "of a difference by a number", "chosen")
    engine_rounds: int = number(5, "rounds", "of Gauss–Newton on a cause", "effort")
    engine_settled: float = number(0.2, "posterior sd", "of a number's change that ends them", "chosen")
    engine_shorter: int = number(2, "steps", "that are tried, each a quarter of the last", "effort")
    engine_gain: float = number(0.3, "nats", "that a step must gain", "chosen")
    engine_gap_sds: float = number(2.0, "sds", "of chance, below which unseen rows show no gap", "chance: .02")
    engine_usual: float = number(0.3, "of a usual force", "that an effect's is, one sd", "chosen")
    engine_speed_noise: float = number(1e-3, "usual speeds", "noise of velocities in a row", "chosen")
    engine_sizes: tuple[float, ...] = number(
        (1e-4, 3e-3, 3e-2, 0.3), "typical torque", "of the residual: none, and what else would need", "chosen"
    )
    engine_least: float = number(0.1, "1", "share below which a size is no smaller", "chosen")
    engine_poses: int = number(10, "poses", "in which levers of tendons are looked up", "effort")
    engine_start_size: float = number(0.03, "typical torque", "of the residual where replays start", "chosen")
    # -- the output-error fit of a file's numbers
    refine_window: float = number(8.0, "s", "of a replay", "chosen: a servo settles within one")
    max_refine_windows: int = number(24, "windows", "a third of them held out", "effort")
    refine_first: int = number(3, "windows", "of which one is in the first fit", "effort")
    refine_rounds: int = number(10, "rounds", "of Gauss–Newton", "effort: SO-101 needs 6 to 10")
    refine_gain: float = number(3.0, "nats", "of a round, below which the fit ends", "stated")
    refine_steps: tuple[float, ...] = number((0.0, 0.01, 0.1, 1.0, 10.0), "1", "dampings of a round's step", "chosen")
    refine_slope: float = number(0.01, "1", "step of a slope, in logarithms and prior sds", "chosen")
    refine_floor: float = number(0.02, "of the motion", "error of a replay, below which less does not count", "chosen")
    refine_memory: float = number(0.5, "s", "for which a replay's errors are correlated", "chosen")
    start_gains: tuple[float, ...] = number(
        (1.0, 0.3, 0.1, 0.03, 0.01), "1", "times a file's gain, that a fit may start from", "chosen"
    )
    residual_points: int = number(120, "rows", "at which a residual torque is known", "effort")
    residual_lengths: tuple[float, ...] = number(
        (0.2, 0.6, 2.0, math.inf), "sds", "of a variable, in which a residual torque changes", "chosen"
    )
    residual_ratios: tuple[float, ...] = number(
        (0.01, 0.1, 1.0, 10.0), "1", "of its variance to that of what is left", "chosen"
    )
    min_residual_closed: float = number(0.02, "1", "of the missing torque, for a joint to have one", "chosen")
    refine_draws: int = number(50, "draws", "of the fit's numbers at least", "effort")
    friction_sd: float = number(1.5, "log", "of a friction's number, about the regression's", "stated")
    armature_sd: float = number(1.0, "log", "of an armature, about the regression's", "stated")
    impedance_sd: float = number(3.0, "log", "of 1 − d, the softness of a file's dry friction", "stated")
    min_friction_impedance: float = number(0.5, "1", "of dry friction", "chosen: MuJoCo's own is .9")
    same_number: float = number(1e-3, "of it", "by which a file's number is no other", "chosen")
    least_number: float = number(0.01, "of the load", "that a friction or rotor starts from at least", "chosen")
    ensemble_scales: tuple[float, ...] = number(
        (1.0, 2.0, 4.0, 8.0, 16.0), "1", "on an ensemble's spread, until its bands hold", "chosen"
    )
    ensemble_coverage: float = number(0.9, "of the rows", "held out, that an ensemble's band holds", "stated")
    point_inertia: float = number(1e-9, "kg·m²", "of a payload, which is a point: MuJoCo wants some", "stated")
    extra_samples: int = number(2, "samples", "that an actuator with a delay remembers besides", "MuJoCo")
    # -- the report
    num_shown: int = number(5, "causes", "in full view", "stated")
    max_quiet_share: float = number(0.15, "1", "of frames beyond a 90 % band, of a quiet joint", "chance: .10")
    min_map_share: float = number(0.15, "1", "of the largest residual; smaller ones are grey", "stated")
    equal_share: float = number(0.005, "1", "shares closer than that are written as equal", "stated")
    max_digits: int = number(6, "digits", "that distinguish two numbers", "stated")
    arm_width: int = number(400, "px", "of the arm's picture", "layout")
    min_arm_height: int = number(150, "px", "of the arm's picture", "layout")
    max_arm_height: int = number(320, "px", "of the arm's picture", "layout")
    arm_margin: int = number(56, "px", "above and below the arm", "layout")
    max_name_letters: int = number(14, "letters", "of a name in the picture", "layout")
    plot_width: int = number(2000, "units", "of a plot's box", "layout")
    plot_height: int = number(1000, "units", "of a plot's box", "layout")
    max_plot_points: int = number(800, "points", "of a line", "layout")
    max_replay_frames: int = number(600, "frames", "of the animation", "layout")
    replay_width: int = number(480, "px", "of the animation", "layout")
    replay_height: int = number(360, "px", "of the animation", "layout")
    max_background_points: int = number(400, "points", "of each keypoint behind the animation", "layout")


DEFAULT = Rules()
FIXED = Fixed()


def numbers() -> list[tuple[str, Any]]:
    """(group, field) of every number, in their order; the group of a fixed one is "fixed"."""
    rules = Rules()
    found = [(group.name, each) for group in fields(rules) for each in fields(getattr(rules, group.name))]
    return [*found, *(("fixed", each) for each in fields(Fixed))]
