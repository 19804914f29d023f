"""Dry friction on some joints at once: it takes what speed there is, and holds a joint that is at rest.

Maximum dissipation: of all frictions within their levels, |f_j| ≤ L_j, those that bring the joints closest to a stop
within a sub-step h. With a_0 the accelerations without friction and A = (D + diag I_own)⁻¹

    f = argmin ½ fᵀ A f + fᵀ (a_0 + θ̇/h),   |f_j| ≤ L_j

by projected Gauss–Seidel sweeps (Jean & Moreau's contact solver) from what would stop all joints; that is exact for one
joint, and for any that all stick. A joint that slides gets −L sgn θ̇; one at rest that nothing overcomes stays at rest,
and does not creep as under a smoothed sign. Let a be a joint's acceleration but for its own friction. A joint that
comes to a stop within h does so at t* = |θ̇| / (A L − a sgn θ̇). If it is then pushed on, |a| > A L, it gets the mean
of what acts before and after, L (1 − 2 t*/h) sgn θ̇. Where friction f(t) jumps within h like this, or holds what has
stopped, its mean f̄ alone gives the right speed, but not the right place: that is off by

    A ∫₀ʰ (h − t) (f − f̄) dt = −A L t* (h − t*) sgn θ̇   where it is pushed on,   −½ θ̇ (h − t*) where it stays.

Regularised friction (:mod:`.regularised_friction`) settles a joint with a time constant T, but lets it creep at a ρ.
Then w = θ̇ − a ρ falls as exp(−t/T) between T (A L − a) and −T (A L + a); above them friction is −L, below them +L. At
constant a, a sub-step's mean and end thus have closed forms. Between two joints w and h / (1 − exp(−h/T)) take the
places of θ̇ and h.

Levels that change with speed or load, and what regularised friction settles against, are taken half a sub-step later,
where the friction of the start takes the joint (midpoint rule: Hairer, Nørsett & Wanner 1993, §II.1). For a joint that
slides, this is of second order in h, not of first.
"""

from collections.abc import Callable, Mapping

import torch
from torch import Tensor

from invdyn.models.effects.effect_context import Situation

SWEEPS = 3
AT_ONCE = 1e-6
"""s: a shorter time constant is none."""


def dry_friction(
    levels: Mapping[int, Tensor],
    now: Situation,
    torque: Tensor,
    own: Tensor | None,
    levels_at: Callable[[Tensor, Tensor], Mapping[int, Tensor]] | None = None,
    settling: Mapping[int, tuple[Tensor, Tensor]] | None = None,
    held: bool = False,
) -> tuple[Tensor, Tensor, Tensor]:
    """Friction's mean over a sub-step (..., K), N·m; what q, rad, is off by at its end under it; θ̈ under it.

    ``levels`` maps joints to L (..., 1). ``levels_at`` does so at other angles and velocities (..., K), where levels
    change with them. ``torque`` (..., K) holds all other torques, ``own`` (..., K) the joints' own inertias, or None.
    ``settling`` maps joints with regularised friction to T and ρ (..., 1), s. If ``held``, the friction is that of
    the whole sub-step, and not of its start alone.
    """
    q, still = now.q, torch.zeros_like(now.q)
    free = now.dynamics.forward(q, now.qd, torque, now.body, own)
    braking = now.qd / now.step
    settling = {j: (time.clamp_min(AT_ONCE), creep) for j, (time, creep) in (settling or {}).items()}
    for j, (time, creep) in settling.items():
        v = now.qd[..., j : j + 1]
        settled = (v - free[..., j : j + 1] * creep) * torch.expm1(-now.step / time).neg()
        braking = braking + now.at(j, (settled - v) / now.step)
    wanted = free + braking
    columns = {j: now.dynamics.response(q, now.at(j, still[..., :1] + 1), now.body, own) for j in levels}
    friction = _stopping(levels, wanted, columns) if len(levels) > 1 else dict.fromkeys(levels, still[..., :1])
    for j, f in friction.items():
        wanted = wanted + columns[j] * f
    wanted = _swept(friction, levels, wanted, columns)
    gained = still
    if levels_at is not None or (held and settling):
        half = now.step / 2
        there = q + half * now.qd, now.qd + half * (wanted - braking)
        if levels_at is not None:
            levels = levels_at(*there)
            wanted = _swept(friction, levels, wanted, columns)
        if settling:
            gained = now.dynamics.forward(*there, torque, now.body, own) - free
    moved = still
    under = wanted
    for j, level in levels.items():
        mobility, v = columns[j][..., j : j + 1], now.qd[..., j : j + 1]
        pushed = (wanted - braking)[..., j : j + 1] - mobility * friction[j]
        if j in settling:
            time, creep = settling[j]
            pushed = pushed + gained[..., j : j + 1]
            mean, off = _settled(level, pushed, mobility, time, v - pushed * creep, now.step)
        else:
            mean, off = _through_stops(friction[j], level, pushed, mobility, v, now.step)
        moved, under = moved + columns[j] * off, under + columns[j] * (mean - friction[j])
        friction[j] = mean
    return sum((now.at(j, f) for j, f in friction.items()), start=still), moved, under - braking


def _swept(
    friction: dict[int, Tensor], levels: Mapping[int, Tensor], wanted: Tensor, columns: Mapping[int, Tensor]
) -> Tensor:
    """Sweep over the joints; changes ``friction`` and returns what is ``wanted`` under it."""
    for _ in range(SWEEPS if len(levels) > 1 else 1):
        for j, level in levels.items():
            column = columns[j]
            best = friction[j] - wanted[..., j : j + 1] / column[..., j : j + 1]
            new = _within(best, level)
            wanted, friction[j] = wanted + column * (new - friction[j]), new
    return wanted


def _through_stops(
    f: Tensor, level: Tensor, pushed: Tensor, mobility: Tensor, v: Tensor, step: Tensor
) -> tuple[Tensor, Tensor]:
    """A joint's mean friction (..., 1), and ∫ (h − t) (f − f̄) dt, N·m·s², where it comes to a stop within the step."""
    pace = mobility * level - pushed * v.sign()
    stops = (pace > 0) & (v.abs() < step * pace)
    turns = stops & (pushed * v < 0) & (pushed.abs() > mobility * level)
    # where nothing stops the quotient's slope must not count either
    time = v.abs() / torch.where(stops, pace, torch.ones_like(pace))
    f = torch.where(turns, v.sign() * level * (1 - 2 * time / step), f)
    late = torch.where(turns, -v.sign() * level * time, -v / (2 * mobility)) * (step - time)
    return f, torch.where(stops, late, torch.zeros_like(late))


def _settled(
    level: Tensor, pushed: Tensor, mobility: Tensor, time: Tensor, v: Tensor, step: Tensor
) -> tuple[Tensor, Tensor]:
    """The same of a joint that is ``v`` faster than it creeps, pushed by a constant acceleration."""
    most = mobility * level
    hi, lo = time * (most - pushed), -time * (most + pushed)
    # It slides, until it is as slow as friction can settle it;
    side = (v > hi).to(v) - (v < lo).to(v)
    rate = pushed - side * most
    edge = torch.where(side > 0, hi, lo)
    closing = (side != 0) & (-side * rate > 0)
    slid = torch.where(closing, (edge - v) / torch.where(closing, rate, 1.0), torch.where(side == 0, 0.0, step))
    slid = torch.minimum(slid, step + torch.zeros_like(slid))
    v1 = v + slid * rate
    # settles, until what pushes it takes it on;
    leaves = (hi < 0) | (lo > 0)
    out = torch.where(hi < 0, hi, lo)
    ratio = torch.where(leaves & (slid < step), v1 / torch.where(leaves, out, 1.0), 1.0).clamp_min(1.0)
    left = step - slid
    soft = torch.where(leaves, torch.minimum(time * ratio.log(), left), left)
    v2 = v1 * torch.exp(-soft / time)
    # and slides on.
    left = left - soft
    onward = pushed - torch.where(hi < 0, most, -most)
    v3 = v2 + left * torch.where(leaves, onward, 0.0)
    mean = ((v3 - v) / step - pushed) / mobility
    there = slid * (v + v1) / 2 + time * (v1 - v2) + left * (v2 + v3) / 2
    return mean, (there - step * (v + v3) / 2) / mobility


def _stopping(levels: Mapping[int, Tensor], wanted: Tensor, columns: Mapping[int, Tensor]) -> dict[int, Tensor]:
    """Frictions that would stop all these joints at once, cut to their levels."""
    joints = list(levels)
    matrix = torch.stack([columns[j][..., joints] for j in joints], -1)
    stop = torch.linalg.solve(matrix, -wanted[..., joints].unsqueeze(-1))
    return {j: _within(stop[..., n, :], levels[j]) for n, j in enumerate(joints)}


def _within(value: Tensor, level: Tensor) -> Tensor:
    # not clamp: at level 0 the slope in the level counts
    return torch.where(value > level, level, torch.where(value < -level, -level, value))
