"""The labelling page's other half: a server for one browser on this machine, from the standard library.

It listens on 127.0.0.1 alone, and every path begins with a secret word, so that no other page and no other user can
read the film or write labels. (A user who may list this machine's processes sees the word in the command line of a
browser that is opened with it.) A request must name this server as its host and, where a page sends it, come from its
own page: a name that is rebound to 127.0.0.1 reaches nothing (DNS rebinding). Connections are few and end in time.
Each change is merged into the file of labels at once (:mod:`invdyn.recordings.tracking.shared_labels`).

    GET   /SECRET/           the page
          /SECRET/state      page number; numbers, names, size, suggested points; revision and changed points
          /SECRET/picture/I  picture I as JPEG
    POST  /SECRET/labels     {"since": revision, "changes": [[picture, keypoint, [u, v] or null, version], ...]}
                             -> {"revision": ..., "changed": [...], "refused": [...]}, as the file has them now
          /SECRET/left       page number: it was closed
          /SECRET/done       page number: its user is done -> {"open": other pages}; ends the server when no other page
                             is open, or when the same page says so again
"""

import hmac
import io
import json
import secrets
import socket
import sys
import threading
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from invdyn.recordings import InputError
from invdyn.recordings.tracking.labels import Labels
from invdyn.recordings.tracking.shared_labels import Change, SharedLabels

MAX_MESSAGE = 1 << 24
"""Bytes of a request's content."""
MAX_CONNECTIONS = 32
"""At once; a browser opens some six."""
MAX_IDLE_SECONDS, MAX_SECONDS = 10.0, 60.0
"""Seconds after which a connection ends that sends nothing, and one that sends slowly."""
HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": "default-src 'none'; img-src 'self'; style-src 'unsafe-inline'; "
    "script-src 'unsafe-inline'; connect-src 'self'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
}


class LabelServer(ThreadingHTTPServer):
    """Pictures out, labels in.

    Args:
        numbers, pictures: the N pictures to label, RGB (H, W, 3), and their numbers in the film.
        names: of the P keypoints.
        out: the file of labels; those that it has already are shown, and those of other pictures are kept.
        suggest: from a picture to (P, 3), points that its user may take, and a confidence that is not shown.

    Attributes:
        active: number of connections that are open.
        pages: numbers of the pages that are open.
        over: whether one page is done and no page is open.

    Raises InputError for a file that holds no labels, or those of other keypoints.
    """

    daemon_threads = True
    request_queue_size = MAX_CONNECTIONS

    def __init__(
        self,
        numbers: Sequence[int],
        pictures: Iterable[np.ndarray],
        names: Sequence[str],
        out: Path,
        suggest: Callable[[np.ndarray], np.ndarray] | None = None,
    ):
        self.secret = secrets.token_urlsafe(16)
        self.shared = SharedLabels(out, numbers, names)
        self.pictures: dict[str, bytes] = {}  # by their path
        self.suggested: list[list[list[float] | None]] = []
        for place, picture in enumerate(pictures):  # one at a time: a hundred of a large film would not fit into memory
            self.size = picture.shape[1::-1]
            self.pictures[f"picture/{place}"] = _encoded(picture)
            found = np.full((len(names), 3), np.nan) if suggest is None else suggest(picture)
            self.suggested.append([None if np.isnan(point).any() else point.tolist() for point in found[:, :2]])
        self.active, self._counting = 0, threading.Lock()
        self.pages: set[int] = set()  # that are open
        self._numbered, self._done, self.over = 0, False, False
        super().__init__(("127.0.0.1", 0), _Handler)

    @property
    def hosts(self) -> tuple[str, ...]:
        """Names of this server in a request."""
        return f"127.0.0.1:{self.server_port}", f"localhost:{self.server_port}"

    @property
    def address(self) -> str:
        """What to open in a browser."""
        return f"http://{self.hosts[0]}/{self.secret}/"

    @property
    def labels(self) -> Labels:
        """All that is labelled, with what was before."""
        return self.shared.labels

    def state(self) -> dict:
        """What a page begins with; it is open from here on."""
        with self._counting:
            self._numbered += 1
            self.pages.add(self._numbered)
            page = self._numbered
        return {
            "page": page,
            "numbers": self.shared.numbers,
            "names": self.shared.names,
            "size": self.size,
            "suggested": self.suggested,
            **self._since(0),
        }

    def take(self, content: object) -> dict[str, Any]:
        """Merge a request's changes into the file of labels; the answer to it.

        Raises InputError for a request of another form, and as :meth:`.SharedLabels.save`.
        """
        if not isinstance(content, dict) or content.keys() != {"since", "changes"}:
            raise InputError("expected an object with since and changes")
        since, changes = content["since"], content["changes"]
        if type(since) is not int or not isinstance(changes, list):
            raise InputError("expected a revision and a list of changes")
        refused = self.shared.save([self._change(each) for each in changes])
        return self._since(since) | {"refused": [_as_list(each) for each in refused]}

    def _since(self, revision: int) -> dict[str, Any]:
        """Points that were changed after a revision, and the revision that they lead to."""
        changed = self.shared.changed_since(revision)
        return {
            "revision": max([revision, *(each.version for each in changed)]),
            "changed": [_as_list(each) for each in changed],
        }

    def leave(self, page: object, done: bool) -> dict[str, int]:
        """A page was closed, or its user is done; the number of others that are open.

        Where one page is done, the server ends when no page is open, so that no labels of another page are missing. One
        that says done again is believed.
        """
        with self._counting:
            again = done and page not in self.pages
            self.pages.discard(page if type(page) is int else -1)
            self._done |= done
            self.over = self._done and (again or not self.pages)
            return {"open": 0 if self.over else len(self.pages)}

    def end(self) -> None:
        """Let `serve_forever` return, once this answer is out."""
        threading.Thread(target=self.shutdown).start()

    def process_request(self, request: Any, client_address: Any) -> None:
        """Serve a connection in a thread of its own; one too many is closed at once."""
        with self._counting:
            full = self.active >= MAX_CONNECTIONS
            self.active += not full
        if full:
            self.shutdown_request(request)
        else:
            super().process_request(request, client_address)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        """Serve it, for no longer than ``MAX_SECONDS``."""
        end = threading.Timer(MAX_SECONDS, _hang_up, [request])
        end.daemon = True
        end.start()
        try:
            super().process_request_thread(request, client_address)
        finally:
            end.cancel()
            with self._counting:
                self.active -= 1

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Say nothing of a client that left."""
        if not isinstance(sys.exception(), OSError):
            super().handle_error(request, client_address)

    def _change(self, content: object) -> Change:
        shapes = "expected changes [picture, keypoint, [u, v] or null, version]"
        if not isinstance(content, list) or len(content) != 4:
            raise InputError(shapes)
        picture, keypoint, point, version = content
        if not all(type(number) is int for number in (picture, keypoint, version)):
            raise InputError(shapes)
        if not (0 <= picture < len(self.shared.numbers) and 0 <= keypoint < len(self.shared.names)):
            raise InputError(f"expected a picture and keypoint of this page, got {picture} and {keypoint}")
        if point is None:
            return Change(picture, keypoint, None, version)
        if not (isinstance(point, list) and len(point) == 2 and all(type(x) in (int, float) for x in point)):
            raise InputError("expected a point of two numbers, [u, v] in px, or null")
        # A pixel reaches half a pixel around its centre, and (0, 0) is the first one's; NaN is within nothing.
        if not all(-0.5 <= x <= side - 0.5 for x, side in zip(point, self.size, strict=True)):
            raise InputError(f"expected a point within the picture of {self.size[0]} x {self.size[1]} px")
        return Change(picture, keypoint, (float(point[0]), float(point[1])), version)


class _Handler(BaseHTTPRequestHandler):
    server: LabelServer
    timeout = MAX_IDLE_SECONDS

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
        """Labels, or the end of a page."""
        path = self._path()
        if path not in ("labels", "done", "left"):
            return self._send(404, "text/plain", b"not here")
        try:
            content = self._content()
            said = json.loads(content or b"null")
            answer = self.server.take(said) if path == "labels" else self.server.leave(said, path == "done")
        except (InputError, ValueError, RecursionError, OSError) as error:
            return self._send(400, "text/plain; charset=utf-8", str(error).encode(errors="replace"))
        self._send(200, "application/json", json.dumps(answer).encode())
        if self.server.over:
            self.server.end()

    def log_message(self, *_: object) -> None:
        """Say nothing."""

    def _content(self) -> bytes:
        """What a request holds, as long as it says; raises InputError for another length."""
        length = self.headers.get("Content-Length", "")
        if not (length.isascii() and length.isdigit() and len(length) < 10 and int(length) <= MAX_MESSAGE):
            raise InputError(f"expected a content of at most {MAX_MESSAGE} bytes and its length")
        content = self.rfile.read(int(length))
        if len(content) < int(length):
            raise InputError("the content is shorter than its length")
        return content

    def _path(self) -> str | None:
        """The path behind the secret word; None without it, and for a request of another host or page.

        By the request's own words: `path` has leading slashes taken together.
        """
        hosts, origins = self.server.hosts, [f"http://{host}" for host in self.server.hosts]
        if self.headers.get_all("Host") not in [[host] for host in hosts]:
            return None
        if self.headers.get_all("Origin", [origins[0]]) not in [[origin] for origin in origins]:
            return None
        target, before = self.requestline.split()[1], f"/{self.server.secret}/"
        given = target[: len(before)].encode(errors="replace")
        return target[len(before) :] if hmac.compare_digest(given, before.encode()) else None

    def _send(self, status: int, kind: str, content: bytes) -> None:
        self.send_response(status)
        for name, value in (HEADERS | {"Content-Type": kind, "Content-Length": str(len(content))}).items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(content)


def _hang_up(connection: socket.socket) -> None:
    with suppress(OSError):  # it may be closed already
        connection.shutdown(socket.SHUT_RDWR)


def _as_list(change: Change) -> list:
    """A change as JSON has it."""
    return [change.picture, change.keypoint, change.point, change.version]


def _encoded(picture: np.ndarray) -> bytes:
    content = io.BytesIO()
    Image.fromarray(picture).save(content, "JPEG", quality=92)
    return content.getvalue()
