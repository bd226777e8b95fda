"""The command `slipmap`: its subcommands, its exit codes, and how it reports failures.

Exit codes: 0 success; 1 a failure of the program itself, or a run that did not reach its goal; 2 wrong use or
bad input; 130 stopped by Ctrl-C or by a termination signal.
"""

import atexit
import difflib
import errno
import gc
import importlib
import os
import signal
import sys
import threading
import traceback
from collections import Counter
from collections.abc import Sequence
from typing import Any, TextIO, cast

import click

from slipmap.diagrams.application.commands.options import OutputFile, keep_files_apart
from slipmap.diagrams.application.terminal import note
from slipmap.models.files import BadInput

SUCCESS, INTERNAL_FAILURE, WRONG_USE, STOPPED = 0, 1, 2, 130
TRACEBACK = "SLIPMAP_TRACEBACK"
_STOPPED = "stopped; nothing half-written is left behind"
_COMMANDS = (
    "machine:doctor", "demo", "demo:example", "explore", "explore:pregrasp", "record:station", "record",
    "record:replay", "describe_object", "datasets:import_files", "datasets:check", "identify",
    "compare:predict", "beliefs:view", "compare", "compare:diagnose", "identify:fit", "effects",
    "beliefs:export", "studies:calibrate", "studies:explore_study", "studies:campaign",
    "studies:blind_test", "studies:audit", "machine:bench", "machine:completion",
)  # fmt: skip
"""Modules of commands, each with its function where that has another name."""


class _Commands(click.Group):
    """A group that lists its commands in the order a newcomer meets them, and recognises typing errors."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(self.commands)

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        name = args[0]
        if name not in self.commands and not name.startswith("-"):
            near = difflib.get_close_matches(name, self.commands, n=1)
            hint = f"did you mean `{near[0]}`?" if near else f"there are {', '.join(self.commands)}."
            ctx.fail(f"there is no command `{name}`; {hint}")
        found, command, rest = super().resolve_command(ctx, args)
        if command is not None and not ctx.resilient_parsing:
            _refuse_slips(click.Context(command, parent=ctx, info_name=found), rest)
        return found, command, rest


def _refuse_slips(ctx: click.Context, args: Sequence[str]) -> None:
    """Refuse repeated options and empty paths.

    Click would silently take the last of several values, and the working folder for an empty path, which a
    shell makes of an unset variable.
    """
    values, _, given = ctx.command.make_parser(ctx).parse_args(list(args))
    for param in ctx.command.params:
        if isinstance(param.type, click.Path | OutputFile):
            value = values.get(param.name or "")
            if value == "" or (isinstance(value, list | tuple) and "" in value):
                name = "/".join(param.opts) if isinstance(param, click.Option) else param.human_readable_name
                ctx.fail(f"{name} has an empty name; give the name of a file or a folder.")
    for option, times in Counter(given).items():
        single = isinstance(option, click.Option) and not (option.multiple or option.is_flag or option.count)
        if single and times > 1:
            ctx.fail(f"{'/'.join(option.opts)} is given {times} times but takes one value; give it once.")


@click.group(
    cls=_Commands,
    invoke_without_command=True,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
    epilog="`slipmap COMMAND --help` explains a command. Results go to standard output, progress and remarks"
    " to standard error; --json FILE writes results for other programs.",
)
@click.version_option(package_name="slipmap", message="slipmap %(version)s")
@click.pass_context
def slipmap(ctx: click.Context) -> None:
    """Find out how an unknown object slides.

    From a few recorded pushes, slipmap learns how mass and friction are distributed over an object, states
    how certain that is, predicts further pushes, and names the physical effect that its model misses.

    New here? `slipmap example` writes sample pushes to try the commands on, `slipmap demo` compares a belief
    with the truth, and `slipmap doctor` checks that this machine has everything slipmap needs.
    """
    if ctx.invoked_subcommand is None:
        click.echo(ctx.get_help(), err=True)
        ctx.exit(WRONG_USE)


for _name in _COMMANDS:
    _module, _, _function = _name.partition(":")
    _command = getattr(importlib.import_module(f"{__package__}.commands.{_module}"), _function or _module)
    keep_files_apart(_command)
    slipmap.add_command(_command)


def run(arguments: Sequence[str]) -> int:
    """Run one command, report any failure on stderr, and return the exit code."""
    try:
        result = slipmap.main(list(arguments), prog_name="slipmap", standalone_mode=False)
        sys.stdout.flush()
        return result if isinstance(result, int) else SUCCESS
    except (click.Abort, KeyboardInterrupt):
        return _report(_STOPPED, STOPPED)
    except click.UsageError as error:
        path = error.ctx.command_path if error.ctx else " ".join(["slipmap", *_command_in(arguments)])
        said = _sentence(error.format_message()) + _nearest_choice(error, arguments)
        return _report(f"{said} See `{path} --help`.", WRONG_USE)
    except click.ClickException as error:
        return _report(error.format_message(), error.exit_code)
    except BadInput as error:
        return _report(str(error), WRONG_USE)
    except OSError as error:
        if error.errno == errno.ENOSPC:
            return _report("cannot write the output: the disk is full; make room", WRONG_USE)
        # Comes from wherever a path is first used, for reading or for writing.
        if error.errno == errno.ENAMETOOLONG:
            said = f"the name {error.filename} is too long for this disk; choose a shorter one"
            return _report(said, WRONG_USE)
        return _leads_nowhere(error) if error.errno == errno.ELOOP else _internal(error)
    except Exception as error:
        if isinstance(error, RuntimeError) and str(error).startswith("Symlink loop"):  # Path.resolve()
            return _leads_nowhere(error)
        if _comes_of_ctrl_c(error):
            return _report(_STOPPED, STOPPED)
        return _report(_one_paragraph(str(error)), WRONG_USE) if _is_bad_input(error) else _internal(error)


def _command_in(arguments: Sequence[str]) -> list[str]:
    """The command that was typed, if there is such a one; an option without its value does not tell."""
    return [word for word in arguments[:1] if word in slipmap.commands]


def _comes_of_ctrl_c(error: BaseException | None) -> bool:
    """Whether Ctrl-C caused an error, such as an ImportError of a C module whose loading it interrupted.

    Some such modules do not name what caused their error.
    """
    if _heard and isinstance(error, ImportError):
        return True
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error is not None


def _nearest_choice(error: click.UsageError, arguments: Sequence[str]) -> str:
    """The choice that was probably meant, where another word was given."""
    kind = error.param.type if isinstance(error, click.BadParameter) and error.param else None
    if isinstance(kind, click.Choice):
        for word in (argument.rpartition("=")[2] for argument in arguments):
            near = difflib.get_close_matches(word, kind.choices, n=1)
            if near and repr(word) in error.message:
                return f" Did you mean {near[0]!r}?"
    return ""


def _is_bad_input(error: Exception) -> bool:
    from slipmap.models.effects import EffectError
    from slipmap.models.inference.belief import BeliefError
    from slipmap.models.measurements import DatasetError

    return isinstance(error, BeliefError | DatasetError | EffectError)


def _one_paragraph(text: str) -> str:
    return " ".join(text.split())


def _sentence(text: str) -> str:
    said = _one_paragraph(text)
    return said if said.endswith((".", "?", "!")) else f"{said}."


def _leads_nowhere(error: Exception) -> int:
    return _report(f"a symbolic link leads back to itself ({error}); name the file itself", WRONG_USE)


def _internal(error: Exception) -> int:
    place = traceback.extract_tb(error.__traceback__)[-1]
    if os.environ.get(TRACEBACK):
        traceback.print_exception(error)
    return _report(
        f"internal failure, {type(error).__name__} in {os.path.basename(place.filename)}, line"
        f" {place.lineno}: {_one_paragraph(str(error))}. This is a fault of slipmap, not of your input;"
        f" please report it with the full traceback, which setting {TRACEBACK}=1 in the environment shows.",
        INTERNAL_FAILURE,
    )


def _report(message: str, code: int) -> int:
    note(f"slipmap: {message}")
    return code


class _Output:
    """A text stream whose reader may close it: the rest is then discarded, and the command continues."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        try:
            return self._stream.write(text)
        except BrokenPipeError:
            self._give_up()
            return len(text)

    def flush(self) -> None:
        try:
            self._stream.flush()
        except BrokenPipeError:
            self._give_up()

    def _give_up(self) -> None:
        os.dup2(os.open(os.devnull, os.O_WRONLY), self._stream.fileno())


def _opened(stream: TextIO | None, descriptor: int) -> TextIO:
    """Standard output or error; the null device where the command was started without it."""
    if stream is None:
        nowhere = os.open(os.devnull, os.O_WRONLY)
        if nowhere != descriptor:
            os.dup2(nowhere, descriptor)
        stream = os.fdopen(descriptor, "w")
    if hasattr(stream, "reconfigure"):
        stream.reconfigure(errors="replace")
    return cast(TextIO, _Output(stream))


_heard: list[int] = []  # Ctrl-C and termination signals so far


def _stop(number: int, frame: object) -> None:
    _heard.append(number)
    raise KeyboardInterrupt


def _hear_again(lost: "sys.UnraisableHookArgs") -> None:
    """Repeat a Ctrl-C that came while an object was deleted, or in a callback from C, where it is lost.

    Other errors after it are of objects that were only half made.
    """
    if issubclass(lost.exc_type, KeyboardInterrupt):
        main_thread = threading.main_thread().ident
        number = _heard[-1] if _heard else signal.SIGINT
        # Raised in here, it would be lost again.
        again = threading.Timer(0.02, signal.pthread_kill, (main_thread, number))
        again.daemon = True
        again.start()
    elif not _heard:
        sys.__unraisablehook__(lost)


def main() -> None:
    """Entry point of the console script."""
    # The matrices are small and the rollouts have their own threads: with another program on the same
    # cores, BLAS threads waiting for each other made an identification seven times slower.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # Nearly all objects live as long as the command; looking for others took a tenth of imports and pictures.
    gc.set_threshold(50_000)
    # Terminating the command from outside, or closing its terminal, acts like Ctrl-C: workers end with it,
    # and nothing half-written is left.
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(number) != signal.SIG_IGN:  # as under nohup, or in the background of a shell
            signal.signal(number, _stop)
    sys.unraisablehook = _hear_again
    sys.stdout, sys.stderr = _opened(sys.stdout, 1), _opened(sys.stderr, 2)
    code = SUCCESS

    def leave() -> None:
        # After a Ctrl-C inside `exec`, as when a dataclass is made, Python would end by SIGINT instead.
        if code == STOPPED:
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(code)

    atexit.register(leave)  # called after those that the command registers
    code = run(sys.argv[1:])
    # The work is over: a signal while Python shuts down would only spoil the exit code.
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    sys.exit(code)


if __name__ == "__main__":
    main()
