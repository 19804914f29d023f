"""Averages of a study as a figure: one panel a joint, one colour a level of the factor.

The dark band is the 90 % interval of the average, the pale one that of a further trial.
"""

from typing import Any

import matplotlib
import pandas as pd
from matplotlib.figure import Figure

# Okabe and Ito's colours: the colour-blind can distinguish them too.
COLORS = ("#0072B2", "#D55E00", "#009E73", "#AA4499", "#E69F00", "#56B4E9")
STYLE: dict[Any, Any] = {
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#999999",
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#e9e9e9",
    "grid.linewidth": 0.6,
    "axes.titlesize": 9.5,
    "axes.labelsize": 9,
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
    "xtick.color": "#555555",
    "ytick.color": "#555555",
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "text.parse_math": False,  # a joint may be called $\\frac
    "font.family": "DejaVu Sans",  # comes with matplotlib: every machine draws the same
}


def plot_averages(averages: pd.DataFrame, align: str, factor: str) -> Figure:
    """The figure of what :func:`.average_curves` returned."""
    joints, levels = averages["joint"].unique(), sorted(averages[factor].unique())
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(7.0, 0.8 + 2.3 * len(joints)), layout="constrained")
        panels = figure.subplots(len(joints), 1, squeeze=False, sharex=True)[:, 0]
        for panel, joint in zip(panels, joints, strict=True):
            for number, level in enumerate(levels):
                rows = averages[(averages["joint"] == joint) & (averages[factor] == level)]
                color = COLORS[number % len(COLORS)]
                words = f"{level or factor} ({rows['trials'].max()} trials)"
                panel.fill_between(rows["time"], rows["trial_q05"], rows["trial_q95"], color=color, alpha=0.13, lw=0)
                panel.fill_between(rows["time"], rows["q05"], rows["q95"], color=color, alpha=0.35, lw=0)
                panel.plot(rows["time"], rows["mean"], color=color, lw=1.6, label=words)
            panel.axvline(0.0, color="#777777", lw=0.9, ls=":")
            unit = averages.loc[averages["joint"] == joint, "unit"].iloc[0]
            panel.set_ylabel(f"{joint} ({unit})")
        panels[0].legend(ncols=min(3, len(levels)), loc="best")
        panels[0].set_title("Torques: average (dark) and a further trial (pale), 90 %", loc="left")
        panels[-1].set_xlabel(f"time after {align} (s)")
    return figure
