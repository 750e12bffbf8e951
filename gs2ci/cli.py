"""The command line: which subcommands there are, and what their errors look like. Parsing only.

Each subcommand is one file in `gs2ci.commands` with one `run`, whose signature is its command line (tyro reads it:
argument names are parameter names, the help is the docstring). Not here: any work.
"""

import difflib
import functools
import importlib
import inspect
import io
import itertools
import os
import re
import shutil
import signal
import sys
import textwrap
import threading
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from contextvars import copy_context
from dataclasses import replace
from types import NoneType
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal, get_args, get_origin

# torch's and Numba's thread pools otherwise spin against each other (3-10x slower when anything else runs);
# OpenMP reads this when it is first loaded, hence before any other import.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
# So does OpenBLAS, NumPy's and SciPy's. Its threads gain nothing on the small matrices here, and can make a
# triangulation two thousand times slower beside another process (docs/decisions/kernels.md).
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from gs2ci import __version__
from gs2ci.core.clock import begin_command
from gs2ci.core.errors import Gs2ciError
from gs2ci.core.extras import missing_extra
from gs2ci.core.halt import ENDINGS, end

if TYPE_CHECKING:
    from tyro.constructors import ConstructorRegistry, PrimitiveConstructorSpec, PrimitiveTypeInfo

# Name on the command line -> module, and the line that `gs2ci --help` shows. Modules are imported when they are run.
COMMANDS: Final[dict[str, tuple[str, str]]] = {
    "import": ("gs2ci.commands.import_", "turn .npz, .npy, .mat or pictures into a shot file"),
    "reconstruct": ("gs2ci.commands.reconstruct", "recover views, camera path and scene from a shot file"),
    "report": ("gs2ci.commands.report", "rebuild the page of a run from its folder"),
    "open": ("gs2ci.commands.open_", "open the page of a run in the browser"),
    "export": ("gs2ci.commands.export", "write a run for other programs: spz, COLMAP, EXR, films"),
    "mesh": ("gs2ci.commands.mesh", "fuse the depths of a run into a mesh"),
    "view": ("gs2ci.commands.view", "show the scene of a run in the browser"),
    "decode": ("gs2ci.commands.decode", "recover only the views: GAP-TV, plug-and-play, proxies"),
    "evaluate": ("gs2ci.commands.evaluate", "score a run against a truth, the noise model, other views"),
    "measure": ("gs2ci.commands.measure", "measure the distance between two points of a run"),
    "tradeoff": ("gs2ci.commands.tradeoff", "measure accuracy against time for one shot"),
    "models": ("gs2ci.commands.models", "turn trained weights into model files"),
    "design": ("gs2ci.commands.design", "find the masks, travel and exposures that serve a bench"),
    "plan": ("gs2ci.commands.plan", "say which physical effects a simulation must include"),
    "calibrate": ("gs2ci.commands.calibrate", "calibrate a bench: sensor, masks, geometry, timing"),
    "capture": ("gs2ci.commands.capture", "take coded exposures on a bench, real or simulated"),
    "recover": ("gs2ci.commands.recover", "save the finished rows of an interrupted capture"),
    "devices": ("gs2ci.commands.devices", "say what is connected and what it can do"),
    "live": ("gs2ci.commands.live", "show a bench in the browser while you align it"),
    "doctor": ("gs2ci.commands.doctor", "check a bench: permissions, clocks, trigger line"),
    "plugins": ("gs2ci.commands.plugins", "list what other packages add: drivers, rules, decoders, ..."),
    "completion": ("gs2ci.commands.completion", "print a script that lets your shell complete commands"),
    "demo": ("gs2ci.commands.demo", "simulate an exposure, reconstruct it"),
    "compile": ("gs2ci.commands.compile", "compile all kernels now instead of in the first run"),
}
QUIET_WORD: Final = "--quiet"
EXIT_USER_ERROR: Final = 2
EXIT_INTERRUPTED: Final = 130
EXIT_UNREAD: Final = 141


def main() -> int:
    """Run the command line; return the exit status: 0, 2 for an error of ours, 130 when interrupted, 141 unread."""
    out = sys.stdout
    if isinstance(out, io.TextIOWrapper) and (out.errors == "strict" or out.encoding.lower() != "utf-8"):
        # A finished work must not end in an error because its path, or ±, is none of the terminal's characters.
        out.reconfigure(errors="backslashreplace")
    try:
        try:
            # In a context of its own, so that a second call in the same process starts clean.
            return copy_context().run(_serve, sys.argv[1:])
        finally:
            sys.stdout.flush()
    except BrokenPipeError:
        # The reader has closed the pipe, as `| head` does. The interpreter flushes once more at its end.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_UNREAD


def _serve(arguments: list[str]) -> int:
    begin_command()
    # It may stand anywhere, as no file or value begins with two dashes.
    quiet = QUIET_WORD in arguments
    arguments = [word for word in arguments if word != QUIET_WORD]
    if arguments[:1] == ["help"] and arguments[1:]:
        arguments = [arguments[1], "--help"]
    if not arguments or arguments[0] in ("-h", "--help", "help"):
        sys.stdout.write(_usage())
        return 0
    if arguments[0] == "--version":
        sys.stdout.write(f"gs2ci {__version__}\n")
        return 0
    if arguments[0] not in COMMANDS:
        longer = [name for name in COMMANDS if name.startswith(arguments[0])]
        near = longer or difflib.get_close_matches(arguments[0], COMMANDS, 1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        _print_error(Gs2ciError(f"unknown command {arguments[0]!r}{hint}", allowed=", ".join(COMMANDS)))
        return EXIT_USER_ERROR
    return _run(arguments[0], arguments[1:], quiet=quiet and not {"-h", "--help"} & set(arguments))


def _run(command: str, arguments: list[str], *, quiet: bool) -> int:
    import tyro  # noqa: PLC0415

    from gs2ci.commands.answers import silenced  # noqa: PLC0415

    try:
        with _unwound_when_told_to_end(), _optional_values(), silenced() if quiet else nullcontext():
            run: Callable[..., Any] = importlib.import_module(COMMANDS[command][0]).run
            _check_flags(run, arguments)
            # The parser shows every line of an argument's text as a line of its own, broken again at the terminal's
            # width.
            run.__doc__ = re.sub(r"\n {8,}", " ", inspect.cleandoc(run.__doc__ or ""))
            about = _about(run.__doc__)
            tyro.cli(_with_plain_help(run), prog=f"gs2ci {command}", description=about, args=arguments)
    except Gs2ciError as error:
        _print_error(error)
        return EXIT_USER_ERROR
    except ModuleNotFoundError as error:
        missing = missing_extra(error)
        if missing is None:
            raise
        _print_error(missing)
        return EXIT_USER_ERROR
    except EOFError as error:
        cut = _cut_bytecode(error)
        if cut is None:
            raise
        _print_error(Gs2ciError(f"{cut}, which Python keeps of a module, is cut short", remedy="delete it"))
        return EXIT_USER_ERROR
    except BrokenPipeError:
        raise
    except OSError as error:
        # Not every access to a path is checked individually: names too long, folders without permission, ...
        _print_error(Gs2ciError(str(error), remedy="check the name, the folder, its free space and its permissions"))
        return EXIT_USER_ERROR
    except MemoryError as error:
        _print_error(
            Gs2ciError(f"out of memory: {error}", remedy="take a smaller picture or fewer views, or a larger machine")
        )
        return EXIT_USER_ERROR
    except KeyboardInterrupt:
        return _interrupted()
    except SystemError as error:
        from gs2ci.api.display import stems_from_interruption  # noqa: PLC0415

        if not stems_from_interruption(error):
            raise
        return _interrupted()
    return 0


def _check_flags(run: Callable[..., Any], arguments: list[str]) -> None:
    """Check that no option without a value is given one: the parser would set it, and take the value for a file.

    Raises:
        Gs2ciError: One is.
    """

    def is_flag(kind: Any) -> bool:
        return kind is bool or (get_origin(kind) is Annotated and is_flag(get_args(kind)[0]))

    options = inspect.signature(run).parameters.values()
    flags = {"--" + one.name.replace("_", "-") for one in options if is_flag(one.annotation)}
    for word in itertools.takewhile(lambda word: word != "--", arguments):
        name, equals, value = word.partition("=")
        plain = name.replace("_", "-")
        if equals and (plain in flags or plain.replace("--no-", "--", 1) in flags):
            raise Gs2ciError(
                f"{name} has no value, and was given {value!r}",
                allowed=f"{name} alone",
                remedy=f"write {name}, or leave it out",
            )


def _cut_bytecode(error: EOFError) -> str | None:
    """Return the file of byte code at whose end Python stood, if it was importing.

    A disk that is full during a first import leaves one; versions before 3.14 take it for whole ever after.
    """
    frames = (frame for frame, _ in traceback.walk_tb(error.__traceback__) if frame.f_code.co_name == "get_code")
    found = [frame.f_locals.get("bytecode_path") for frame in frames]
    return str(found[-1]) if found and found[-1] else None


def _about(docstring: str) -> str:
    """Lay out what a docstring says before its arguments, in paragraphs that end at the terminal's width.

    The parser joins a paragraph's lines unless they are indented; so all but the first are.
    """
    text = re.split(r"\n\n(?:Args|Returns|Raises):", inspect.cleandoc(docstring))[0]
    lines = textwrap.TextWrapper(shutil.get_terminal_size().columns, subsequent_indent="  ")
    return "\n\n".join(lines.fill(" ".join(part.split())) for part in text.split("\n\n"))


def _with_plain_help(run: Callable[..., Any]) -> Callable[..., Any]:
    """Return the command with help that names positional arguments, and shows a default only if there is one.

    If the default is None or empty, the argument's text says what happens without it.
    """
    import tyro  # noqa: PLC0415

    def told(default: str) -> str:
        return "" if default in ("None", "", "''") else f"(default: {default})"

    def annotated(parameter: inspect.Parameter) -> inspect.Parameter:
        kind, metavar = parameter.annotation, None
        if _is_place(kind) and not _has_choices(kind):
            metavar = parameter.name.upper().replace("_", "-")
            if parameter.default is not parameter.empty:
                metavar = f"[{metavar} ...]" if parameter.default == () else f"[{metavar}]"
        return parameter.replace(annotation=Annotated[kind, tyro.conf.arg(metavar=metavar, help_behavior_hint=told)])

    signature = inspect.signature(run)
    parameters = [annotated(parameter) for parameter in signature.parameters.values()]

    @functools.wraps(run)
    def command(*arguments: Any, **options: Any) -> Any:
        return run(*arguments, **options)

    del command.__wrapped__  # the parser would look through to the arguments as they were
    command.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
    command.__annotations__ = {one.name: one.annotation for one in parameters}
    return command


def _is_place(kind: Any) -> bool:
    """Return whether an argument is positional."""
    import tyro  # noqa: PLC0415

    return tyro.conf.Positional in getattr(kind, "__metadata__", ())


def _has_choices(kind: Any) -> bool:
    return get_origin(get_args(kind)[0]) is Literal


@contextmanager
def _unwound_when_told_to_end() -> Iterator[None]:
    """Make `kill`, or closing the terminal, close what is open, as Ctrl-C does.

    Otherwise the process would end at once, with the lamp on and the stage moving.
    """
    main = threading.current_thread() is threading.main_thread()
    # A signal that is ignored (nohup) stays so.
    taken = [number for number in ENDINGS if main and signal.getsignal(number) is signal.SIG_DFL]
    for number in taken:
        signal.signal(number, end)
    try:
        yield
    finally:
        for number in taken:
            signal.signal(number, signal.SIG_DFL)


def _optional_values() -> "ConstructorRegistry":
    """Make the rule that shows the value of an optional option as PATH, not as {None}|PATH."""
    from tyro.constructors import (  # noqa: PLC0415
        ConstructorRegistry,
        PrimitiveConstructorSpec,
        PrimitiveTypeInfo,
    )

    registry = ConstructorRegistry()

    @registry.primitive_rule
    def optional(info: "PrimitiveTypeInfo") -> "PrimitiveConstructorSpec[Any] | None":
        kinds = [kind for kind in get_args(info.type) if kind is not NoneType]
        if NoneType not in get_args(info.type) or len(kinds) != 1:
            return None
        given = ConstructorRegistry.get_primitive_spec(PrimitiveTypeInfo.make(kinds[0], info.markers))
        if not isinstance(given, PrimitiveConstructorSpec):
            return None
        return replace(
            given,
            instance_from_str=lambda words: None if words == ["None"] else given.instance_from_str(words),
            is_instance=lambda value: value is None or given.is_instance(value),
            str_from_instance=lambda value: ["None"] if value is None else given.str_from_instance(value),
        )

    return registry


def _interrupted() -> int:
    sys.stderr.write("interrupted; every file that has its final name is whole\n")
    return EXIT_INTERRUPTED


def _print_error(error: Gs2ciError) -> None:
    """Print what is wrong, what is allowed and what to do, one line each."""
    from rich.console import Console  # noqa: PLC0415

    console = Console(stderr=True, highlight=False)
    console.print(f"error: {error.problem}", style="bold red", markup=False, soft_wrap=True)
    for label, text in (("allowed", error.allowed), ("what to do", error.remedy)):
        if text:
            console.print(f"{label}: {text}", markup=False, soft_wrap=True)


def _usage() -> str:
    width = max(len(name) for name in COMMANDS)
    lines = [f"  gs2ci {name:<{width}}  {what}" for name, (_, what) in COMMANDS.items()]
    return "\n".join(
        [
            f"gs2ci {__version__}: snapshot compressive imaging, one coded measurement to a 3D scene",
            "",
            *lines,
            "",
            "gs2ci COMMAND --help explains a command.",
            "--quiet leaves errors, and answers that --json asks for.",
            "Exit status: 0 done, 2 refused with a reason, 130 interrupted,",
            "141 output no longer read.",
            "",
        ]
    )


if __name__ == "__main__":
    sys.exit(main())
