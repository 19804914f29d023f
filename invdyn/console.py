"""How the command line speaks: one clear line for an error, a bar for progress, nothing half-written.

Exit codes: 0 done, 2 bad input (the user can mend it), 74 done but not printed, 128 + n ended by signal n (130 by
Ctrl-C, 143 by a termination). Anything else is a bug of ours and shows its traceback.
"""

import errno
import os
import re
import signal
import sys
import warnings
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise
from pathlib import Path
from threading import current_thread, main_thread
from typing import Any

import typer
from tqdm import tqdm
from typer.core import TyperGroup

from .renamed_options import with_new_names

BAD_INPUT, READER_LEFT, NOT_PRINTED, INTERRUPTED = 2, 1, 74, 130  # exit codes; 74 is EX_IOERR, 130 SIGINT
WORDS = "invdyn.words"  # where a context keeps the command line
MODEL = re.compile(r".+\.py:\w+")
MAX_CHARACTERS = 1500  # characters of a message
# typer does not export click's UsageError (unknown option, wrong type, missing argument), only a child of it
UsageError: Any = typer.BadParameter.__base__


@dataclass
class _Run:
    """What one command is to leave, what it warned of, and why its words could not be printed, if so."""

    outputs: list[Path] = field(default_factory=list)
    unprinted: OSError | None = None
    warned: set[str] = field(default_factory=set)


_run = _Run()
"""Of the command that this process runs; one at a time."""


class Commands(TyperGroup):
    """The commands' group, the one place where errors become a line on stderr and an exit code."""

    def main(self, *args: Any, **extra: Any) -> Any:
        """Parse and run; where the help cannot be printed, say so."""
        try:
            return super().main(*args, **extra)
        except OSError as error:  # those of a command have become a line by now
            _print_no_more()
            print_line("error", f"could not print: {error.strerror}")
            sys.exit(NOT_PRINTED)

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse, and keep the words as they were given: an error about a file names the option that it came by.

        `compare model.py:Model` is `compare-model`: a model of one's own has no body.
        """
        if args[:1] == ["compare"] and any(MODEL.fullmatch(word) for word in args[1:]):
            args = ["compare-model", *args[1:]]
        if args and args[0] in self.commands:
            args = [args[0], *self._with_new_names(self.commands[args[0]], args[1:])]
        ctx.meta[WORDS] = list(args)
        return super().parse_args(ctx, args)

    @staticmethod
    def _with_new_names(command: Any, words: list[str]) -> list[str]:
        """Words of a command, renamed options under their new names; a warning says so."""
        options = [(option, one) for one in command.params for option in (*one.opts, *one.secondary_opts)]
        repeatable = [option for option, one in options if getattr(one, "multiple", False)]
        settings = [f"--set {name.replace('_', '-')}=" for name in getattr(command.callback, "settings", ())]
        own = [*(option for option, _ in options), *settings]
        try:
            return with_new_names(words, own, repeatable, partial(print_line, "warning"))
        except ValueError as error:
            print_line("error", error)
            raise typer.Exit(BAD_INPUT) from None

    def invoke(self, ctx: Any) -> Any:
        """Run the command."""
        global _run
        _run = _Run()
        with warnings.catch_warnings(), _terminable():
            # ArviZ announces its version 1.0 once a day, to whoever imports it
            warnings.filterwarnings("ignore", r"\s*ArviZ is undergoing", FutureWarning)
            warnings.showwarning = _show_warning  # type: ignore[assignment]  # it leaves out what it does not need
            try:
                try:
                    result = super().invoke(ctx)
                except typer.Exit:
                    _check_printed()
                    raise
                _check_printed()
                return result
            except KeyboardInterrupt:
                print_line("interrupted", "what was not finished was not written")
                raise typer.Exit(INTERRUPTED) from None
            except Terminated as ended:
                print_line("terminated", "what was not finished was not written")
                raise typer.Exit(int(str(ended.code))) from None
            except UsageError as error:
                command = error.ctx.command_path if error.ctx else "invdyn"
                print_line("error", f"{error.format_message()} (see {command} --help)")
            except OSError as error:
                if error.errno == errno.EPIPE:
                    raise
                print_line(
                    "error", f"{self._given(ctx, error.filename)}: {error.strerror}" if error.filename else error
                )
            except (ValueError, ArithmeticError) as error:
                if not _is_input_error(error):
                    raise
                print_line("error", error)
            raise typer.Exit(BAD_INPUT)

    def _given(self, ctx: Any, file: Any) -> str:
        """A file, behind the option that it was given by; alone where it is an argument, or of our own making."""
        command, *words = ctx.meta[WORDS]
        options = [one for one in self.commands[command].params if not getattr(one, "is_flag", True)]
        taking = {name for option in options for name in option.opts}
        parts = [word.split("=", 1) if word.partition("=")[0] in taking else [word] for word in words]
        words = [part for each in parts for part in each]
        for option, given in pairwise(words):
            if option in taking and Path(str(file)) in (Path(given), *map(Path, given.split(","))):
                return f"{option} {file}"
        return str(file)


class Terminated(SystemExit):
    """The system ends this process, by a termination or with its terminal; ``code`` is 128 + the signal's number."""


@contextmanager
def _terminable() -> Iterator[None]:
    """Let a termination unwind the block as Ctrl-C does, so that workers end and nothing half-written is left.

    In copies of this process, too. A signal that is ignored (`nohup`), or heard by the caller, stays so.
    """

    def end(number: int, _: object) -> None:
        raise Terminated(128 + number)

    numbers = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]
    here = current_thread() is main_thread()
    ours = [number for number in numbers if here and signal.getsignal(number) == signal.SIG_DFL]
    for number in ours:
        signal.signal(number, end)
    try:
        yield
    finally:
        for number in ours:
            signal.signal(number, signal.SIG_DFL)


def _is_input_error(error: Exception) -> bool:
    """Whether it is the user's to mend; those of models, which need torch, are looked for last."""
    from invdyn.recordings import InputError

    if isinstance(error, InputError):
        return True
    from pyro.infer.smcfilter import SMCFailed

    from invdyn.inference.contract import ModelError
    from invdyn.models import BodyError
    from invdyn.models.divergence import Diverged

    return isinstance(error, BodyError | Diverged | ModelError | SMCFailed)


def print_line(kind: str, message: object) -> None:
    """Print one line that a terminal can show, also of names and contents of files; a long one loses its middle."""
    line = " ".join(str(message).split())
    line = "".join(char if char.isprintable() else char.encode("unicode_escape").decode() for char in line)
    if len(line) > MAX_CHARACTERS:
        line = f"{line[: 2 * MAX_CHARACTERS // 3]} … {line[-MAX_CHARACTERS // 3 :]}"
    with suppress(OSError):  # no error can be printed, either
        typer.echo(f"{kind}: {line}", err=True)


def say(text: str) -> None:
    """Print a command's words; where that fails the command continues, and its end says so.

    A full disk under stdout, or a reader that has left, takes nothing from what is written elsewhere. A line that was
    a warning of the same command is not repeated on its terminal; a file or pipe has it.
    """
    seen = _run.warned if sys.stdout.isatty() and sys.stderr.isatty() else ()
    try:
        typer.echo("\n".join(line for line in text.split("\n") if line not in seen))
    except OSError as error:
        _run.unprinted = _run.unprinted or error
        _print_no_more()


def _check_printed() -> None:
    """Raise typer.Exit, and say what was done, where a command's words could not be printed."""
    if (error := _run.unprinted) is None:
        return
    if error.errno == errno.EPIPE:  # the reader of our output has left, and misses nothing
        raise typer.Exit(READER_LEFT)
    written = [str(path) for path in _run.outputs if path.exists()]
    done = f"wrote {', '.join(written)}" if written else "done"
    print_line("error", f"{done}; could not print: {error.strerror}")
    raise typer.Exit(NOT_PRINTED)


def _print_no_more() -> None:
    """Let stdout lead nowhere, so that what is still in its buffer fails at no later time."""
    with suppress(OSError, ValueError):  # it may be no file
        descriptor = os.open(os.devnull, os.O_WRONLY)
        os.dup2(descriptor, sys.stdout.fileno())
        os.close(descriptor)


def _show_warning(message: object, category: type[Warning], *_: object) -> None:
    """Print a warning that concerns users, once: a file is read again where its first rows decide how."""
    if issubclass(category, UserWarning | RuntimeWarning) and str(message) not in _run.warned:
        _run.warned.add(str(message))
        print_line("warning", message)


class ProgressBar:
    """`progress(done, total, what)` as a bar on stderr, a new one for each `what`; none without a terminal.

    What follows a semicolon in `what` changes while the bar stays: "refine; payload".
    """

    def __init__(self) -> None:
        self._bar: tqdm | None = None
        self._what = ""

    def __enter__(self) -> "ProgressBar":
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.close()

    def __call__(self, done: int, total: int, what: str) -> None:
        """Show that `done` of `total` steps of `what` are done."""
        stage, _, detail = what.partition("; ")
        if self._bar is None or self._what != stage:
            self.__exit__()
            self._bar, self._what = tqdm(total=total, desc=stage, file=sys.stderr, disable=None), stage
        self._bar.total = total
        self._bar.set_postfix_str(detail)
        self._bar.update(done - self._bar.n)


def check_ending(what: str, path: Path | None, *endings: str) -> None:
    """Raise InputError where an output, `what`, is called as a file of another kind; None is not wanted."""
    from invdyn.recordings import InputError

    if path is not None and path.suffix.lower() not in endings:
        raise InputError(f"{path}: {what} ends in {' or '.join(endings)}, got {path.suffix!r}; give it such a name")


def check_outputs(outputs: Iterable[Path | None], inputs: Iterable[Path] = ()) -> None:
    """Raise OSError or InputError unless each output can be written and has a path of its own."""
    from invdyn.recordings import InputError, check_writable, resolved

    read = {resolved(path) for path in inputs}
    taken: set[Path] = set()
    for path in outputs:
        if path is None:
            continue
        target = check_writable(path)
        if target in read:
            raise InputError(f"{path}: this output would overwrite an input; give it another name")
        if target in taken:
            raise InputError(f"{path}: two outputs have this name; give each its own")
        taken.add(target)
        _run.outputs.append(path)
