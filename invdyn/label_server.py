"""The labelling page's other half: a server for one browser on this machine, from the standard library.

It listens on 127.0.0.1 alone, and every path begins with a secret word, so that no other page and no other user can
read the film or write labels. (Who may list this machine's processes sees the word in the command line of a browser
that is opened with it.) Each change is written to the file of labels at once, whole.
"""

import io
import json
import secrets
import threading
from collections.abc import Callable, Iterable, Sequence
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from pathlib import Path

import numpy as np
from PIL import Image

from invdyn.recordings import InputError
from invdyn.recordings.tracking.labels import Labels, write_labels

LARGEST = 1 << 24  # bytes of a message
HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": "default-src 'none'; img-src 'self'; style-src 'unsafe-inline'; "
    "script-src 'unsafe-inline'; connect-src 'self'",
    "X-Content-Type-Options": "nosniff",
}


class LabelServer(ThreadingHTTPServer):
    """Pictures out, labels in.

    Args:
        numbers, pictures: the N pictures to label, RGB (H, W, 3), and their numbers in the film.
        names: of the P keypoints.
        out: the file of labels.
        before: labels that are there already; those of other pictures are kept.
        suggest: from a picture to (P, 3), points that its user may take, and a confidence that is not shown.
    """

    daemon_threads = True

    def __init__(
        self,
        numbers: Sequence[int],
        pictures: Iterable[np.ndarray],
        names: Sequence[str],
        out: Path,
        before: Labels | None = None,
        suggest: Callable[[np.ndarray], np.ndarray] | None = None,
    ):
        self.secret = secrets.token_urlsafe(16)
        self.numbers, self.names, self.out = list(numbers), tuple(names), out
        self.pictures: dict[str, bytes] = {}  # by their path
        self.suggested: list[list[list[float] | None]] = []
        for place, picture in enumerate(pictures):  # one at a time: a hundred of a large film would not fit into memory
            self.size = picture.shape[1::-1]
            self.pictures[f"picture/{place}"] = _encoded(picture)
            found = np.full((len(self.names), 3), np.nan) if suggest is None else suggest(picture)
            self.suggested.append(_or_null(found[:, :2]))
        self.before = before
        self.points = np.full((len(self.numbers), len(self.names), 2), np.nan)
        if before is not None:
            known = {int(frame): row for frame, row in zip(before.frames, before.only(self.names).points, strict=True)}
            for i, number in enumerate(self.numbers):
                self.points[i] = known.get(number, self.points[i])
        super().__init__(("127.0.0.1", 0), _Handler)

    @property
    def address(self) -> str:
        """What to open in a browser."""
        return f"http://127.0.0.1:{self.server_port}/{self.secret}/"

    @property
    def labels(self) -> Labels:
        """All that is labelled, with what was before."""
        done = np.isfinite(self.points).all(-1).any(-1)
        new = Labels(np.array(self.numbers)[done], self.points[done], self.names)
        if self.before is None:
            return new
        others = self.before.chosen(np.flatnonzero(~np.isin(self.before.frames, self.numbers))).only(self.names)
        return others.joined(new) if len(new) else others

    def state(self) -> dict:
        """What the page begins with."""
        points = [_or_null(row) for row in self.points]
        own = {"numbers": self.numbers, "names": self.names, "size": self.size}
        return own | {"points": points, "suggested": self.suggested}

    def take(self, content: object) -> None:
        """Check and write points [[[u, v] or null, …], …] of all pictures. Raises InputError for anything else."""
        points = np.full_like(self.points, np.nan)
        try:
            points[:] = [[[np.nan] * 2 if p is None else p for p in row] for row in list(content)]  # type: ignore[call-overload]
        except (TypeError, ValueError, IndexError, KeyError, OverflowError):
            raise InputError("expected a list of points for each picture") from None
        if (np.abs(points) > 1e5).any():
            raise InputError("a point lies beyond any picture")
        self.points = points
        write_labels(self.labels, self.out)

    def done(self) -> None:
        """Let `serve_forever` return, once this answer is out."""
        threading.Thread(target=self.shutdown).start()


class _Handler(BaseHTTPRequestHandler):
    server: LabelServer

    def do_GET(self) -> None:
        """Page, state, pictures."""
        path = self._path()
        if path == "":
            page = files("invdyn").joinpath("label_page.html").read_bytes()
            self._send(200, "text/html; charset=utf-8", page)
        elif path == "state":
            self._send(200, "application/json", json.dumps(self.server.state()).encode())
        elif path in self.server.pictures:
            self._send(200, "image/jpeg", self.server.pictures[path])
        else:
            self._send(404, "text/plain", b"not here")

    def do_POST(self) -> None:
        """Labels, or the end."""
        path = self._path()
        if path not in ("labels", "done"):
            return self._send(404, "text/plain", b"not here")
        try:
            length = int(self.headers.get("Content-Length") or 0)
            if not 0 <= length <= LARGEST:
                raise InputError("a message is too long")
            content = self.rfile.read(length)
            if path == "labels":
                self.server.take(json.loads(content))
        except (InputError, ValueError, RecursionError, OSError) as error:
            return self._send(400, "text/plain; charset=utf-8", str(error).encode())
        self._send(200, "text/plain", b"written")
        if path == "done":
            self.server.done()

    def log_message(self, *_: object) -> None:
        """Say nothing."""

    def _path(self) -> str | None:
        """The path behind the secret word, or None without it."""
        before = f"/{self.server.secret}/"
        return self.path.removeprefix(before) if self.path.startswith(before) else None

    def _send(self, status: int, kind: str, content: bytes) -> None:
        self.send_response(status)
        for name, value in (HEADERS | {"Content-Type": kind, "Content-Length": str(len(content))}).items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(content)


def _or_null(points: np.ndarray) -> list[list[float] | None]:
    """Points (P, 2) as JSON has them."""
    return [None if np.isnan(point).any() else point.tolist() for point in points]


def _encoded(picture: np.ndarray) -> bytes:
    content = io.BytesIO()
    Image.fromarray(picture).save(content, "JPEG", quality=92)
    return content.getvalue()
