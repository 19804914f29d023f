"""Public files by address and hash: from the folder INVDYN_DATA when it is set, else downloaded and kept.

Each download comes from one commit of a public repository and must have the pinned SHA-256, so it can neither
change nor be swapped. Nothing here touches the network before `fetch` is called.
"""

import os
from dataclasses import dataclass
from pathlib import Path

from .errors import InputError, first_line

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
