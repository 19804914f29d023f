"""Studies of simulated trials: what they cost, whether intervals hold the truth, what sharing gains, kills at any time.

    python benchmarks/study.py size             180 trials: 3 subjects, 3 sessions, 2 conditions, one bad session
    python benchmarks/study.py coverage         100 small studies with an effect at one joint and none at the other
    python benchmarks/study.py pooling          the same of 400 studies whose trials' estimates are drawn, not inferred
    python benchmarks/study.py kill             one study, killed ten times and resumed

An arm hangs; a torque lifts it, sin² in time, whose size the condition changes by `EFFECT`, and by another share in
each subject. Around it are Ornstein–Uhlenbeck torques, new in each trial. Sessions have noises of their own, and 5 % of
the frames are lost. In the bad session the camera's scale is off by 15 %.
"""

import argparse
import os
import signal
import subprocess
import sys
import tempfile
import time
import warnings
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
import torch
from kept import kept

from invdyn.inference.filters.filtering import SMCOptions
from invdyn.inference.posterior.functionals import path_functionals
from invdyn.inference.smoothing.linearised import gaussian_smoother
from invdyn.inference.study.pooling import pool
from invdyn.inference.study.run import run_study
from invdyn.inference.study.study import FOUND, estimates
from invdyn.inference.study.trial import How, Trial
from invdyn.inference.study.work import bound
from invdyn.inputs import load_body
from invdyn.models import ArmModel, Keypoints, Observation, OrnsteinUhlenbeck
from invdyn.recordings import write_keypoint_csv
from invdyn.simulate import record, resting

EFFECT, DIFFERS = 0.3, 0.15
"""Share by which the condition raises the torque, and its sd between subjects."""
SIZE, SIZE_DIFFERS, TRIAL_DIFFERS = np.array([1.0, 0.15]), 0.15, 0.1
"""N·m of shoulder and elbow, and relative sd between subjects and trials."""
SCALE, DECAY, NOISE = np.array([0.5, 0.08]), 5.0, 0.004
"""Of the Ornstein–Uhlenbeck torques, N·m/√s and 1/s, and of keypoints, m."""
PRECISE = 0.1, 0.05
"""Sd of trials and of the errors of their estimates, N·m, where pooling is asked for effects larger than both."""
LIFT = 0.6
"""s, how long the lifting torque acts."""
BODY = load_body("paper_planar_arm")


def lift(time, begin):
    """The torque's share of its size (…, T)."""
    return np.sin(np.pi * np.clip((time - begin) / LIFT, 0, 1)) ** 2


def simulate(seed, subjects, sessions, trials, rows, fps, effect=EFFECT, bad=None, where=(1.0, 1.0)):
    """Trials with names, and by name their true torques (T, K) and noise; the effect is that share at each joint."""
    rng, found, truths = np.random.default_rng(seed), [], {}
    time_of = np.arange(rows) / fps
    for subject in range(subjects):
        size, gain = SIZE * np.exp(rng.normal(0, SIZE_DIFFERS)), rng.normal(effect, DIFFERS if effect else 0.0)
        for session in range(sessions):
            noise = NOISE * np.exp(rng.normal(0, 0.3))
            for number in range(2 * trials):
                condition = number % 2
                name = f"{subject}-{session}-{number}"
                begin = 0.1 + 0.1 * rng.random()
                own = size * (1 + gain * condition * np.array(where)) * (1 + rng.normal(0, TRIAL_DIFFERS))
                model = ArmModel(
                    BODY,
                    time_of,
                    Observation(Keypoints(BODY.keypoint_names)),
                    torque=OrnsteinUhlenbeck(),
                    command=lift(time_of, begin)[:, None] * own,
                    substeps=int(np.ceil(250 / fps)),
                    parameters={
                        "emission.keypoint_scale": noise,
                        "noise.angle": 0.0,
                        "noise.velocity": 0.0,
                        "initial.angle": resting(BODY),
                        "initial.angle_scale": 0.2,
                        "initial.velocity_scale": 0.1,
                        "torque.scale": SCALE,
                        "torque.decay": DECAY,
                    },
                )
                recording, truth = record(model, int(rng.integers(2**31)), name)
                points = recording.keypoints.copy()
                points[rng.random(rows) < 0.05] = np.nan
                if (subject, session) == bad:
                    points = points * 1.15
                recording = replace(recording, keypoints=points, torques=None, joint_names=())
                labels = {"condition": ("free", "load")[condition]}
                found.append(Trial(name, recording, BODY, f"s{subject}", f"{session}", labels, {"lift": begin}))
                truths[name] = truth, noise
    return found, truths


def true_effect(rows, fps, effect, draws=40_000):
    """E[peak | load] − E[peak | free] of the shoulder over subjects, trials and torques, N·m."""
    rng = np.random.default_rng(1)
    time_of = np.arange(rows) / fps
    keep = np.exp(-DECAY / fps)
    sd = SCALE[0] / np.sqrt(2 * DECAY)
    torque = np.empty((draws, rows))
    torque[:, 0] = sd * rng.normal(size=draws)
    for t in range(1, rows):
        torque[:, t] = keep * torque[:, t - 1] + sd * np.sqrt(1 - keep**2) * rng.normal(size=draws)
    size = SIZE[0] * np.exp(rng.normal(0, SIZE_DIFFERS, draws)) * (1 + rng.normal(0, TRIAL_DIFFERS, draws))
    gain = rng.normal(effect, DIFFERS if effect else 0.0, draws)
    shape = lift(time_of, 0.1 + 0.1 * rng.random(draws)[:, None])

    def peak(sizes):
        whole = torque + shape * sizes[:, None]
        return np.take_along_axis(whole, np.abs(whole).argmax(1)[:, None], 1).mean()

    return peak(size * (1 + gain)) - peak(size)


def size():
    """Cost, what is left out, and what sharing gains."""
    made, truths = simulate(0, 3, 3, 10, 60, 50.0, bad=(1, 2))
    begun = time.process_time()
    study = run_study(made, progress=shown)
    seconds = time.process_time() - begun
    begun = time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        files = study.save(Path(folder) / "study")
        posterior = [file.stat().st_size / 1e6 for file in files if file.suffix == ".nc"]
        writing = time.process_time() - begun
    left = [made[place] for place in study.left_out]
    of_bad = sum((trial.subject, trial.session) == ("s1", "2") for trial in left)
    shared = {place: part["values"] for members, part in study.sessions for place in members}
    print("\n| 180 trials of 60 rows | |\n|---|---|")
    print(f"| CPU s of the study, of its files | {seconds:.0f}, {writing:.0f} |")
    print(f"| MB of posteriors a session, largest | {max(posterior):.1f} |")
    print(f"| left out: of the bad session's 20, of others | {of_bad}, {len(left) - of_bad} |")
    for word, values in (("alone", lambda i: study.fits[i]["values"]), ("shared", lambda i: shared[i])):
        noise = [
            values(i)["emission.keypoint_scale"].log().mean() - np.log(truths[made[i].name][1])
            for i in study.posteriors
        ]
        scale = [values(i)["torque.scale"].log().numpy() for i in study.posteriors]
        some = list(study.posteriors)[::8]
        error = [torque_error(made[i], study.how, values(i), truths[made[i].name][0]) for i in some]
        print(
            f"| {word}: rms of log σ_y's error, sd of log σ_τ, torque's rms error of {len(some)} trials, N·m | "
            f"{np.sqrt(np.square(noise).mean()):.3f}, {np.std(scale, 0).mean():.2f}, {np.mean(error):.4f} |"
        )
    peaks(study, truths)
    own = study.difference().set_index(["joint", "quantity"]).loc[("shoulder", "peak")]
    truth = true_effect(60, 50.0, EFFECT)
    found = f"{own['mean']:.3f} ({own.q05:.3f} to {own.q95:.3f})"
    print(f"| effect on the shoulder's peak, N·m, truth {truth:.3f} | {found} |")


def torque_error(trial, how, values, truth):
    """Rms over rows and joints of the smoother's torque."""
    problem, _ = bound(trial, how)
    model = problem.model.to(dtype=torch.float64).replace(**values)
    path = gaussian_smoother(model, problem.observations.double()).path
    return float(np.sqrt(((model.net_torque(path).numpy() - truth.torque) ** 2).mean()))


def peaks(study, truths):
    """How often a trial's 90 % interval holds its true peak."""
    table = study.table[study.table["quantity"] == "peak"]
    held = []
    for row in table[np.isfinite(table["mean"])].itertuples():
        truth = truths[row.trial][0]
        true = path_functionals(truth.time, truth.torque, truth.velocity)["peak"]
        held.append(row.q05 <= true[truth.joint_names.index(row.joint)] <= row.q95)
    print(f"| true peaks of trials within their 90 % intervals | {np.mean(held):.2f} of {len(held)} |")


def coverage(count, results):
    """Intervals of small studies by full inference: 3 subjects, 2 conditions of 2 trials, 24 rows.

    The condition raises the shoulder's torque and leaves the elbow's, so each study has an effect and none. The file of
    results keeps the trials' estimates, so that a change of the pooling alone takes seconds.
    """
    how = How(sizes=SMCOptions(num_filters=32, num_draws=4))
    truth = {"shoulder": true_effect(24, 25.0, EFFECT), "elbow": 0.0}

    def one(seed):
        begun = time.process_time()
        made, truths = simulate(seed, 3, 1, 2, 24, 25.0, where=(1.0, 0.0))
        study = run_study(made, how)
        seconds = time.process_time() - begun
        true = {name: path_functionals(own.time, own.torque, own.velocity) for name, (own, _) in truths.items()}
        true = {name: {q: each.tolist() for q, each in own.items()} for name, own in true.items()}
        fitted = study.parameters.to_dict("list")
        return {"seconds": seconds, "table": study.table.to_dict("list"), "truth": true, "parameters": fitted}

    lines = [kept(results, f"study {seed}", partial(one, seed)) for seed in range(1000, 1000 + count)]
    cells = {name: np.array([differs(line, name) for line in lines], dtype=float) for name in truth}
    print("| effect of the condition on the peak torque of the | shoulder | elbow |\n|---|---|---|")
    for what, number in (
        ("truth, N·m", lambda name: f"{truth[name]:.3f}"),
        ("mean of the estimates, N·m", lambda name: f"{cells[name][:, 0].mean():.3f}"),
        ("their sd, N·m", lambda name: f"{cells[name][:, 0].std():.3f}"),
        ("width of the 90 % interval, N·m", lambda name: f"{(cells[name][:, 2] - cells[name][:, 1]).mean():.3f}"),
        ("90 % intervals that hold the truth", lambda name: f"{inside(cells[name], truth[name])} of {len(lines)}"),
        ("effect found", lambda name: f"{cells[name][:, 3].sum():.0f} of {len(lines)}"),
    ):
        print(f"| {what} | {number('shoulder')} | {number('elbow')} |")
    print(f"| CPU s of a study of 12 trials | {np.mean([line['seconds'] for line in lines]):.1f} | |")


def differs(line, joint):
    """Mean, q05, q95, and whether the effect is found on the peak at a joint, of a study that was kept."""
    table = pd.DataFrame(line["table"])
    own = table[(table["joint"] == joint) & (table["quantity"] == "peak") & np.isfinite(table["median"])]
    labels = [own[name].tolist() for name in ("condition", "subject", "session")]
    mixture = pool(*estimates(own), *labels).difference("free", "load")
    return *mixture.summary.values(), mixture.direction >= FOUND


def inside(cells, truth):
    return int(((cells[:, 1] <= truth) & (truth <= cells[:, 2])).sum())


def pooling(count):
    """Intervals where trials' errors are as stated: what is left to err is the pooling."""
    columns = "90 % holds it | found | width, N·m"
    print(f"\n| trials | subjects, sessions, trials a cell | effect's sd between subjects | {columns} |")
    print("|---|---|---|---|---|---|")
    noisy = np.hypot(SIZE[0] * TRIAL_DIFFERS, SCALE[0] / np.sqrt(2 * DECAY)), 0.12
    for kind, (own, error), subjects, sessions, trials, effect, differs in (
        ("noisy", noisy, 3, 1, 3, EFFECT, 0.08),
        ("noisy", noisy, 3, 1, 3, EFFECT, DIFFERS),
        ("noisy", noisy, 3, 1, 3, EFFECT, EFFECT),
        ("noisy", noisy, 3, 1, 3, 0.0, 0.0),
        ("precise", PRECISE, 2, 1, 2, 0.0, EFFECT),
        ("precise", PRECISE, 3, 1, 2, 0.0, EFFECT),
        ("precise", PRECISE, 4, 1, 4, 0.0, EFFECT),
        ("precise", PRECISE, 3, 1, 2, 1.0, EFFECT),
    ):
        rng, held, found, width = np.random.default_rng(0), [], [], []
        cells = np.array([(a, b, c) for a in range(subjects) for b in range(sessions) for c in (0, 1)]).repeat(
            trials, 0
        )
        for _ in range(count):
            size, gain = rng.normal(1.0, SIZE_DIFFERS, subjects), rng.normal(effect, differs, subjects)
            y = size[cells[:, 0]] + cells[:, 2] * gain[cells[:, 0]] + rng.normal(0, np.hypot(own, error), len(cells))
            labels = cells.T.astype(str)
            mixture = pool(y, np.full(len(y), error), labels[2], labels[0], labels[1]).difference("0", "1")
            low, high = mixture.quantile(0.05), mixture.quantile(0.95)
            held.append(low <= effect <= high)
            found.append(mixture.direction >= FOUND)
            width.append(high - low)
        numbers = f"{np.mean(held):.3f} | {np.mean(found):.3f} | {np.mean(width):.2f}"
        print(f"| {kind} | {subjects}, {sessions}, {trials}, effect {effect} | {differs} | {numbers} |")


def kill(times):
    """The command killed so many times, at places spread over its work, against one that was left alone."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        made, _ = simulate(7, 2, 1, 3, 30, 25.0)
        rows = ["recording,subject,session,condition,event_lift"]
        for trial in made:
            write_keypoint_csv(trial.recording, folder / f"{trial.name}.csv")
            values = trial.subject, trial.session, trial.factors["condition"], trial.events["lift"]
            rows.append(",".join(map(str, (f"{trial.name}.csv", *values))))
        (folder / "table.csv").write_text("\n".join(rows))

        def command(name):
            words = [folder / "table.csv", "--body", "paper_planar_arm", "--out", folder / name]
            words += ["--checkpoint", folder / f"{name}.kept", "--filters", 16]
            whole = [sys.executable, "-W", "ignore", "-m", "invdyn", "trials", *map(str, words)]
            return subprocess.Popen(whole, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)

        def parts():
            return sum(1 for _ in (folder / "killed.kept").rglob("manifest.json"))

        assert command("whole").wait() == 0
        killed, reached = 0, 0
        while killed < times:
            process = command("killed")
            while process.poll() is None and parts() <= reached:
                time.sleep(0.01)
            if process.poll() is not None:
                break
            os.kill(process.pid, signal.SIGKILL)
            process.wait()
            killed, reached = killed + 1, parts()
        assert command("killed").wait() == 0
        same = []
        for file in sorted((folder / "whole").rglob("*.*")):
            other = folder / "killed" / file.relative_to(folder / "whole")
            if file.suffix in (".csv", ".sto", ".nc"):
                same.append(file.read_bytes() == other.read_bytes())
        print("\n| killed and resumed | |\n|---|---|")
        print(f"| kills, parts kept at the last one | {killed}, {reached} |")
        print(f"| files with the same bytes | {sum(same)} of {len(same)} |")


def shown(done, total, what):
    if done == total or done % 20 == 0:
        print(what, done, total, f"{time.process_time():.0f} s", file=sys.stderr, flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parts = {
        "size": size,
        "coverage": lambda: coverage(options.studies, options.results),
        "pooling": lambda: pooling(400),
        "kill": lambda: kill(options.kills),
    }
    parser.add_argument("what", choices=parts, nargs="*", default=list(parts))
    parser.add_argument("--studies", type=int, default=100)
    parser.add_argument("--results", type=Path, default=Path("build/study.jsonl"), help="small studies that are done")
    parser.add_argument("--kills", type=int, default=10)
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    for what in options.what:
        parts[what]()


if __name__ == "__main__":
    main()
