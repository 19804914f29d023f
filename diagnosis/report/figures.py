"""Timeline, state-space maps and residual torques."""

import numpy as np
from markupsafe import Markup

from invdyn.diagnosis.assessment.result import Diagnosis
from invdyn.diagnosis.report.drawing import Plot, limits
from invdyn.diagnosis.report.numbers import fixed, handy, percent, plain, root_mean_square
from invdyn.diagnosis.rules import FIXED
from invdyn.inference.posterior.functionals import Z90


def timeline(diagnosis: Diagnosis) -> Markup | None:
    """What the corrected simulation predicts each frame better by, with the stretches that hold the gap."""
    tracks = diagnosis.tracks
    if tracks is None or not np.isfinite(tracks.frame_gap).any():
        return None
    time = tracks.time
    low, high = limits(tracks.frame_gap, zero=True)
    room = 0.2 * (high - low) if diagnosis.where.intervals else 0.0  # for the shares
    plot = Plot(limits(time, margin=0), (low, high + room), "time, s", "nats a frame", height=150)
    for interval in diagnosis.where.intervals:
        plot.span(interval.start, interval.stop, percent(interval.share) if interval.share >= 0.1 else "")
    plot.level(0.0)
    plot.line(time, tracks.frame_gap, "line gap")
    spans = [f"{percent(i.share)} from {i.start:.2f} to {i.stop:.2f} s" for i in diagnosis.where.intervals]
    total = fixed(float(np.nanmean(tracks.frame_gap)), 2)
    return plot.html(
        f"Gap of each frame over time, {total} nats a frame on average; {'; '.join(spans) or 'no stretch'}"
    )


def maps(diagnosis: Diagnosis) -> list[dict]:
    """Of each joint: name, residual torque over angle and velocity before and after, its key, whether it is quiet.

    Where nothing was corrected "after" is the same, and None.
    """
    tracks = diagnosis.tracks
    if tracks is None:
        return []
    found = []
    for j, name in enumerate(diagnosis.joint_names):
        before, after = tracks.residual_before[:, j], tracks.residual_after[:, j]
        (way, unit), scale = (("position", "m"), 1.0) if name in diagnosis.shifting else (("angle", "°"), 180 / np.pi)
        angle, velocity = scale * tracks.angle[:, j], scale * tracks.velocity[:, j]
        if not np.isfinite(before).any() or not np.isfinite(angle).any():
            continue
        peak = float(np.nanquantile(np.abs(before), 0.98))
        sd = tracks.residual_before_sd[:, j]
        doubt = Z90 * float(np.nanmedian(sd)) if np.isfinite(sd).any() else 0.0
        low = max(FIXED.min_map_share * peak, doubt, 1e-9)
        edges = low + max(peak - low, low) * np.array([0.0, 1 / 3, 2 / 3])
        stride = -(-len(angle) // (2 * FIXED.max_plot_points))
        sides, coloured = [], 0.0
        for words, residual in _sides(before, after):
            plot = Plot(
                limits(angle), limits(velocity, zero=True), f"{way}, {unit}", f"velocity, {unit}/s", (3, 4), 190
            )
            plot.level(0.0)
            classes = np.where(np.isfinite(residual), np.searchsorted(edges, np.abs(residual)), -1)
            coloured = max(coloured, float(np.mean(classes > 0)))
            for c in range(len(edges) + 1):  # large ones last, on top
                for sign, mask in (("plus", residual >= 0), ("minus", residual < 0)):
                    here = np.flatnonzero(mask & (classes == c))[:: stride if c == 0 else max(stride // 2, 1)]
                    plot.dots(angle[here], velocity[here], f"dot {sign} c{c}")
            rms = handy(root_mean_square(residual), diagnosis.torque_unit(name))
            sides.append(plot.html(f"Residual torque of {name} {words}, {rms} rms, over its {way} and velocity"))
        key = [plain(edge, 2) for edge in edges]
        shown = {"joint": name, "before": sides[0], "after": sides[1] if len(sides) > 1 else None}
        found.append(
            shown | {"unit": diagnosis.torque_unit(name), "key": key, "quiet": coloured <= FIXED.max_quiet_share}
        )
    return found


def _sides(before: np.ndarray, after: np.ndarray) -> list[tuple[str, np.ndarray]]:
    """What is drawn, in words and numbers; after is left out where it is before, as nothing was corrected."""
    return [("before", before), *([] if np.array_equal(before, after, equal_nan=True) else [("after", after)])]


def residuals(diagnosis: Diagnosis) -> list[dict]:
    """Of each joint: name, residual torque over time before and after with 90 % bands, and their rms.

    As high as the residuals and a usual band: at the first rows a band may be the prior's. Where nothing was corrected
    "after" is the same, and None.
    """
    tracks = diagnosis.tracks
    if tracks is None:
        return []
    found = []
    for j, name in enumerate(diagnosis.joint_names):
        torque = diagnosis.torque_unit(name)
        halves = {"before": Z90 * tracks.residual_before_sd[:, j], "after": Z90 * tracks.residual_after_sd[:, j]}
        sides = _sides(tracks.residual_before[:, j], tracks.residual_after[:, j])
        pairs = [(words, mean, halves[words]) for words, mean in sides]
        usual = [np.nanmedian(half) if np.isfinite(half).any() else 0.0 for *_, half in pairs]
        everything = [v for (_, mean, _), wide in zip(pairs, usual, strict=True) for v in (mean - wide, mean + wide)]
        plot = Plot(limits(tracks.time, margin=0), limits(*everything, zero=True), "time, s", torque, height=150)
        for words, mean, half in pairs:
            plot.band(tracks.time, mean - half, mean + half, f"band {words}")
        plot.level(0.0)
        for words, mean, _ in pairs:
            plot.line(tracks.time, mean, f"line {words}")
        rms = [handy(root_mean_square(mean), torque) for _, mean, _ in pairs]
        after = rms[1] if len(rms) > 1 else None
        label = f"Residual torque of {name} over time: {rms[0]} rms" + (f" before, {after} after" if after else "")
        command = None if tracks.command is None else handy(root_mean_square(tracks.command[:, j]), torque)
        found.append({"joint": name, "figure": plot.html(label), "before": rms[0], "after": after, "command": command})
    return found
