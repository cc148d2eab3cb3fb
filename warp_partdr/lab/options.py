"""Options that measurements share, as types of their parameters."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Annotated, Any, TypeVar

from cyclopts import Parameter, Token
from cyclopts.validators import Number
from rich.console import Console
from rich.progress import track

from ..errors import InputError
from ..files.sections import set_value
from ..interop.devices import choose_device
from ..solve.ellipsoids.options import FitOptions
from ..solve.ellipsoids.settings import change_options
from .evaluation.partbench.samples import check_levels

Item = TypeVar("Item")


def _read_range(_: type, tokens: Sequence[Token]) -> range:
    """Range of FIRST and LAST, which both belong to it."""
    first, last = (token.value for token in tokens)
    if not (first.isdecimal() and last.isdecimal() and int(first) <= int(last)):
        raise InputError(f"people: {first} {last}; expected the first and the last, whole numbers from 0 on")
    return range(int(first), int(last) + 1)


def _read_device(_: type, tokens: Sequence[Token]) -> str:
    return choose_device(tokens[0].value)


def _spaced(values: Any) -> str:
    return " ".join(map(str, values))


People = Annotated[
    range,
    Parameter(
        converter=_read_range,
        n_tokens=2,
        show_default=lambda people: f"{people[0]} {people[-1]}",
        help="First and last of PartBench's people.",
    ),
]
Levels = Annotated[
    tuple[str, ...],
    Parameter(
        show_default=_spaced,
        validator=lambda _, levels: check_levels(levels),
        help="Levels of PartBench, such as realistic.",
    ),
]
Device = Annotated[
    str,
    Parameter(converter=_read_device, n_tokens=1, help="cpu or cuda; auto takes CUDA where there is some."),
]
Settings = Annotated[
    tuple[str, ...],
    Parameter(
        name="--set",
        show_default=False,
        help="Settings of a fit, NAME=VALUE, as `partdr fit --set` takes them.",
    ),
]
Counts = Annotated[tuple[int, ...], Parameter(show_default=_spaced)]
Numbers = Annotated[tuple[float, ...], Parameter(show_default=_spaced)]
Names = Annotated[tuple[str, ...], Parameter(show_default=False)]
Jobs = Annotated[int, Parameter(validator=Number(gte=1), help="Fits at a time, in processes of their own.")]
NetworkFile = Annotated[
    str | None,
    Parameter(name="--network", help="File of `partdr train`; default: the packaged network."),
]
Mocap = Annotated[
    Path, Parameter(help="Folder of motion capture, or a pose bank made of one, as `partdr train` takes it.")
]


def with_setting(options: FitOptions, setting: str) -> FitOptions:
    """Options of a fit after one NAME=VALUE.

    Raises:
        InputError: If it is no NAME=VALUE, or the options don't have it.
    """
    values: dict[str, Any] = {}
    set_value(values, setting)
    return change_options(options, values)


def tracked(items: Sequence[Item], what: str = "people") -> Iterable[Item]:
    """Pass items on, with a bar on stderr if that is a terminal."""
    console = Console(stderr=True)
    return track(items, what, console=console, transient=True, disable=not console.is_terminal)
