"""Harness of all measurements: lists them, reads their options, shows their figures and writes them down.

python -m warp_partdr.lab
python -m warp_partdr.lab NAME --help
python -m warp_partdr.lab NAME [options] [--markdown] [--json FILE]
"""

from __future__ import annotations

import ast
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from inspect import BoundArguments
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import App, CycloptsError, Parameter

from ..errors import InputError, printable
from ..interop.devices import choose_device

if TYPE_CHECKING:
    from .evaluation.evaluate import Report
    from .tables import FigureTable

COMMAND = "python -m warp_partdr.lab"
_FOLDER = Path(__file__).parent / "measurements"
_WIDTH = 220  # [characters] of tables; narrower ones lose columns

JsonFile = Annotated[Path | None, Parameter(help="Write the figures, too, with machine, versions and date.")]
Markdown = Annotated[bool, Parameter(help="Print tables as the rows of a page.")]


def measurements() -> dict[str, str]:
    """First line of each measurement's docstring, by the name of its command."""
    return {path.stem.replace("_", "-"): _docstring(path).splitlines()[0] for path in sorted(_FOLDER.glob("[a-z]*.py"))}


def _docstring(path: Path) -> str:
    return ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""


def run_lab() -> None:
    """Run the command; wrong input is one line on stderr and exit code 2."""
    name, *tokens = sys.argv[1:] or ["--help"]
    with one_line_errors("lab"):
        if name in ("-h", "--help"):
            _print_list()
        elif name in measurements():
            run_measurement(name, tokens)
        else:
            raise InputError(f"{name}: no measurement; expected one of {', '.join(measurements())}")


def run_measurement(name: str, tokens: Sequence[str]) -> None:
    """Run a measurement with options as the command line has them, show its figures, and write them if asked to.

    A measurement yields tables, reports of fits, and sentences; each is printed as soon as it is there.

    Raises:
        CycloptsError: If an option is unknown or wrong.
        InputError: If an input is wrong, or the file of ``--json`` can't be written.
    """
    try:
        module = import_module(f".measurements.{name.replace('-', '_')}", __package__)
    except ModuleNotFoundError as error:  # of an extra
        raise InputError(f"{name}: {error}; expected that package to be installed") from error
    app = _app(f"{COMMAND} {name}", getattr(module, f"measure_{name.replace('-', '_')}"), module.__doc__ or "")

    @app.meta.default
    def run(
        *given: Annotated[str, Parameter(show=False, allow_leading_hyphen=True)],
        json: JsonFile = None,
        markdown: Markdown = False,
    ) -> None:
        measure, bound, _ = app.parse_args(given, exit_on_error=False, print_error=False)
        bound.apply_defaults()
        choose_device("cpu")  # Warp prints its warnings alone from here on
        if json is not None:
            _check_writable(json)
        results: list[FigureTable | Report | str] = []
        finished = False
        try:
            for result in measure(*bound.args, **bound.kwargs):
                _show(result, markdown)
                results.append(result)
            finished = True
        finally:  # what was found before a failure is not lost
            if json is not None:
                _save(json, Record(name, bound, results, finished))

    app.meta(tokens, exit_on_error=False, print_error=False)


def run_script(function: Callable[..., Any], tokens: Sequence[str] | None = None) -> None:
    """Run the function of a script, whose parameters are the options and whose module's docstring is the help."""
    module = sys.modules[function.__module__]
    name = Path(module.__file__ or "").name
    with one_line_errors(name):
        _app(name, function, module.__doc__ or "")(tokens, exit_on_error=False, print_error=False)


@contextmanager
def one_line_errors(name: str) -> Iterator[None]:
    """Let wrong input end the process with one line on stderr and exit code 2."""
    try:
        yield
    except (InputError, CycloptsError) as error:
        print(f"{name}: {printable(' '.join(str(error).split()))}", file=sys.stderr)
        sys.exit(2)


def _app(name: str, function: Callable[..., Any], text: str) -> App:
    usual = Parameter(consume_multiple=True, negative=())
    app = App(name, help=text, help_format="markdown", version_flags=(), result_action="return_value")
    app.default_parameter = usual
    app.default(function)
    return app


def _print_list() -> None:
    known = measurements()
    width = max(map(len, known))
    print(f"{COMMAND} NAME [options]: one measurement; NAME --help explains it.\n")
    for name, line in known.items():
        print(f"  {name:{width}}  {line}")


def _check_writable(path: Path) -> None:
    """Find out before a long measurement, not after it."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.open("a").close()
    except OSError as error:
        raise InputError(f"--json: {path}: {error.strerror or error}; expected a file to write") from error


def _show(result: FigureTable | Report | str, markdown: bool) -> None:
    """Print a result."""
    from rich.console import Console

    from .evaluation.evaluate import Report, tables

    console = Console(width=_WIDTH, highlight=False)
    if isinstance(result, str):
        print(result, flush=True)
    elif isinstance(result, Report):
        for table in tables(result):
            console.print(table)
    elif markdown:
        print(f"{result.title}\n\n{result.markdown()}\n", flush=True)
    else:
        console.print(result.on_screen())


@dataclass(frozen=True)
class Record:
    """All that is written about a measurement.

    Attributes:
        name: Name of its command.
        bound: Options of the measurement.
        results: Results that it has found.
        finished: True if it came to its end.
    """

    name: str
    bound: BoundArguments
    results: list[FigureTable | Report | str]
    finished: bool

    def to_json(self) -> dict[str, Any]:
        """Return it with machine, versions and date."""
        from .bench.machine import about

        options = {key: _plain_option(value) for key, value in self.bound.arguments.items()}
        device = str(options.get("device", "cpu"))
        return {
            "measurement": self.name,
            "options": options,
            "machine": about(device),
            "finished": self.finished,
            "results": [result if isinstance(result, str) else result.to_json() for result in self.results],
        }


def _save(path: Path, record: Record) -> None:
    from .tables import save_figures

    save_figures(record.to_json(), path)
    print(f"{path} holds the same figures")


def _plain_option(value: Any) -> Any:
    if isinstance(value, range):
        return [value[0], value[-1]]
    if isinstance(value, tuple | list):
        return [_plain_option(each) for each in value]
    return value if value is None or isinstance(value, bool | int | float) else str(value)
