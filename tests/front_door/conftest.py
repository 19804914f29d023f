"""A posterior of the documented layout, made without inference, and a folder to call commands in."""

import signal
import subprocess

import arviz as az
import numpy as np
import pytest
import xarray as xr
from typer.testing import CliRunner

import invdyn.inference
from invdyn.cli import app

JOINTS = ("shoulder", "elbow", "wrist", "knuckle", "middle_joint", "end_joint")
TIPS = ("elbow", "wrist", "knuckle", "middle_joint", "end_joint", "fingertip")
UNITS = {"torque": "N·m", "angle": "rad", "velocity": "rad/s", "position": "m"}


def tips(angle):
    """Tips (..., K, 2) of a chain of unit links from its Denavit–Hartenberg angles (..., K)."""
    direction = np.cumsum(angle, axis=-1)
    return np.cumsum(np.stack([np.cos(direction), np.sin(direction)], axis=-1), axis=-2)


def smooth(rng, shape, length):
    """Smooth unit-scale curves along axis -2: white noise under a Gaussian window."""
    window = np.exp(-0.5 * np.linspace(-3, 3, 6 * length) ** 2)
    noise = rng.standard_normal((*shape[:-2], shape[-2] + window.size - 1, shape[-1]))
    return np.apply_along_axis(np.convolve, -2, noise, window / np.linalg.norm(window), "valid")


@pytest.fixture(scope="session")
def make_posterior():
    """Function (num_joints, num_frames, …) -> InferenceData; the truth lies inside the draws' own range."""

    def make(num_joints=2, num_frames=60, num_filters=5, num_draws=4, *, truth=True, angles=False,
             missing=True, frame_interval=0.03, noise=0.1, seed=0):  # fmt: skip
        rng = np.random.default_rng(seed)
        joints, keypoints = list(JOINTS[:num_joints]), list(TIPS[:num_joints])
        time = frame_interval * np.arange(num_frames)
        draws = (num_filters, num_draws, num_frames, num_joints)
        true = {
            "torque": 3 * smooth(rng, draws[2:], 4),
            "angle": 0.7 * smooth(rng, draws[2:], 8) - np.pi / 2 * (np.arange(num_joints) == 0),
        }
        true["velocity"] = np.gradient(true["angle"], frame_interval, axis=0)
        scatter = {"torque": 0.6, "angle": 0.05, "velocity": 0.3}
        bias = {name: scatter[name] * smooth(rng, draws[2:], 3) for name in scatter}
        posterior = {name: true[name] + bias[name] + scatter[name] * smooth(rng, draws, 3) for name in scatter}
        posterior["position"] = tips(posterior["angle"])
        observed = tips(true["angle"]) + noise * rng.standard_normal((num_frames, num_joints, 2))
        if missing:
            observed[num_frames // 3 : num_frames // 2, -1] = np.nan
        predictive = posterior["position"] + noise * rng.standard_normal(posterior["position"].shape)
        log_weight = rng.normal(0, 0.3, num_filters)
        log_weight -= np.log(np.exp(log_weight).sum())
        ess = 20 + 80 * rng.random((num_filters, num_frames))
        coords = {"time": time, "joint": joints, "keypoint": keypoints, "space": ["x", "y"]}
        coords["link"] = [f"link_{number}" for number in range(num_joints)]
        coords |= {"filter": np.arange(num_filters), "chain": np.arange(num_filters), "draw": np.arange(num_draws)}
        dims = {"torque": ("joint",), "angle": ("joint",), "velocity": ("joint",)}
        dims["position"] = ("keypoint", "space")

        def group(variables, units=UNITS):
            """Dataset of name -> (dims, values), with units and only the coordinates in use."""
            used = {dim for of, _ in variables.values() for dim in of}
            dataset = xr.Dataset(variables, {name: coords[name] for name in coords if name in used})
            for name in dataset.data_vars:
                dataset[name].attrs["units"] = units.get(name.removeprefix("truth_"), "1")
            if "time" in dataset.coords:
                dataset["time"].attrs["units"] = "s"
            return dataset

        constant = {"length": (("link",), np.ones(num_joints)), "mass": (("link",), np.ones(num_joints))}
        if truth:
            constant |= {f"truth_{name}": (("time", "joint"), value) for name, value in true.items()}
        data = {"position": (("time", "keypoint", "space"), observed)}
        if angles:
            data["angle"] = (("time", "joint"), true["angle"])
        per_frame = ("filter", "time")
        idata = az.InferenceData(
            posterior=group({n: (("chain", "draw", "time", *dims[n]), v) for n, v in posterior.items()}),
            posterior_predictive=group({"position": (("chain", "draw", "time", "keypoint", "space"), predictive)}),
            sample_stats=group(
                {
                    "log_weight": (("filter",), log_weight),
                    "log_evidence": (("filter",), log_weight - 100),
                    "log_evidence_increment": (per_frame, rng.normal(-1, 0.3, ess.shape)),
                    "ess": (per_frame, ess),
                    "resampled": (per_frame, ess < 30),
                }
            ),
            observed_data=group(data),
            constant_data=group(constant),
        )
        idata.attrs |= {
            "method": "smc",
            "seed": seed,
            "outer_ess": float(1 / np.exp(2 * log_weight).sum()),
            "log_evidence": -100.0,
            "invdyn_version": "0.1.0",
            "length_unit": "m",
            "draws": "equally weighted",
            "settings": '{"num_particles": 100}',
        }
        return idata

    return make


BODY = """
name = "arm"
[[links]]
name = "upper_arm"
joint = "shoulder"
tip = "elbow"
length = 1.0
mass = 0.5
[[links]]
name = "forearm"
joint = "elbow"
tip = "wrist"
length = 1.0
mass = 0.3
"""
HEADER = "time,elbow_x,elbow_y,wrist_x,wrist_y\n"
ROWS = [f"{0.03 * frame:.2f},1.0,{0.01 * frame},2.0,{0.01 * frame}\n" for frame in range(12)]


@pytest.fixture(scope="session")
def run():
    """Function of a command line -> its outcome: exit_code, stdout, stderr."""

    def run(*arguments):
        return CliRunner().invoke(app, [str(argument) for argument in arguments], prog_name="invdyn")

    return run


@pytest.fixture
def started():
    """Function of a command -> its process; it hears Ctrl-C, and what is left of it after the test is killed."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # a job in the background may ignore it
    processes = []

    def started(*command, **options):
        process = subprocess.Popen([str(word) for word in command], text=True, **options)
        processes.append(process)
        return process

    yield started
    signal.signal(signal.SIGINT, before)
    for process in processes:
        with process:
            process.kill()


@pytest.fixture(scope="session")
def contents():
    """Function of a folder -> its files, name -> bytes."""

    def contents(folder):
        return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}

    return contents


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Working directory with an arm and a recording of it."""
    (tmp_path / "arm.toml").write_text(BODY)
    (tmp_path / "rec.csv").write_text(HEADER + "".join(ROWS))
    (tmp_path / "hand.csv").write_text("time,shoulder_torque,shoulder_angle,shoulder_velocity\n0,1,2,3\n1,1,2,3\n")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def quick_inference(make_posterior, monkeypatch):
    """Instead of an inference, its posterior at once; a list of what it was called with."""
    calls = []

    def infer(recording, body, *, truth=None, progress=None, **options):
        calls.append({"recording": recording, "body": body, "truth": truth, **options})
        for done in range(1, 4):
            progress(done, 3, "filter")
        return make_posterior(body.num_joints, recording.num_frames, truth=truth is not None)

    monkeypatch.setattr(invdyn.inference, "infer", infer)
    return calls
