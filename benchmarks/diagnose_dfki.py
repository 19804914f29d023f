"""What a real robot has and its rigid model lacks: DFKI's double pendulum, diagnosed, and tried on runs of its own.

The measured motor torque is the command, the encoders (every fifth row, 100 rows/s) what is seen, and the body the
rigid part of the lab's model_2.0: no friction, no rotors. The runs of `--fit` are diagnosed together, those of
`--held-out` show how far each effect closes the gap there, and what was found then predicts the torque of every one
of them, next to the lab's own identified friction and rotor inertia: all of it, those effects that certainly close
something of these runs (chosen by their predictions, not by the torque), and friction alone.

Torque that a model asks for along a measured motion, less the measured one, rms N·m:

    e = (D(θ) + joints' own inertias) (θ̈ − θ̈_model(θ, θ̇, u))

with θ, θ̇ and θ̈ from the encoders at 500 rows/s by a zero-phase Butterworth of order 4 and 5 Hz, as the torque; the
first and last 0.5 s are left out.

    INVDYN_DATA=… python benchmarks/diagnose_dfki.py [--fit 01 03] [--without load_friction] [--most 5] [--out DIR]
"""

import argparse
import time
from importlib.resources import files
from pathlib import Path

import numpy as np
import torch
from scipy.signal import butter, filtfilt
from sensor_cases import FRICTION, GEAR, ROTOR

from invdyn.diagnosis import diagnose, save
from invdyn.diagnosis.report.sentences import verdict
from invdyn.inference.posterior.initialise import arm_problem
from invdyn.models import ArmModel, Body
from invdyn.models.effects import EFFECTS
from invdyn.models.effects.hidden import HiddenHinge
from invdyn.recordings import Recording, Truth, load, load_truth

CUTOFF, EDGE = 5.0, 0.5  # Hz, s
EVERY = 5
BODY = files("invdyn.models") / "bodies" / "dfki_design_a0.toml"


def seen(run: str) -> Recording:
    """The run's encoders, every fifth row of them, under the measured torque of all rows."""
    truth = load_truth(f"dfki-trajectory-{run}")
    whole = load(f"dfki-trajectory-{run}")
    angles = np.full_like(truth.angle, np.nan)
    angles[::EVERY] = truth.angle[::EVERY]
    return Recording(
        truth.time,
        whole.keypoints,
        whole.keypoint_names,
        angles=angles,
        torques=truth.torque,
        joint_names=truth.joint_names,
        name=f"dfki-trajectory-{run}",
    )


def smooth(truth: Truth) -> tuple[np.ndarray, ...]:
    """Time, angle, velocity, acceleration and torque on 500 rows/s, low-passed by one filter."""
    fine = np.arange(truth.time[0], truth.time[-1], 0.002)
    at = truth.at(fine)
    b, a = butter(4, CUTOFF, fs=500.0)
    q, u = filtfilt(b, a, at.angle, axis=0), filtfilt(b, a, at.torque, axis=0)
    qd = np.gradient(q, 0.002, axis=0)
    inside = slice(round(EDGE * 500), -round(EDGE * 500))
    return tuple(x[inside] for x in (fine, q, qd, np.gradient(qd, 0.002, axis=0), u))


def model_error(model: ArmModel, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> np.ndarray:
    """e (T, K) of a model that is driven by the measured torque."""
    rows, body = torch.arange(len(q)), model.body_parameters()
    state = torch.as_tensor(np.concatenate([np.zeros_like(q), q, qd], -1))
    with torch.no_grad():
        missing = torch.as_tensor(qdd.copy()) - model.acceleration(state, rows, body)
        inertia = model.dynamics.inertia_matrix(torch.as_tensor(q.copy()), body)
        own = model.effects.inertia(model.parameters, q.shape[1])
    inertia = inertia if own is None else inertia + torch.diag_embed(own)
    return (inertia @ missing.unsqueeze(-1))[..., 0].numpy()


def published(qd: np.ndarray, qdd: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The torques (T, K) of the lab's own friction, and of its rotors."""
    viscous, coulomb = (np.array(FRICTION[k]) for k in ("viscous", "coulomb"))
    rotors = qdd @ (ROTOR * np.array([[GEAR**2 + 1, -GEAR], [-GEAR, GEAR**2]])).T
    return viscous * qd + coulomb * np.arctan(100 * qd), rotors


def rms(error: np.ndarray) -> list[float]:
    return np.sqrt((error**2).mean(0)).tolist()


def arm_on(times: np.ndarray, u: np.ndarray, body: Body, effects: list[dict]) -> ArmModel:
    """The body under torques (T, K) with effects of a diagnosis.json, but for those of the camera and hidden hinges.

    BristleFriction are bent all the way, as while a joint slides.
    """
    still = np.zeros((len(times), 2))
    rows = Recording(times, np.zeros((len(times), 0, 2)), (), angles=still, torques=u, joint_names=body.joint_names)
    model = arm_problem(rows, body, substeps=1).model
    values, parts = {}, []
    for each in effects:
        kind = EFFECTS[each["effect"]]
        if kind.side == "observation" or issubclass(kind, HiddenHinge):
            continue
        part = kind(*(each[k] for k in ("joint", "link", "partner", "stop", "form") if each.get(k)))
        means = {name: p["mean"] for name, p in each["parameters"].items() if not name.startswith("bristle_")}
        part = part.nonideal() if {"settling", "softness"} & means.keys() else part
        parts.append(part)
        if each["effect"] == "torque_ripple":  # as it is reported, A sin(Nθ + φ)
            size, phase = means.pop("amplitude"), means.pop("phase")
            means |= {"sine": size * np.cos(phase), "cosine": size * np.sin(phase)}
        values |= {f"effect.{part.key}.{name}": torch.tensor([mean]).double() for name, mean in means.items()}
    return model.with_effects(*parts).replace(**values)


def compare(effects: list[dict], sure: list[dict], runs: list[str]) -> None:
    """Print the rms of the torque that is missing along runs, with effects of a diagnosis.json and the lab's."""
    print("\nrms of the torque that is missing, N·m, shoulder / elbow")
    body = Body.from_toml(BODY)
    friction = [each for each in effects if "friction" in each["effect"]]
    for run in runs:
        times, q, qd, qdd, u = smooth(load_truth(f"dfki-trajectory-{run}"))
        rigid, found, borne_out, rubbed = (arm_on(times, u, body, some) for some in ([], effects, sure, friction))
        missing, (friction_torque, rotors) = model_error(rigid, q, qd, qdd), published(qd, qdd)
        errors = {
            "rigid": missing,
            "lab's friction": missing + friction_torque,
            "lab's friction and rotors": missing + friction_torque + rotors,
            "found": model_error(found, q, qd, qdd),
            "found, and borne out": model_error(borne_out, q, qd, qdd),
            "found, friction alone": model_error(rubbed, q, qd, qdd),
        }
        for name, error in errors.items():
            print(f"{run}  {name:<27} " + " / ".join(f"{v:.4f}" for v in rms(error)), flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--fit", nargs="+", default=["01", "03"])
    parser.add_argument("--held-out", nargs="+", default=["00", "02", "04", "05", "11", "12", "13"])
    parser.add_argument("--without", nargs="*", default=[], help="effects to strike from the catalogue")
    parser.add_argument("--most", type=int, default=5, help="effects at once, at most")
    parser.add_argument("--workers", type=int, default=1, help="processes side by side, with the same result")
    parser.add_argument("--out", type=Path, help="folder for the report")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    body, start = Body.from_toml(BODY), time.perf_counter()
    diagnosis = diagnose(
        [seen(run) for run in arguments.fit],
        body,
        held_out=[seen(run) for run in arguments.held_out],
        without=arguments.without,
        most=arguments.most,
        workers=arguments.workers,
    )
    if arguments.out:
        arguments.out.mkdir(parents=True, exist_ok=True)
        save(diagnosis, arguments.out)
    print(f"{verdict(diagnosis)}\n{time.perf_counter() - start:.0f} s")
    result = diagnosis.to_json()
    for cause in result["causes"][:3]:
        print(f"P {cause['probability']:.3f}, in part {cause['probability_in_part']:.3f}")
        for each in cause["effects"]:
            place = each.get("joint") or each.get("link") or ""
            numbers = ", ".join(
                f"{n} {p['mean']:.4g} ± {p['sd']:.2g} {p['unit']}" for n, p in each["parameters"].items()
            )
            print(f"  {each['effect']} {place}: {numbers}")
    best = max(diagnosis.causes, key=lambda cause: cause.probability + cause.in_part)
    effects = result["causes"][diagnosis.causes.index(best)]["effects"]
    print("share of the gap of the other runs that each effect of the likeliest cause closes, and the others leave")
    sure = []
    for finding, each in zip(best.effects, effects, strict=True):
        part = diagnosis.shrinkage.by_effect.get(finding.key)
        if part is None or part.interval_90 is None:
            print(f"  {finding.key:<28} unknown: nothing follows the runs without it")
            continue
        low, high = part.interval_90
        print(f"  {finding.key:<28} {part.gap_closed:+.4f} ({low:+.4f} to {high:+.4f})")
        sure += [each] if low > 0 else []
    compare(effects, sure, arguments.held_out)


if __name__ == "__main__":
    main()
