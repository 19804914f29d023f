"""Real recordings by name; catalogue.csv pins their files by commit and hash.

human-arm    DeepLabCut on a human arm seen from above, 30 frames/s: shoulder, elbow, wrist. No scale is
             known: it stays in pixels (`in_body_lengths` divides by the arm's length). Its publication shows
             frames 50–250.
dfki-…       a two-joint arm with encoders and motors, links .3 and .2 m (BSD-3-Clause)
  trajectory-NN    excitation, with commanded and measured torque
  20220812-HHMMSS  excitation on another day; the torque is the command, none was measured
  swing-up         the controlled swing-up, and film: its first 5 s at 30 frames/s, elbow and a disc as wrist
  static           nothing commanded: the noise of encoders and torque sensors
ibm-N        a passive toy double pendulum, 400 frames/s: its commanded torque is zero (CDLA-Sharing-1.0)

Files come from the folder INVDYN_DATA when it is set, else they are downloaded and kept. Each download comes from one
commit of a public repository and must have the pinned SHA-256, so it can neither change nor be swapped. Nothing here
touches the network before `fetch` is called.
"""

import csv
import difflib
import errno
import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from .errors import InputError, first_line
from .public_recordings import read_dfki, read_dfki_film, read_human_arm, read_ibm
from .recording import Recording
from .truth import Truth

VARIABLE = "INVDYN_DATA"


@dataclass(frozen=True)
class Source:
    """One file.

    Attributes:
        file: its place under INVDYN_DATA.
        repository: owner/name on GitHub, or "" for a file that is not published.
        commit, path: where it lies there.
        sha256: of the file as it is kept.
        rounded: the published table has 19 digits a number; it is kept, and hashed, with seven.
    """

    file: str
    repository: str = ""
    commit: str = ""
    path: str = ""
    sha256: str = ""
    rounded: bool = False

    @property
    def url(self) -> str:
        """Where it is published."""
        return f"https://raw.githubusercontent.com/{self.repository}/{self.commit}/{self.path}"


def fetch(source: Source) -> Path:
    """The file's place on this machine, downloading it at need.

    Raises InputError when INVDYN_DATA lacks it, it is not published, or its download fails or is another.
    """
    if folder := os.environ.get(VARIABLE):
        path = Path(folder).expanduser() / source.file
        if not path.is_file():
            raise InputError(f"{VARIABLE} is {folder}, but there is no file {source.file} in it")
        return path
    if not source.repository:
        raise InputError(f"{source.file} is not published: set {VARIABLE} to a folder that holds it")
    import pooch

    try:
        return Path(
            pooch.retrieve(
                source.url,
                known_hash=f"sha256:{source.sha256}",
                fname=Path(source.file).name,
                path=Path(pooch.os_cache("invdyn")) / Path(source.file).parent,
                downloader=_download_rounded if source.rounded else pooch.HTTPDownloader(timeout=30),
            )
        )
    except (OSError, ValueError) as error:  # no network, no such page; another hash
        raise InputError(
            f"could not download {source.url} ({first_line(error)}); try again, or set {VARIABLE} to a "
            f"folder that holds {source.file}"
        ) from None


def _download_rounded(url: str, output_file: str, retriever: object) -> None:
    """A downloader for pooch, which then checks the hash of what this leaves in `output_file`."""
    import pooch

    pooch.HTTPDownloader(timeout=30)(url, output_file, retriever)
    path = Path(output_file)
    path.write_text(round_table(path.read_text(encoding="utf-8")), encoding="utf-8", newline="\n")


def round_table(text: str) -> str:
    """Every number of a headed CSV with seven significant digits. Raises ValueError if one is none."""
    header, *rows = text.splitlines()
    rounded = (",".join(f"{float(cell):.7g}" for cell in row.split(",")) for row in rows)
    return "\n".join([header, *rounded]) + "\n"


@dataclass(frozen=True)
class Named:
    """An entry: its files, and the function that reads them."""

    sources: tuple[Source, ...]
    read: Callable[..., tuple[Recording, Truth | None]]


def names() -> tuple[str, ...]:
    """All names, in order."""
    return tuple(CATALOGUE)


def check_exists(path_or_name: str | Path) -> None:
    """Raise FileNotFoundError for what is no file, and no name of `names()`."""
    path, known = Path(path_or_name), names()
    if path.exists() or str(path_or_name) in known:
        return
    near = difflib.get_close_matches(str(path), known, 1, cutoff=0.7)
    hint = f", nor a recording of that name; did you mean {near[0]!r}?" if near else ""
    raise FileNotFoundError(errno.ENOENT, f"no such file{hint}", str(path))


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


def _load(name: str) -> tuple[Recording, Truth | None]:
    if name not in CATALOGUE:
        raise InputError(f"no recording is named {name!r}; known are {', '.join(CATALOGUE)}")
    recording, truth = CATALOGUE[name].read(*map(fetch, CATALOGUE[name].sources))
    return replace(recording, name=name), truth


def _read_catalogue() -> dict[str, Named]:
    """Entries of catalogue.csv, which has one row for each file."""
    readers = {each.__name__: each for each in (read_dfki, read_dfki_film, read_human_arm, read_ibm)}
    found: dict[str, Named] = {}
    with Path(__file__).with_name("catalogue.csv").open(encoding="utf-8", newline="") as file:
        for row in csv.DictReader(file):
            earlier = found[row["name"]].sources if row["name"] in found else ()
            place = row["file"], row["repository"], row["commit"], row["path"], row["sha256"]
            source = Source(*place, row["rounded"] == "yes")
            found[row["name"]] = Named((*earlier, source), readers[row["reader"]])
    return found


CATALOGUE = _read_catalogue()
