"""Real recordings by name: what each is, and the commit and hash that pin its files.

human-arm    DeepLabCut on a human arm seen from above, 30 frames/s: shoulder, elbow, wrist. No scale is
             known: it stays in pixels (`in_body_lengths` divides by the arm's length). Its publication shows
             frames 50–250.
dfki-…       a two-joint arm with encoders and motors, links .3 and .2 m (BSD-3-Clause)
  trajectory-NN    excitation, with commanded and measured torque
  20220812-HHMMSS  excitation on another day; the torque is the command, none was measured
  swing-up         the controlled swing-up, and film: its first 5 s at 30 frames/s, elbow and a disc as wrist
  static           nothing commanded: the noise of encoders and torque sensors
ibm-N        a passive toy double pendulum, 400 frames/s: its commanded torque is zero (CDLA-Sharing-1.0)
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

from .errors import InputError
from .public_recordings import read_dfki, read_dfki_film, read_human_arm, read_ibm
from .recording import Recording
from .sources import Source, fetch
from .truth import Truth


@dataclass(frozen=True)
class Named:
    """An entry: its files, the function that reads them, and the frames of a published demonstration."""

    sources: tuple[Source, ...]
    read: Callable[..., tuple[Recording, Truth | None]]
    demo_frames: tuple[int, int] | None = None


def names() -> tuple[str, ...]:
    """All names, in order."""
    return tuple(CATALOGUE)


def demo_frames(name: str) -> slice:
    """The frames of a published demonstration, or all. Raises InputError for an unknown name."""
    return slice(*(_entry(name).demo_frames or (None, None)))


def load_named(name: str) -> Recording:
    """The recording of that name: m (human-arm: px, y up), s, rad, N·m.

    Raises InputError for an unknown name, or when its files cannot be had.
    """
    return _load(name)[0]


def load_truth(name: str) -> Truth:
    """Measured angles, velocities and motor torques of a robot's recording, at the recording's times.

    The torque is NaN where none was measured. Raises InputError for a recording without encoders.
    """
    truth = _load(name)[1]
    if truth is None:
        raise InputError(f"{name} carries no measured truth; the recordings named dfki-… do")
    return truth


def _entry(name: str) -> Named:
    if name not in CATALOGUE:
        raise InputError(f"no recording is named {name!r}; known are {', '.join(CATALOGUE)}")
    return CATALOGUE[name]


def _load(name: str) -> tuple[Recording, Truth | None]:
    entry = _entry(name)
    recording, truth = entry.read(*(fetch(source) for source in entry.sources))
    return replace(recording, name=name), truth


def _dfki(file: str, commit: str, path: str, sha256: str) -> Named:
    repository = "dfki-ric-underactuated-lab/double_pendulum"
    source = Source(f"dfki_double_pendulum/{file}", repository, commit, f"data/{path}", sha256, rounded=True)
    return Named((source,), read_dfki)


def _dfki_entries() -> dict[str, Named]:
    entries = {}
    for number, (day, sha256) in _TRAJECTORIES.items():
        file = f"trajectory_{number}.csv"
        entries[f"dfki-trajectory-{number}"] = _dfki(f"sys_id/design_A.0/{file}", *day(file), sha256)
    for time, (commit, sha256) in _RUNS.items():
        file = f"20220812-{time}-PM_measured.csv"
        path = f"system_identification/recorded_data_20220812/sys_id/{file}"
        entries[f"dfki-20220812-{time}"] = _dfki(f"sys_id/design_A.0_20220812/sys_id_{file}", commit, path, sha256)
    entries["dfki-20220812-063536"] = _dfki(  # this one with the controller's friction compensation
        "sys_id/design_A.0_20220812/sys_id_friccomp_20220812-063536-PM_measured.csv",
        _MOVED,
        "experiment_records/design_A.0/20220812/sys_id_friccomp/20220812-063536-PM_measured.csv",
        "613b71007a19f71a6817516b6f2d45413cc7d5cde2e748e5bb5bd703f23ad142",
    )
    entries["dfki-static"] = _dfki(
        "noise/design_A.0_static.csv",
        _MOVED,
        "experiment_records/design_A.0/20220815/noise/velocity_measurement/trajectory.csv",
        "d546df45527f2e3c9fd748492fb34f1e33bcb70eb8dd180c5fa1cfa38ba0b4f1",
    )
    entries["dfki-swing-up"] = _dfki(
        "controlled/pendubot_designA0_175617-pendubot_tvlqr_lqr_VIDEO.csv",
        _MOVED,
        "experiment_records/design_A.0/20220819/175617-pendubot_tvlqr_lqr_VIDEO/trajectory.csv",
        "8d6ed56ca7d7011fb24b43198487cd1925c3767b38c999a8205d7c23386960e3",
    )
    film = ("tracked_and_synced.csv", "calibration.json")  # the tracks were made from the film, not published
    entries["dfki-film"] = Named(tuple(Source(f"dfki_double_pendulum/video/{file}") for file in film), read_dfki_film)
    return entries


def _ibm(number: int, commit: str, sha256: str) -> Named:
    path = f"data/ibm-double-pendulum/original/dpc_dataset_csv/{number}.csv"
    repository = "erwincoumans/tiny-differentiable-simulator"
    return Named((Source(f"ibm_double_pendulum/{number}.csv", repository, commit, path, sha256),), read_ibm)


_MOVED = "e84ed2403b2d3971bbedd67a54c07551ddebdd60"  # that repository moved its recordings with this commit
_DAY, _DAY_LATER = "cb582330a2dc988610931bc302dcd89cf039ce63", "7a8e4ea4643b9f118542b6ca780381669638d46f"


def _before(file: str) -> tuple[str, str]:
    commit = "0939d2dc1d752d4d1119332504ec0177726648e3"
    return commit, f"system_identification/recorded_data_20220815/sys_id/{file}"


def _after(file: str) -> tuple[str, str]:
    return _MOVED, f"experiment_records/design_A.0/20220815/sys_id/{file}"


_TRAJECTORIES = {
    "00": (_before, "c7ee5e6bcf589e45a3231d2384e55f20f5c78af26008120df6f391fd24ea5c2c"),
    "01": (_before, "3cf21b8d2f32f92a12789b2a9b09f7b1636b3f6aecf70a1e4369098903c40865"),
    "02": (_before, "a4c72c96b0d6d8307bc2eac406911b2888a8d2c767f697d876ec54a43396bfca"),
    "03": (_after, "ae9ac65b3647be4f5c6cceb49c756b1c89f5a082d04e9687f4e8c137c27aad46"),
    "04": (_before, "bc1fa7c382a617e44d2c0184c1ab460df071e647a21915bcaedf84a342f0fda0"),
    "05": (_after, "3a2429c56655de11b642803d684d5f02d46f27381cb69bf27f8a65e13ec7b7b3"),
    "11": (_before, "cc1fd97d2004681c3f6517a27ffcb2e5f344f9e7eb7c8eda2cd3e5f402d98a74"),
    "12": (_after, "87893b247d60815968688bdab64d5d3e606d98323cd2afbec35cce8a21a85f18"),
    "13": (_after, "1274379ed145a37a300b7c5b6afca23336afafbbe2ccb0f98761e3e8a8525daf"),
}
_RUNS = {
    "055032": (_DAY, "a28d8b2fb48b9554579be91f0f6ba099619c89e11fbbd04fcef43461cfb6b679"),
    "055640": (_DAY, "aca483f0e105c85d4a4692facdd34ff215ac918e1bb7065a4d94db22fc495143"),
    "055903": (_DAY_LATER, "647b55fa1b8611c42b3b5973eeee82e4c43f9c56de4527c76ccfad78e9d1e7c2"),
    "060143": (_DAY, "86f886823df65535fd5f1c2f84dead39acd1d9c7e267d4c9221915e14525cf2a"),
    "060245": (_DAY_LATER, "3b9a4e0482419db9e74e4d1ef85325e5142e141acdbbb030a39af7092a33a711"),
    "060329": (_DAY_LATER, "064e12831ac1157b9eeecd90fef2fdfd46e6c2d187ce18f3de9225eee501555c"),
    "060440": (_DAY, "51efc439bb9c9e181929d696c442052cf48cee58de41d1c9a96373e667b5075a"),
    "061157": (_DAY, "2bd0830ed28cde2f9709da4b3e497e8257960e4912d6a7cb229b2fbcaeca773c"),
    "061705": (_DAY, "7dab9e48421a73a383f6fda35e39682f623898a24e2db68883a57896be548f1e"),
}
_IBM_A = "c815623770e60d6294e61270a6f8fb1fa41ca613"
_IBM_B = "56e4e686cefc854828260448691845de9e626919"
_IBM_C = "8adb7086cac68e598005d5309c28aab33217f512"
_IBM_D = "2202b51fdf36cfa17c2f0d6ad9172ecf6c40e773"
_IBM_E = "abf37b0fc24f0556de99720eff0cf9a1ebf22fd9"
_IBM = (  # commit and hash of recordings 0 … 9
    (_IBM_A, "0c02780291f4d19c1e92ad45c0f8e958ae15413def5834b98dd4c6935ad3adbd"),
    (_IBM_A, "11bc145e34c0745a71881ec48089cda43da2171ee3e4081ba24d335acbfa1f2e"),
    (_IBM_B, "94d326951762fd133a549a4c8b2de81c97d330e6dbe997407b8b367d7a73c3bd"),
    (_IBM_C, "3d8e91f8e52cee26de41ae32081aabd9e2463ad423a59e9714d78bb402f48547"),
    (_IBM_C, "8c20addd10d5ab78df894927ec4ae1a278eaf56d96b1ed3ed49dcbea076217ae"),
    (_IBM_D, "dbd310a7e512d46b7e9e0d16b932d965746ef46685055fb5031f6ecfa094c465"),
    (_IBM_A, "79e0a9b415fa6e4e59ce016f2f6fcee759a9a9491d58ffde6e73303eab3f506e"),
    (_IBM_C, "c16496123e485c4d29d8c62a761e7d889d89a38acb638ee43f087e6ff300df3e"),
    (_IBM_B, "2ef747e2ba1cf8f31af766a3905632e6efd0e65dd95aca08fdfb546ce8ce38d0"),
    (_IBM_E, "a32078daa3b914f510dfd5645ad7ca655ac4a736f2423a41606e6030e623427b"),
)

_HUMAN_ARM = "IMG_4103DLC_resnet50_HumanArmAug12shuffle1_199999filtered.csv"

CATALOGUE: dict[str, Named] = {
    "human-arm": Named(
        (
            Source(
                f"human_arm/{_HUMAN_ARM}",
                "danbider/aesmc",
                "5c95d0570a7f5a724d77c28239cc0b1d6431b371",
                f"test/datasets/{_HUMAN_ARM}",
                "9b3fa327640ea8e1efb2ae7e805a63c4464ccd89ac2706d073b9c8c955b7632f",
            ),
        ),
        read_human_arm,
        demo_frames=(50, 250),
    ),
    **_dfki_entries(),
    **{f"ibm-{number}": _ibm(number, *pins) for number, pins in enumerate(_IBM)},
}
