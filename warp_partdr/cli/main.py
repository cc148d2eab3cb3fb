"""Command ``partdr``, which holds all other commands."""

from __future__ import annotations

import atexit
import contextlib
import gc
import os
import sys
from io import TextIOWrapper
from typing import Annotated, Any

import typer
from typer import Option

from .. import __version__
from ..errors import InputError, printable
from .bench import bench
from .convert import CONVERT_HELP, convert
from .dataset import DATASET_HELP, dataset
from .dataset_files import EXPORT_HELP, REPORT_HELP, export, report
from .demo import DEMO_HELP, demo
from .evaluate import evaluate
from .fit import FIT_HELP, fit
from .options import grouped
from .predict import PREDICT_HELP, predict
from .register import REGISTER_HELP, register_body
from .scene import SCENE_HELP, scene
from .train import TRAIN_HELP, train_network

_UsageError: Any = typer.BadParameter.__base__  # versions of typer have it in different modules, but not its subclass

# New objects before the first garbage collection, and between later ones. Imports make a million objects that stay, and
# a fit of a photo a million more; the default is 700.
_FIRST_OBJECTS, _OBJECTS = 4_000_000, 100_000

app = typer.Typer(
    add_completion=False, rich_markup_mode="markdown", context_settings={"help_option_names": ["-h", "--help"]}
)


def _print_version(asked: bool) -> None:
    if asked:
        typer.echo(f"partdr {__version__}")
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[
        bool, Option("--version", help="Print the version and exit.", callback=_print_version, is_eager=True)
    ] = False,
) -> None:
    """Differentiable rendering of body parts, and reconstruction of human pose and shape."""


app.command("fit", help=FIT_HELP)(grouped(fit))
app.command("scene", help=SCENE_HELP)(grouped(scene))
app.command("register", help=REGISTER_HELP)(grouped(register_body))
app.command("predict", help=PREDICT_HELP)(grouped(predict))
app.command("dataset", help=DATASET_HELP)(grouped(dataset))
app.command("report", help=REPORT_HELP)(report)
app.command("export", help=EXPORT_HELP)(export)
app.command("convert", help=CONVERT_HELP)(convert)
app.command("demo", help=DEMO_HELP)(grouped(demo))
app.command("train", help=TRAIN_HELP)(train_network)
app.add_typer(evaluate, name="evaluate")
app.add_typer(bench, name="bench")


def main() -> None:
    """Run the command; bad input is one line on stderr and exit code 2."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):  # names of files need not be Unicode
            stream.reconfigure(errors="backslashreplace")
    try:
        code = app(sys.argv[1:] or ["--help"], prog_name="partdr", standalone_mode=False)
    except InputError as error:
        code = _print_error(str(error))
    except _UsageError as error:
        command = error.ctx.command_path if error.ctx else "partdr"
        code = _print_error(f"{error.format_message().rstrip('.') or 'no command'}; see {command} --help")
    except typer.Abort:
        code = 130
    sys.exit(code)


def run() -> None:
    """Run ``main`` as a process of its own, which ends here, without clean-up that would take a second."""
    gc.set_threshold(_FIRST_OBJECTS)
    gc.callbacks.append(_collect_new_objects)
    try:
        main()
    except SystemExit as left:
        code = left.code if isinstance(left.code, int) else int(left.code is not None)
    # Torch takes a third of a second to free its objects one by one.
    atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError):  # it is closed, or a pipe that nobody reads any more
            stream.flush()
    os._exit(code)


def _collect_new_objects(phase: str, info: dict[str, int]) -> None:
    """Let collections after the first one be of new objects, and more frequent: what is there by then will stay."""
    if phase == "stop":
        gc.callbacks.remove(_collect_new_objects)
        gc.freeze()
        gc.set_threshold(_OBJECTS)


def _print_error(message: str) -> int:
    typer.echo(f"partdr: {printable(' '.join(message.split()))}", err=True)
    return 2
