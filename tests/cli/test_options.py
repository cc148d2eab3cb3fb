"""Dataclasses of options as parameters of commands, and settings of a run."""

from __future__ import annotations

import inspect
from dataclasses import dataclass
from pathlib import Path

import pytest

from warp_partdr import InputError
from warp_partdr.cli.options import SettingOptions, grouped


@dataclass(frozen=True)
class Lens:
    focal: float | None = None
    axis: str = "middle"


@dataclass(frozen=True, kw_only=True)
class Request:
    photo: Path
    lens: Lens
    out: Path = Path("out")


def test_options_of_dataclasses_within_a_request_stand_in_its_order() -> None:
    taken: list[Request] = []

    def command(request: Request) -> None:
        """Take it."""
        taken.append(request)

    run = grouped(command)
    parameters = inspect.signature(run).parameters
    assert list(parameters) == ["photo", "focal", "axis", "out"]
    assert parameters["photo"].default is inspect.Parameter.empty
    assert [parameters[name].default for name in ("focal", "axis", "out")] == [None, "middle", Path("out")]
    assert run.__doc__ == "Take it."
    run(photo=Path("a.jpg"), focal=35.0, axis="left", out=Path("b"))
    assert taken == [Request(photo=Path("a.jpg"), lens=Lens(35.0, "left"), out=Path("b"))]


def test_settings_of_a_run_are_apart_from_those_of_its_fit() -> None:
    run = SettingOptions(overrides=["threads=3", "mesh.iterations=5", "seed=1"]).read_run()
    assert (run.threads, run.formats) == (3, ())
    assert run.fit == {"mesh": {"iterations": 5}, "seed": 1}
    with pytest.raises(InputError, match="the option --min-score"):
        SettingOptions(overrides=["min_score=0.5"]).read_run()
