"""A blind run from end to end: make cases, seal the answers, diagnose apart, open, score.

    OUT/sealed.json          hash of the answers, before anything is diagnosed
    OUT/cases/case-0000/     what the method gets (see `cases`)
    OUT/.locked/case-0000    its answer, which only the seed opens
    OUT/diagnoses/case-0000/ what it says: diagnosis.json, or failed.txt; took.json
    OUT/answers.json         opened: answers, nonce and their hash
    OUT/scores.json          the score, with the hash of all diagnoses as they were before
    OUT/blind.html           the same as a page

Continues where an earlier run of the same call stopped: cases follow from the seed, and so does the nonce, so that the
hash is the same; cases and diagnoses that are there are not made again. The seed is on no disk before the answers are
open.
"""

import hashlib
import json
import multiprocessing
import shlex
import shutil
import signal
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor, as_completed
from contextlib import ExitStack
from importlib import import_module
from pathlib import Path

from invdyn.blindcheck.answer_schema import unreadable
from invdyn.blindcheck.cases import make_case, planned
from invdyn.blindcheck.commitment import Locked, Sealed, digest, read_commitment
from invdyn.blindcheck.confined import Confined
from invdyn.blindcheck.engine import ENGINES, MUJOCO
from invdyn.blindcheck.methods import Ours, Theirs
from invdyn.blindcheck.page import write_page
from invdyn.blindcheck.score import Scores, score
from invdyn.recordings import InputError, resolved, write_text

Progress = Callable[[int, int, str], None]
OPENED = ("answers.json", "scores.json", "blind.html")
"""What tells answers."""
OPEN = Confined()
FOLDERS = ("cases", "diagnoses", "oracle", ".making", ".locked")


def nonce_of(seed: int) -> bytes:
    """32 bytes that follow from the seed and take long to try: a resumed run seals with the same."""
    return hashlib.pbkdf2_hmac("sha256", str(seed).encode(), b"invdyn blind", 200_000)


class BlindRun:
    """One run in a folder; the steps are `check`, `make`, `diagnose`, `score`, in this order.

    Args:
        folder: made when missing.
        counts: cases of each kind.
        seed: the cases follow from it.
        workers: processes.
        command: of another method, or None for ours.
        confined: how that method is kept from the seed and from the other cases.
        engine: that simulates reality, a name of `engine.ENGINES`.
    """

    def __init__(
        self,
        folder: str | Path,
        counts: Mapping[str, int],
        seed: int,
        workers: int = 1,
        command: str | None = None,
        confined: Confined = OPEN,
        engine: str = MUJOCO.name,
    ):
        self.folder, self.counts, self.seed = Path(folder), dict(counts), seed
        self.workers, self.command, self.confined = workers, command, confined
        self.engine = engine
        self._sealed: Sealed | None = None

    def check(self) -> None:
        """Raise InputError or OSError for what would fail only after a long time."""
        if self.engine not in ENGINES:
            raise InputError(f"--engine: expected one of {', '.join(ENGINES)}, got {self.engine!r}")
        try:
            import_module(ENGINES[self.engine].module)
        except ImportError:
            raise InputError(f"the blind check needs {self.engine}: pip install 'invdyn[robots]'") from None
        if self.command is not None:
            try:
                words = shlex.split(self.command)
            except ValueError as error:
                raise InputError(
                    f"--method-command: expected words as in a shell, got {self.command!r}: {error}"
                ) from None
            if not words or not any("{out}" in word for word in words):
                raise InputError(f"--method-command: expected a command with {{out}} in it, got {self.command!r}")
            if shutil.which(words[0]) is None:
                raise InputError(f"--method-command: no program {words[0]!r} that can be run")
        resolved(self.folder)
        if self.folder.exists() and not self.folder.is_dir():
            raise InputError(f"{self.folder}: expected a folder, this is a file")
        known = {"sealed.json", *FOLDERS, *OPENED}
        strange = sorted(p.name for p in self.folder.iterdir() if p.name not in known) if self.folder.exists() else []
        if strange:
            raise InputError(f"{self.folder}: expected an empty folder or an earlier run, has {strange[0]}")
        for name in FOLDERS:
            if (self.folder / name).exists() and not (self.folder / name).is_dir():
                raise InputError(f"{self.folder / name}: expected a folder of an earlier run, this is a file")
        sealed = self.folder / "sealed.json"
        if sealed.exists():
            read_commitment(sealed)
            if not (self.folder / "cases").exists():
                raise InputError(f"{sealed}: seals other cases, which are missing here; give --out another folder")
        new = not self.folder.exists()
        self.folder.mkdir(parents=True, exist_ok=True)
        try:
            self.confined.check(self.folder)
        except InputError:
            if new:
                self.folder.rmdir()
            raise

    def make(self, progress: Progress | None = None) -> str:
        """Make the cases, seal the answers, and return the hash. Raises InputError over a run of another kind."""
        making, cases, sealed = (self.folder / name for name in (".making", "cases", "sealed.json"))
        nonce = nonce_of(self.seed)
        locked = Locked(self.folder / ".locked", nonce)
        jobs = {name: job for name, *job in planned(self.counts, self.seed, self.engine)}
        answers = {}
        for path in (path for folder in (making, cases) if folder.exists() for path in sorted(folder.iterdir())):
            answer = locked.get(path.name, _label(jobs.get(path.name), path, self.engine))
            if answer is not None:
                answers[path.name] = answer
            elif path.parent == making:
                shutil.rmtree(path)
        if cases.exists() and answers.keys() != jobs.keys():
            raise InputError(
                f"{self.folder}: holds a run of other cases, or of another engine, or lacks .locked; "
                "give --out another folder"
            )
        todo = {name: (str(making / name), *job, self.engine) for name, job in jobs.items() if name not in answers}
        for name, answer in _each(_make, todo, self.workers, progress, "cases made"):
            locked.put(name, _label(jobs[name], making / name, self.engine), answer)
            answers[name] = answer
        self._sealed = Sealed({name: answers[name] for name in jobs}, nonce)
        if sealed.exists() and read_commitment(sealed) != self._sealed.commitment:
            raise InputError(f"{self.folder}: sealed.json seals other cases; give --out another folder")
        if not cases.exists():
            making.rename(cases)
        return self._sealed.commit_to(sealed)

    def diagnose(self, progress: Progress | None = None) -> None:
        """Diagnose every case that is not yet, in processes apart."""
        todo = {name: () for name in self._names if not (self.folder / "diagnoses" / name / "took.json").exists()}
        if todo:  # an earlier score may have opened the answers
            for name in OPENED:
                (self.folder / name).unlink(missing_ok=True)
        self._diagnose("diagnoses", todo, progress, "cases diagnosed")

    def score(self, progress: Progress | None = None, oracle: bool = False) -> Scores:
        """Hash the diagnoses, open the answers, score, and write scores.json and blind.html.

        `oracle`: diagnose once more with all but the true effects struck from the catalogue.
        """
        if self._sealed is None:
            raise RuntimeError("there is nothing to score before make()")
        # read before the answers open: what a method left running could change its own by them
        before, found = digest(self.folder / "diagnoses"), self._read("diagnoses")
        answers = self._sealed.open_to(self.folder / "answers.json")
        if oracle and self.command is None:
            known = ENGINES[self.engine].effects
            given = {
                name: tuple(e for e in known if e not in {each["effect"] for each in answer["effects"]})
                for name, answer in answers.items()
                if answer["effects"] and {each["effect"] for each in answer["effects"]} <= set(known)
            }
            given = {name: rest for name, rest in given.items() if answers[name]["kind"] != "leave_one_out"}
            done = {name for name in given if (self.folder / "oracle" / name / "took.json").exists()}
            self._diagnose("oracle", {n: w for n, w in given.items() if n not in done}, progress, "oracle")
        scores = score(answers, found, self._read("oracle"))
        took = [_seconds(path) for path in sorted(self.folder.glob("diagnoses/*/took.json"))]
        about = {
            "seed": self.seed,
            "cases": self.counts,
            "engine": ENGINES[self.engine].version,
            "method": self.command or "invdyn",
            "answers_sha256": self._sealed.commitment,
            "diagnoses_sha256": before,
            "median_seconds_a_case": sorted(took)[len(took) // 2] if took else None,
        }
        text = json.dumps({"schema": 1, "about": about, **scores.to_json()}, indent=1, ensure_ascii=False)
        write_text(self.folder / "scores.json", text + "\n")
        write_page(scores, about, self.folder / "blind.html")
        return scores

    def listing(self) -> str:
        """What lies where."""
        kinds = {"page": "blind.html", "scores": "scores.json", "answers": "answers.json", "cases": "cases"}
        return "".join(f"\n{kind:<10} {self.folder / name}" for kind, name in kinds.items())

    @property
    def _names(self) -> list[str]:
        return sorted(p.name for p in (self.folder / "cases").iterdir())

    def _read(self, kind: str) -> dict[str, dict]:
        found = {}
        for path in sorted(self.folder.glob(f"{kind}/*/diagnosis.json")):
            try:
                given = json.loads(path.read_text(encoding="utf-8"))
            except (ValueError, RecursionError):
                continue  # the score counts it as failed
            if unreadable(given) is None:
                found[path.parent.name] = given
        return found

    def _diagnose(self, kind: str, todo: Mapping[str, Iterable[str]], progress: Progress | None, what: str) -> None:
        own, lock = threading.local(), threading.Lock()
        with ExitStack() as methods, ThreadPoolExecutor(self.workers) as threads:

            def one(name: str, without: Iterable[str]) -> None:
                if not hasattr(own, "method"):
                    ours = Ours(1 if self.workers > 1 else None)
                    method = Theirs(self.command, self.confined) if self.command else ours
                    with lock:
                        own.method = methods.enter_context(method)
                out, start = self.folder / kind / name, time.monotonic()
                out.mkdir(parents=True, exist_ok=True)
                wrong = own.method(self.folder / "cases" / name, out, without)
                if wrong is None:
                    (out / "failed.txt").unlink(missing_ok=True)
                    write_text(out / "took.json", json.dumps({"seconds": round(time.monotonic() - start, 2)}) + "\n")
                else:
                    write_text(out / "failed.txt", wrong + "\n")

            futures = [threads.submit(one, name, without) for name, without in todo.items()]
            try:
                for number, future in enumerate(as_completed(futures), 1):
                    future.result()
                    if progress is not None:
                        progress(number, len(futures), what)
            except BaseException:
                threads.shutdown(wait=False, cancel_futures=True)
                methods.close()  # ends the processes, so that the threads end too
                raise


def _seconds(path: Path) -> float:
    """That a diagnosis took. Raises InputError for another file than a run writes."""
    try:
        return float(json.loads(path.read_text(encoding="utf-8"))["seconds"])
    except (ValueError, KeyError, TypeError, RecursionError):
        raise InputError(f"{path}: expected the seconds of a diagnosis; delete it to diagnose the case again") from None


def _label(job: Sequence | None, case: Path, engine: str) -> str:
    """What a case was made from and by, and its files: an answer is that of no other."""
    return f"{job}, {ENGINES[engine].version}, {digest(case)}"


def _make(folder: str, seed: int, kind: str, effect: str | None, engine: str) -> dict:
    case = make_case(seed, kind, effect, engine)
    case.write(folder)
    return case.answer


def _each(
    work: Callable, jobs: Mapping[str, tuple], workers: int, progress: Progress | None, what: str
) -> Iterator[tuple[str, dict]]:
    """(name, result) of every job, as they come; in processes where there are several workers."""
    if workers == 1 or not jobs:
        for number, (name, job) in enumerate(jobs.items(), 1):
            yield name, work(*job)
            if progress is not None:
                progress(number, len(jobs), what)
        return
    # spawned: a fork of a process with torch's threads may hang
    context = multiprocessing.get_context("spawn")
    # whoever interrupts reaches the children too, who would each print a traceback
    deaf = signal.SIGINT, signal.SIG_IGN
    with ProcessPoolExecutor(min(workers, len(jobs)), context, signal.signal, deaf) as pool:
        names = {pool.submit(work, *job): name for name, job in jobs.items()}
        try:
            for number, future in enumerate(as_completed(names), 1):
                yield names[future], future.result()
                if progress is not None:
                    progress(number, len(jobs), what)
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise
