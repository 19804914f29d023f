"""What a posterior says in a few lines: each joint's torque, how sure it is, how healthy the sampler was.

And what a comparison of several says: how near each came to the truth, its evidence, its cost.
"""

import json
import math

import arviz as az
import numpy as np
import pandas as pd

from invdyn.inference import Comparison, evidence_note, functional_table, learned_lengths, pooled
from invdyn.inference.posterior.functionals import MIN_TIMES
from invdyn.inference.posterior.posterior import uneven

from .plots import quantiles, unit_of


def torque_table(idata: az.InferenceData) -> pd.DataFrame:
    """One row a joint: see `quantity_table`."""
    return quantity_table(idata, "torque")


def quantity_table(idata: az.InferenceData, quantity: str) -> pd.DataFrame:
    """One row a joint, or an actuator: size of its torque, or of another quantity, width of its interval, its error.

    Columns: `rms` and `peak` of the posterior median; `± 90 %`, half the 90 % interval's mean width; and over
    the frames whose true value is known, `error rms`, `correlation`, and `90 % covers`, the share of them
    whose interval holds the truth.
    """
    low, _, median, _, high = quantiles(idata, quantity)
    of = str(idata["posterior"][quantity].dims[-1])
    table = pd.DataFrame(index=pd.Index(idata["posterior"][of].values, name=of.removesuffix("_of")))
    table["rms"] = np.sqrt((median**2).mean(axis=0))
    table["peak"] = np.abs(median).max(axis=0)
    table["± 90 %"] = ((high - low) / 2).mean(axis=0)
    if f"truth_{quantity}" not in idata["constant_data"]:
        return table
    truth = idata["constant_data"][f"truth_{quantity}"].transpose("time", "joint").values
    for joint, true, *ours in zip(table.index, truth.T, low.T, median.T, high.T, strict=True):
        known = np.isfinite(true)
        if known.sum() > 1:
            true, below, middle, above = true[known], *(curve[known] for curve in ours)
            table.loc[joint, "error rms"] = np.sqrt(np.mean((middle - true) ** 2))
            table.loc[joint, "correlation"] = pd.Series(middle).corr(pd.Series(true))  # NaN for a constant
            table.loc[joint, "90 % covers"] = np.mean((below <= true) & (true <= above))
    return table


MIN_DRAWS = 20
"""Independent draws of which one lies beyond each end of a 90 % band; of fewer its ends say nothing."""


def independent_draws(idata: az.InferenceData) -> float:
    """How many independent trajectories the bands rest on, at most, at a typical row.

    Copies of one particle count once: of n draws in groups of c equal ones, n² / Σ c². Of chains the effective sample
    size is known.
    """
    angle = pooled(idata)["angle"].isel(joint=0).transpose("time", "sample").values
    copies = [np.unique(row, return_counts=True)[1] for row in angle]
    drawn = float(np.median([count.sum() ** 2 / (count.astype(float) ** 2).sum() for count in copies]))
    return min(drawn, float(idata["sample_stats"].attrs.get("ess_bulk", drawn)))


def _too_few(idata: az.InferenceData) -> list[str]:
    """A warning where the draws are too few for bands; none of a method that gives one path and no bands."""
    draws = independent_draws(idata)
    if draws >= MIN_DRAWS or idata.attrs["method"] == "differentiate":
        return []
    return [
        f"warning: bands of {MIN_DRAWS} independent draws or more mean something, these rest on {draws:.2g}: "
        "raise --filters, --particles or --set draws"
    ]


def doubts_of(idata: az.InferenceData) -> list[str]:
    """What may be wrong with a posterior, one line each; none where nothing is in doubt."""
    few = [f"warning: {each}" for each in (uneven(idata),) if each]
    body = [idata.attrs["body_doubt"]] if "body_doubt" in idata.attrs else []
    return [*json.loads(idata.attrs["settings"]).get("in_doubt", []), *_too_few(idata), *few, *body]


ACTUATOR_TITLES = {"activation": "Activations", "actuator_force": "Forces of actuators (N)"}


def summary_text(idata: az.InferenceData) -> str:
    """What is in doubt first; then the table above and a line on evidence and sampler, where the method has them."""
    filters, frames = idata["sample_stats"].sizes["filter"], idata["posterior"].sizes["time"]
    quantity = "torque" if "torque" in idata["posterior"] else "angle"
    table = quantity_table(idata, quantity).to_string(float_format=lambda value: f"{value:.3g}")
    evidence, outer = idata.attrs["log_evidence"], idata.attrs["outer_ess"]
    known = []
    if math.isfinite(evidence):
        bound = "bound of the " if idata["sample_stats"].attrs.get("bound", 0) else ""
        doubt = evidence_note(idata)
        known.append(f"{bound}log evidence {doubt}" if doubt else f"{bound}log evidence {evidence:.2f}")
    if "ess" in idata["sample_stats"]:
        known.append(f"outer effective sample size {outer:.1f} of {filters} filters")
    unit = " or ".join(dict.fromkeys(unit_of(idata, quantity, k) for k in range(idata["posterior"].sizes["joint"])))
    settings = json.loads(idata.attrs["settings"])
    doubts = doubts_of(idata)
    lines = [f"{line}\n" * (line is doubts[-1]) or line for line in doubts]
    lines += [f"Joint {quantity}s ({unit}) over {frames} frames\n\n{table}\n\n{'; '.join(known)}".rstrip()]
    lines += _of_paths(idata)
    for name, title in ACTUATOR_TITLES.items():
        if name in idata["posterior"]:
            lines += [f"{title}\n\n{quantity_table(idata, name).to_string(float_format='{:.3g}'.format)}\n"]
    length = idata["posterior"]["position"].attrs["units"]
    lines += [f"{link}: length {mean:.4g} ± {sd:.2g} {length}" for link, (mean, sd) in learned_lengths(idata).items()]
    if torques := settings.get("torque_evidence"):
        best = max(torques, key=torques.get)
        others = " and ".join(f"{name} {torques[best] - torques[name]:.1f} nat" for name in torques if name != best)
        lines.append(f"torque process {best}, by evidence; behind it {others}")
        if sets := settings.get("torque_sets"):
            shares = ", ".join(f"{name} {count / sum(sets.values()):.0%}" for name, count in sets.items())
            lines[-1] += f"; draws are of {shares}"
    notes = ("engine", "charts", "unseen", "hidden", "base")
    lines += [str(idata.attrs[note]) for note in notes if note in idata.attrs]
    return "\n".join(lines)


def _of_paths(idata: az.InferenceData) -> list[str]:
    """Peaks, impulses and work of the torques, with intervals; nothing of a kinematic posterior or a single row."""
    posterior = idata["posterior"]
    if "torque" not in posterior or posterior.sizes["time"] < MIN_TIMES:
        return []
    table, cells = functional_table(idata), pd.DataFrame(index=pd.Index(posterior["joint"].values, name="joint"))
    for name, rows in table.groupby("functional", sort=False):
        bounds = [
            f"{row['median']:.3g} [{row['q05']:.3g}, {row['q95']:.3g}] {row['unit']}" for _, row in rows.iterrows()
        ]
        cells[name] = bounds
    first = f"Of whole paths at the frames' times, median and 90 % interval\n\n{cells.T.to_string()}\n"
    return ["", first]


SCORES = {"rmse": "error rms", "crps": "CRPS", "coverage_50": "50 % covers", "coverage_90": "90 % covers"}


def comparison_text(comparison: Comparison) -> str:
    """Tables of a comparison for a terminal: against the truth, if known; evidence, mixing and cost; what failed."""
    table, blocks = comparison.table, []
    names = [name.removesuffix("_rmse") for name in map(str, table) if name.endswith("_rmse")]
    if names:
        scores = {
            (joint, method): {title: row[f"{joint}_{name}"] for name, title in SCORES.items()}
            for joint in names
            for method, row in table.iterrows()
        }
        posterior = next(iter(comparison.posteriors.values()))["posterior"]
        of_arm = "torque" in posterior
        what = f"Joint torques ({posterior['torque'].attrs['units']})" if of_arm else "States"
        frame = pd.DataFrame.from_dict(scores, orient="index")
        frame.index = pd.MultiIndex.from_tuples(frame.index, names=["joint" if of_arm else "state", "method"])
        blocks.append(f"{what} against the truth\n\n{_printed(frame)}")
    score = f", one-step log score over {comparison.held_out} held-out frames (nat a frame)"
    blocks.append(f"Evidence (nat){score if comparison.held_out else ''}, cost")
    blocks.append(_columns(table, EVIDENCE_AND_COST))
    blocks.append("Leave one row out (nat), and mixing of the worst number (MCSE in posterior sd)")
    blocks.append(_columns(table, MIXING))
    reasons = [f"{method} failed: {reason}" for method, reason in comparison.failures.items()]
    reasons += [f"{method}: {note}" for method, note in comparison.notes.items()]
    if reasons:
        blocks.append("\n".join(reasons))
    return "\n\n".join(blocks)


EVIDENCE_AND_COST = (
    ("log_evidence", "log evidence", 2),
    ("log_evidence_sd", "±", 2),
    ("replicates_sd", "± replicates", 2),
    ("evidence_kind", "which is", None),
    ("log_score", "log score", 3),
    ("outer_ess", "outer ESS", 1),
    ("seconds", "seconds", 2),
    ("memory", "MiB", 0),
)
MIXING = (
    ("elpd_loo", "elpd", 2),
    ("elpd_loo_se", "±", 2),
    ("pareto_k", "Pareto k", 2),
    ("r_hat", "R-hat", 2),
    ("ess_bulk", "ESS bulk", 0),
    ("ess_tail", "ESS tail", 0),
    ("mcse", "MCSE", 3),
    ("ess_per_second", "ESS/s", 1),
)
"""Columns of a comparison's table, their titles, and digits after the point."""


def _columns(table: pd.DataFrame, columns: tuple[tuple[str, str, int | None], ...]) -> str:
    """Those columns that have a number or a word."""
    shown = pd.DataFrame(index=table.index)
    for name, title, digits in columns:
        cells = [value if digits is None else f"{value:.{digits}f}" for value in table[name]]
        if name == "log_evidence":
            cells = ["not usable" if no else cell for cell, no in zip(cells, table["usable"].eq(False), strict=True)]
        if any(cell not in ("nan", "") for cell in cells):
            shown[title] = cells
    return _printed(shown.replace({"nan": "–", "": "–"}))


def _printed(table: pd.DataFrame) -> str:
    return table.to_string(float_format=lambda value: f"{value:.3g}", na_rep="–")
