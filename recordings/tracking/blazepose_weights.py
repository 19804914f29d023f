"""BlazePose's two networks: their files fetched once into the user's cache, and run by LiteRT (extra `tracking`).

mediapipe 0.10.21 (Google, Apache-2.0) is the last release whose wheel contains them. pip downloads that one wheel,
whose SHA-256 is pinned, and installs nothing; two TensorFlow Lite files of it are kept as they are. Their SHA-256 is
pinned as well and checked at each load: a damaged or exchanged file is fetched again.
"""

import hashlib
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import platformdirs
import torch

from ..atomic import atomic_path
from ..errors import InputError

WHEEL = "mediapipe==0.10.21"
SHA256 = "05dc4a9e593655a79558d05d6227d31018c2537a4bd3362b51e230cf22aecfe3"
PLATFORM = (
    *("--platform", "manylinux_2_28_x86_64"),
    *("--implementation", "cp"),
    *("--python-version", "311"),
    *("--abi", "cp311"),
)
"""Of the pinned wheel. Nothing of it is executed, so it serves every machine."""
FILES = {"detector": "pose_detection/pose_detection", "landmarks": "pose_landmark/pose_landmark_full"}
"""Within the wheel's folder `mediapipe/modules`, without their suffix."""
CONTENT = {
    "detector": "9ba9dd3d42efaaba86b4ff0122b06f29c4122e756b329d89dca1e297fd8f866c",
    "landmarks": "e9a5c5cb17f736fafd4c2ec1da3b3d331d6edbe8a0d32395855aeb2cdfd64b9f",
}
"""SHA-256 of the two files."""

Network = Callable[[np.ndarray], list[np.ndarray]]
"""From one picture (1, H, W, 3) float32 to the network's outputs."""


def weights_file(which: str) -> Path:
    """Path of a network's file in the cache; `which` is a key of `FILES`."""
    return Path(platformdirs.user_cache_dir("invdyn")) / "blazepose" / f"{which}_0.10.21.tflite"


def load_networks(progress: Callable[[int, int, str], None] | None = None) -> dict[str, Network]:
    """The detector's and the landmarks' network, downloaded where the cache has none or a damaged one.

    Raises InputError when the download fails, or LiteRT is not installed.
    """
    import_litert()
    contents = {which: _read(which) for which in FILES}
    if None in contents.values():
        what = "fetch BlazePose's weights, 36 MB, once"
        if progress is not None:
            progress(0, 1, what)
        with tempfile.TemporaryDirectory() as folder:
            contents |= _unpack(download_wheel(Path(folder)))
        if progress is not None:
            progress(1, 1, what)
    return {which: run_by_litert(content) for which, content in contents.items() if content is not None}


def run_by_litert(content: bytes) -> Network:
    """A network from a TensorFlow Lite file's bytes. Raises InputError when LiteRT is not installed."""
    interpreter = import_litert()(model_content=content, num_threads=torch.get_num_threads())
    interpreter.allocate_tensors()
    given = interpreter.get_input_details()[0]["index"]
    wanted = [each["index"] for each in interpreter.get_output_details()]

    def network(picture: np.ndarray) -> list[np.ndarray]:
        interpreter.set_tensor(given, picture)
        interpreter.invoke()
        return [interpreter.get_tensor(index) for index in wanted]

    return network


def import_litert() -> Callable:
    """LiteRT's interpreter. Raises InputError when it is not installed."""
    try:
        from ai_edge_litert.interpreter import Interpreter
    except ImportError:
        raise InputError(
            "tracking a person needs one more package: pip install 'invdyn[tracking]' (LiteRT has wheels for Linux, "
            "Windows on x86-64 and macOS on ARM)"
        ) from None
    return Interpreter


def _read(which: str) -> bytes | None:
    """A network's file in the cache; None where it is missing or not the pinned one."""
    try:
        content = weights_file(which).read_bytes()
    except OSError:
        return None
    return content if hashlib.sha256(content).hexdigest() == CONTENT[which] else None


def _unpack(wheel: Path) -> dict[str, bytes]:
    """The networks' files out of the wheel, which are kept in the cache."""
    with zipfile.ZipFile(wheel) as archive:
        contents = {which: archive.read(f"mediapipe/modules/{name}.tflite") for which, name in FILES.items()}
    for which, content in contents.items():
        weights_file(which).parent.mkdir(parents=True, exist_ok=True)
        with atomic_path(weights_file(which)) as temporary:
            temporary.write_bytes(content)
    return contents


def download_wheel(folder: Path) -> Path:
    """The wheel, whose hash pip itself has checked. Raises InputError when pip fails."""
    requirement = folder / "requirement.txt"
    requirement.write_text(f"{WHEEL} --hash=sha256:{SHA256}\n")
    command = [sys.executable, "-m", "pip", "download", "--quiet", "--disable-pip-version-check", "--no-deps"]
    command += ["--only-binary", ":all:", "--require-hashes", *PLATFORM, "-r", str(requirement), "-d", str(folder)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    wheels = list(folder.glob("*.whl"))
    if done.returncode or not wheels:
        lines = [line for line in done.stderr.splitlines() if line.strip()] or ["pip left no file"]
        raise InputError(
            f"BlazePose's weights could not be downloaded ({lines[-1].strip()[:200]}): try again with a network, or "
            "train one of your own (invdyn train)"
        )
    return wheels[0]
