"""BlazePose's weights: from the package that carries them into our cache, once, and from there ever after.

mediapipe 0.10.21 (Google, Apache-2.0) is the last whose wheel holds them. pip downloads that one wheel, with its
SHA-256 pinned, and installs nothing; of it two files are read, turned into plain arrays and kept as safetensors.
Their content is pinned, too, and hashed each time they are loaded: what was damaged or exchanged is fetched again.
"""

import hashlib
import json
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

import platformdirs
import torch

from ..atomic import atomic_path
from ..errors import InputError
from .graph import Graph, Step
from .heatmap import import_safetensors, read_safetensors
from .tflite_file import import_tflite, read_tflite

WHEEL = "mediapipe==0.10.21"
SHA256 = "05dc4a9e593655a79558d05d6227d31018c2537a4bd3362b51e230cf22aecfe3"
PLATFORM = (
    "--platform",
    "manylinux_2_28_x86_64",
    "--implementation",
    "cp",
    "--python-version",
    "311",
    "--abi",
    "cp311",
)
"""The one wheel that is pinned; nothing of it is run, so it serves every machine."""
CONTENT = {
    "detector": "7f5dab84322b4e6737accac9675b9bc63b65d99f60cdda3578231d6c7cb80e9e",
    "landmarks": "3d45bc83a3f56fd1417b70fe68c2cc1e3f80a21dc56bdc85bae8c06d7d773e74",
}
"""SHA-256 of what is kept, by :func:`content_digest`."""
MODULES = {"detector": "pose_detection/pose_detection", "landmarks": "pose_landmark/pose_landmark_full"}


def weights_file(which: str) -> Path:
    """Where the weights lie once they are there; `which` is a key of `MODULES`."""
    return Path(platformdirs.user_cache_dir("invdyn")) / "blazepose" / f"{which}_0.10.21.safetensors"


def load_graphs(progress: Callable[[int, int, str], None] | None = None) -> dict[str, Graph]:
    """The detector and the landmarks' network, downloaded where they are not kept, or not whole.

    Raises InputError when the download fails, or a package is missing.
    """
    import_safetensors()
    if not all(_is_kept(which) for which in MODULES):
        import_tflite()
        with tempfile.TemporaryDirectory() as folder:
            if progress is not None:
                progress(0, 1, "fetch BlazePose's weights, 36 MB, once")
            _convert(_download(Path(folder)))
            if progress is not None:
                progress(1, 1, "fetch BlazePose's weights, 36 MB, once")
    return {which: load_graph(weights_file(which)) for which in MODULES}


def content_digest(path: Path) -> str:
    """SHA-256 of what a file of tensors holds, however it is laid out. Raises as `read_safetensors`."""
    tensors, text = read_safetensors(path)
    hashed = hashlib.sha256(text.encode())
    for name in sorted(tensors):
        tensor = tensors[name].contiguous()
        hashed.update(f"{name} {tensor.dtype} {tuple(tensor.shape)}".encode())
        hashed.update(tensor.numpy().tobytes())
    return hashed.hexdigest()


def _is_kept(which: str) -> bool:
    path = weights_file(which)
    try:
        return path.exists() and content_digest(path) == CONTENT[which]
    except InputError:
        return False


def save_graph(content: bytes, path: Path) -> None:
    """Convert a TensorFlow Lite file. Raises as `read_tflite`; OSError when `path` cannot be written."""
    constants, steps, given, wanted = read_tflite(content)
    described = {"steps": [asdict(step) for step in steps], "given": given, "wanted": wanted}
    tensors = {name: torch.tensor(value) for name, value in constants.items()}
    path.parent.mkdir(parents=True, exist_ok=True)
    content = import_safetensors().save(tensors, {"invdyn": json.dumps(described)})
    with atomic_path(path) as temporary:
        temporary.write_bytes(content)


def load_graph(path: Path) -> Graph:
    """What `save_graph` wrote. Raises InputError for a damaged file, OSError for none."""
    tensors, text = read_safetensors(path)
    described = json.loads(text)
    return Graph(tensors, [Step(**step) for step in described["steps"]], described["given"], described["wanted"])


def _convert(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        for which, name in MODULES.items():
            save_graph(archive.read(f"mediapipe/modules/{name}.tflite"), weights_file(which))


def _download(folder: Path) -> Path:
    """The wheel, whose hash pip itself has checked."""
    (folder / "wanted.txt").write_text(f"{WHEEL} --hash=sha256:{SHA256}\n")
    command = [sys.executable, "-m", "pip", "download", "--quiet", "--disable-pip-version-check", "--no-deps"]
    command += ["--only-binary", ":all:", "--require-hashes", *PLATFORM]
    done = subprocess.run(
        [*command, "-r", str(folder / "wanted.txt"), "-d", str(folder)], capture_output=True, text=True, check=False
    )
    wheels = list(folder.glob("*.whl"))
    if done.returncode or not wheels:
        told = [line for line in done.stderr.splitlines() if line.strip()] or ["pip left no file"]
        raise InputError(
            f"BlazePose's weights could not be downloaded ({told[-1].strip()[:200]}): try again with a network, or "
            "train one of your own (invdyn train)"
        )
    return wheels[0]
