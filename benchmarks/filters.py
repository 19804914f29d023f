"""Particle filters side by side: particle-steps a second, and what a nat of precision costs.

The paper's planar arm (see planar_paper.py, ε .1, T 200), one bootstrap filter written for each of

    invdyn eager, invdyn compiled   this project, one filter of N
    invdyn M × N                    the same, compiled, 64 filters of N at once (at the smallest N)
    SMCFilter                       Pyro's own, on this project's model and guide: it keeps no evidence
    particles                       numpy, float64
    jax scan                        jax.lax.scan of a filter written here, jitted

and this project's controlled filter. All in float32 unless said, systematic resampling below an ESS of N/2, the same
number of threads, in one process and one run: filters take turns, the best time of each counts. Bootstrap filters
share one law, as controlled ones do, so their log Ẑ's are pooled for the variance; `var × s` is that variance times
the seconds of one filter: what has a hundredth of it needs a hundredth of the time for the same precision. Compiling
and, for the controlled filter, its guide come before the clock starts; the last line counts the guide's seconds in.

    python benchmarks/filters.py [--particles 1000 64000 100000] [--seconds 40] [--threads 2]
    python benchmarks/filters.py --threads 1 --cpu-seconds      on a machine that others use
    python benchmarks/filters.py --device cuda          this project alone, 1e3 … 1e7 particles
"""

import argparse
import os
import time
import warnings
from collections.abc import Callable

import numpy as np
import torch
from planar_paper import paper_problem

from invdyn.inference import Bootstrap, Controlled, ParticleFilter, gaussian_smoother
from invdyn.models import ArmModel

NESTED = 64
FEWEST = 3
"""Turns that each has at least."""
Run = Callable[[], np.ndarray]
"""One run; log Ẑ of its filters (M,), NaN where it is not kept."""


# -- the arm, for numpy and jax: two links in absolute angles φ --------------------------------------
def constants(model: ArmModel) -> dict[str, np.ndarray]:
    body = model.body_parameters()
    names = ("length", "mass", "com", "inertia", "gravity", "base")
    p = {name: getattr(body, name).double().numpy() for name in names}
    return p | {
        "dt": float(model.dt[1]),
        "decay": model.parameters["torque.decay"].double().numpy(),
        "sd": model.transition(torch.zeros(6, dtype=model.dtype), 1).base_dist.scale.double().numpy(),
        "first": model.initial().base_dist.scale.double().numpy(),
        "noise": float(model.parameters["emission.keypoint_scale"][0]),
    }


def mean(xp, x, p):
    """Explicit Euler of x (N, 6): torques, angles, velocities."""
    (l1, _), (m1, m2), (c1, c2), (i1, i2), (gx, gy) = (p[n] for n in ("length", "mass", "com", "inertia", "gravity"))
    t1, t2, q1, q2, v1, v2 = (x[:, k] for k in range(6))
    a, b, w2 = q1, q1 + q2, v1 + v2
    sa, ca, sb, cb = xp.sin(a), xp.cos(a), xp.sin(b), xp.cos(b)
    k = m2 * l1 * c2
    m11, m22, m12 = i1 + m1 * c1**2 + m2 * l1**2, i2 + m2 * c2**2, k * (ca * cb + sa * sb)
    s = k * (sa * cb - ca * sb)
    f1 = t1 - t2 - s * w2**2 + (m1 * c1 + m2 * l1) * (gy * ca - gx * sa)
    f2 = t2 + s * v1**2 + m2 * c2 * (gy * cb - gx * sb)
    det = m11 * m22 - m12**2
    a1, a2 = (m22 * f1 - m12 * f2) / det, (m11 * f2 - m12 * f1) / det
    h, (d1, d2) = p["dt"], p["decay"]
    columns = ((1 - h * d1) * t1, (1 - h * d2) * t2, q1 + h * v1, q2 + h * v2, v1 + h * a1, v2 + h * (a2 - a1))
    return xp.stack(columns, 1)


def tips(xp, x, p):
    """Keypoints (N, 4)."""
    (l1, l2), (x0, y0) = p["length"], p["base"]
    a, b = x[:, 2], x[:, 2] + x[:, 3]
    x1, y1 = x0 + l1 * xp.cos(a), y0 + l1 * xp.sin(a)
    return xp.stack((x1, y1, x1 + l2 * xp.cos(b), y1 + l2 * xp.sin(b)), 1)


def check_same_arm(model: ArmModel, p) -> None:
    x = torch.randn(100, 6, dtype=model.dtype)
    np.testing.assert_allclose(
        mean(np, x.double().numpy(), p), model.transition_mean(x, 5).numpy(), atol=2e-4, rtol=1e-4
    )
    np.testing.assert_allclose(tips(np, x.double().numpy(), p), model.emission(x, 5).mean.numpy(), atol=1e-5)


# -- the contenders --------------------------------------------------------------------------------
def ours(model, guide, rows: torch.Tensor, size: int, filters: int = 1, compiled: bool = False) -> Run:
    particle_filter = ParticleFilter(model, guide, size, num_filters=filters, compiled=compiled)

    def run() -> np.ndarray:
        return particle_filter.run(rows, keep=0).log_evidence.cpu().numpy()

    return run


def stock(model, guide, rows: torch.Tensor, size: int) -> Run:
    from pyro.infer import SMCFilter

    @torch.no_grad()
    def run() -> np.ndarray:
        smc = SMCFilter(model, guide, size, 0)
        smc.init(rows[0])
        try:
            for t in range(1, len(rows)):
                smc.step(t, rows[t])
        except IndexError:  # its float32 cumulative sum can end below 1, and the last ancestor is then N
            return np.empty(0)
        return np.full(1, np.nan)

    return run


def numpy_particles(p, rows: np.ndarray, size: int) -> Run:
    import particles
    from particles import distributions as dists
    from particles import state_space_models as ssm

    def normals(loc, scale):
        return dists.IndepProd(*(dists.Normal(loc=loc[:, k], scale=scale[k]) for k in range(len(scale))))

    class Arm(ssm.StateSpaceModel):
        def PX0(self):
            return dists.IndepProd(*(dists.Normal(scale=scale) for scale in p["first"]))

        def PX(self, t, xp):
            return normals(mean(np, xp, p), p["sd"])

        def PY(self, t, xp, x):
            return normals(tips(np, x, p), [p["noise"]] * 4)

    def run() -> np.ndarray:
        smc = particles.SMC(fk=ssm.Bootstrap(ssm=Arm(), data=rows[:, None]), N=size, resampling="systematic")
        smc.run()
        return np.full(1, smc.logLt)

    return run


def jax_scan(p, rows: np.ndarray, size: int) -> Run:
    import jax
    import jax.numpy as jnp
    from jax.scipy.special import logsumexp

    y = jnp.asarray(rows, jnp.float32)
    first, sd = jnp.asarray(p["first"], jnp.float32), jnp.asarray(p["sd"], jnp.float32)
    p = {name: value if np.ndim(value) == 0 else [float(each) for each in value] for name, value in p.items()}
    constant = 4 * np.log(p["noise"] * np.sqrt(2 * np.pi))

    def weigh(logw, x, y):
        logw = logw - 0.5 * (((tips(jnp, x, p) - y) / p["noise"]) ** 2).sum(1) - constant
        total = logsumexp(logw)
        return logw - total, total

    def resampled(key, x, logw):
        cumulative = jnp.cumsum(jnp.exp(logw))
        points = (jnp.arange(size) + jax.random.uniform(key)) / size * cumulative[-1]
        return x[jnp.searchsorted(cumulative, points, side="right")], jnp.full(size, -np.log(size), jnp.float32)

    def step(carry, y):
        key, x, logw = carry
        key, one, two = jax.random.split(key, 3)
        need = jnp.exp(-logsumexp(2 * logw)) < size / 2
        x, logw = jax.lax.cond(need, lambda: resampled(one, x, logw), lambda: (x, logw))
        x = mean(jnp, x, p) + sd * jax.random.normal(two, x.shape)
        logw, total = weigh(logw, x, y)
        return (key, x, logw), total

    @jax.jit
    def filtered(key):
        key, start = jax.random.split(key)
        x = first * jax.random.normal(start, (size, 6))
        logw, total = weigh(jnp.full(size, -np.log(size), jnp.float32), x, y[0])
        return total + jax.lax.scan(step, (key, x, logw), y[1:])[1].sum()

    numbers = iter(range(10**9))
    return lambda: np.full(1, float(filtered(jax.random.PRNGKey(next(numbers)))))


# -- the run ---------------------------------------------------------------------------------------
def measured(
    contenders: dict[str, Run], budget: float, device: torch.device, clock: Callable[[], float]
) -> dict[str, tuple[float, np.ndarray]]:
    """Best seconds and all log Ẑ of each, taking turns until each has had its share of ``budget`` seconds."""
    seconds, evidence = dict.fromkeys(contenders, np.inf), {name: [] for name in contenders}
    for name, run in contenders.items():
        if "compiled" in name or "jax" in name:  # at the first time
            run()
    used, turn = dict.fromkeys(contenders, 0.0), 0
    while going := [name for name in contenders if turn < FEWEST or used[name] < budget / len(contenders)]:
        for name in going:
            start = clock()
            values = contenders[name]()
            if device.type == "cuda":
                torch.cuda.synchronize()
            took = clock() - start
            used[name] += took
            if len(values):  # a run that failed has none
                seconds[name] = min(seconds[name], took)
                evidence[name].append(values)
        turn += 1
    return {name: (seconds[name], np.concatenate([np.empty(0), *evidence[name]])) for name in contenders}


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--particles", type=int, nargs="+")
    parser.add_argument("--seconds", type=float, default=40, help="for each number of particles, without compiling")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--device", default="cpu")
    parser.add_argument(
        "--cpu-seconds", action="store_true", help="count those, on a machine that others use; 1 thread"
    )
    parser.add_argument("--seed", type=int, default=0)
    return parser.parse_args()


def main() -> None:
    given = arguments()
    device = torch.device(given.device)
    clock = time.process_time if given.cpu_seconds else time.perf_counter
    torch.set_num_threads(given.threads)
    torch.manual_seed(given.seed)
    np.random.seed(given.seed)  # noqa: NPY002, which `particles` draws from
    sizes = given.particles or ([1000, 64_000, 100_000] if device.type == "cpu" else [10**k for k in range(3, 8)])
    if device.type == "cpu" and hasattr(os, "sched_setaffinity"):
        # So that jax, which takes every core it finds, gets no more than the others.
        os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[: given.threads])

    problem = paper_problem(0.1, given.seed)
    start = clock()
    smoother = gaussian_smoother(problem.model, problem.observations)
    guide_seconds = clock() - start
    model = problem.model.to(dtype=torch.float32, device=device)
    rows = problem.observations.to(dtype=torch.float32, device=device)
    blind, ahead = Bootstrap(model), Controlled(model, problem.observations, smoother)
    where = torch.cuda.get_device_name() if device.type == "cuda" else f"{os.cpu_count()} cores"
    kind = "CPU" if given.cpu_seconds else "wall"
    print(f"{where}, {given.threads} threads, torch {torch.__version__}, load {os.getloadavg()[0]:.1f} at the start;")
    print(f"T {len(rows)}, {kind} seconds, best of all turns; the controlled guide: {guide_seconds:.2f}, once\n")
    print(
        "| N | filter | M particle-steps/s | s a filter | filters | median log Ẑ | var log Ẑ | var × s |\n"
        "|---|---|---|---|---|---|---|---|",
        flush=True,
    )
    speed: dict[tuple[str, int], float] = {}
    costs: dict[str, list[float]] = {"peer": [], "controlled": []}
    for size in sizes:
        contenders, filters = everyone(problem, model, rows, blind, ahead, size, size == min(sizes), device)
        results = measured(contenders, given.seconds, device, clock)
        pooled = {
            kind: np.concatenate([z for name, (_, z) in results.items() if ("controlled" in name) == kind])
            for kind in (True, False)
        }
        for name, (seconds, evidence) in results.items():
            each, variance = seconds / filters.get(name, 1), np.nanvar(pooled["controlled" in name], ddof=1)
            speed[name, size] = len(rows) * size / each / 1e6
            kept = not np.isnan(evidence).all()
            if "controlled" in name:
                # Its guide is paid for, too, if once.
                costs["controlled"].append(variance * (each + guide_seconds))
            elif kept and name in ("particles", "jax scan"):
                costs["peer"].append(variance * each)
            text = f"{np.nanmedian(evidence):.2f} | {variance:.3g} | {variance * each:.3g}" if kept else "not kept | |"
            failed = "" if len(evidence) else " (every run failed: index N)"
            print(
                f"| {size} | {name}{failed} | {speed[name, size]:.2f} | {each:.4f} | {len(evidence)} | {text} |",
                flush=True,
            )
    print(f"\nload {os.getloadavg()[0]:.1f} at the end\n")
    if device.type == "cpu":
        targets(speed, sizes, costs)


def everyone(problem, model, rows, blind, ahead, size: int, nested: bool, device) -> tuple[dict[str, Run], dict]:
    """All contenders of ``size`` particles, and the number of filters of those that run several."""
    contenders: dict[str, Run] = {
        "invdyn eager": ours(model, blind, rows, size),
        "invdyn compiled": ours(model, blind, rows, size, compiled=True),
        "invdyn controlled": ours(model, ahead, rows, size),
        "invdyn controlled, compiled": ours(model, ahead, rows, size, compiled=True),
    }
    filters = {}
    if nested:
        for name, guide in (("invdyn", blind), ("invdyn controlled", ahead)):
            contenders[f"{name}, compiled, {NESTED} × N"] = ours(model, guide, rows, size, NESTED, True)
            filters[f"{name}, compiled, {NESTED} × N"] = NESTED
    if device.type == "cpu":
        p = constants(model)
        check_same_arm(model, p)
        data = problem.observations.numpy()
        contenders |= {
            "SMCFilter": stock(model, blind, rows, size),
            "particles": numpy_particles(p, data, size),
            "jax scan": jax_scan(p, data, size),
        }
    return contenders, filters


def targets(speed: dict[tuple[str, int], float], sizes: list[int], costs: dict[str, list[float]]) -> None:
    """The ratios that count, with what was aimed at."""
    print("| ratio | found | target |\n|---|---|---|")
    for size in sizes:
        for peer in ("jax scan", "SMCFilter", "particles"):
            if speed[peer, size]:
                target = {("jax scan", 64_000): "≥ 1.5", ("SMCFilter", 1000): "≥ 8"}.get((peer, size), "")
                ratio = speed["invdyn compiled", size] / speed[peer, size]
                print(f"| N {size}: invdyn compiled, one filter, over {peer} | {ratio:.2f} | {target} |")
    many = speed[f"invdyn, compiled, {NESTED} × N", min(sizes)]
    for peer in ("jax scan", "SMCFilter"):
        print(f"| N {min(sizes)}: {NESTED} filters at once over {peer} | {many / speed[peer, min(sizes)]:.2f} | |")
    best = {name: min(values) for name, values in costs.items()}
    print(
        f"| var × s: best bootstrap peer, {best['peer']:.3g}, over controlled with its guide's seconds, "
        f"{best['controlled']:.3g} | {best['peer'] / best['controlled']:.0f} | ≥ 1000 |"
    )


if __name__ == "__main__":
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FutureWarning)
        main()
