"""``partdr`` as users ask it: help, version, and lines of arguments that make no sense."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from conftest import HANG
from helpers import commands
from helpers.commands import ALONE, EVERY_FILE, GOOD, Run

from warp_partdr import FitOptions, InputError, RendererEllipsoids, RendererMesh, __version__
from warp_partdr.__main__ import start
from warp_partdr.body.labels import LABEL_SETS
from warp_partdr.body.skeletons import SKELETONS
from warp_partdr.cli import fit_request
from warp_partdr.solve.ellipsoids import fitting
from warp_partdr.solve.ellipsoids.stages import STAGES, Stage
from warp_partdr.solve.mesh.mesh_options import MeshOptions

files, run = commands.files, commands.run  # fixtures
AUTO = "triangles.subdivisions=auto"


class _Interrupted(ModuleType):
    """A module whose names can't be fetched, because the user presses Ctrl-C meanwhile."""

    def __getattr__(self, name: str) -> Any:
        if name == "run":
            raise KeyboardInterrupt
        raise AttributeError(name)


def test_an_interruption_of_the_imports_is_quiet(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "warp_partdr.cli.main", _Interrupted("warp_partdr.cli.main"))
    with pytest.raises(SystemExit) as left:
        start()
    assert left.value.code == 130


def test_help_teaches(run: Run) -> None:
    code, said, complaint = run("--help", COLUMNS="100")
    assert (code, complaint) == (0, "")
    assert "fit" in said
    assert run("", COLUMNS="100") == (0, said, "")
    code, said, complaint = run("fit --help", COLUMNS="100")
    assert (code, complaint) == (0, "")
    assert "Usage: partdr fit [OPTIONS] [PHOTO]" in said
    assert '{"format": "coco17", "keypoints": [[x, y, confidence], ...]}' in said  # not taken for markup
    for name in (*LABEL_SETS, *SKELETONS, *EVERY_FILE, "--parts", "--person", "--model", "Example"):
        assert name in said, name
    lines = said.splitlines()
    assert max(map(len, lines)) <= 100


def test_the_version_is_printed(run: Run) -> None:
    assert run("--version") == (0, f"partdr {__version__}\n", "")


def test_commands_of_commands_are_told(run: Run) -> None:
    code, said, complaint = run("bench")
    assert (code, complaint) == (2, "partdr: no command; see partdr bench --help\n")
    assert "kernels" in said


@pytest.mark.parametrize("line", ["fit --help", "--version"])
def test_help_is_quick(line: str, tmp_path: Path) -> None:
    """It loads none of the large packages."""
    heavy = {"torch", "warp", "pyvista", "PIL", "trimesh", "matplotlib"}
    code = (
        f"import sys; sys.argv = ['partdr', *{line.split()}]\nfrom warp_partdr.cli.main import main\n"
        f"try: main()\nexcept SystemExit as left: sys.exit(left.code or repr({heavy} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path, timeout=HANG)
    assert done.stderr.strip() == "set()"


def test_a_process_ends_with_its_code_and_all_that_it_said(tmp_path: Path) -> None:
    """It leaves without freeing what it had, but not before what others asked Python to do at the end."""
    code = (
        "import atexit, sys\nfrom warp_partdr.cli.main import run\n"
        "atexit.register(lambda: print('done at the end'))\nrun()"
    )
    for line, returned, says in (("--version", 0, f"partdr {__version__}"), ("fit --nonsense", 2, "--nonsense")):
        command = [sys.executable, "-c", code, *line.split()]
        done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, timeout=HANG)
        assert done.returncode == returned
        assert says in done.stdout + done.stderr
        assert done.stdout.endswith("done at the end\n")
    module = [sys.executable, "-m", "warp_partdr", "--version"]
    assert subprocess.run(module, capture_output=True, timeout=HANG).returncode == 0


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("fit", "--keypoints"),
        ("fit --keypoints", "--keypoints"),
        ("fit --keypoints k.json --nonsense", "--nonsense"),
        ("fit --keypoints k.json --person first", "--person"),
        ("fit photo.png --person -1", "--person: -1; expected 0 or more"),
        ("evaluate partbench --mocap clips", "--mocap: clips, without --level clip; expected both"),
        ("fit --keypoints k.json --set seed=1.5", "seed: 1.5; expected a whole number"),
        ("fit a.png b.png --keypoints k.json", "b.png"),
        ("fti", "fti"),
        ("fit --keypoints k.json --set triangles=dots", "triangles: 'dots'; expected a table"),
        ("fit --keypoints k.json --set mesh=true", "mesh: True; expected a table of the mesh stage (ellipsoids"),
        ("fit --keypoints k.json --set mesh.apart=-1", "mesh.apart: -1.0; expected 0 or a positive number"),
        ("fit --keypoints k.json --set mesh.vertices=9", "mesh.vertices: 9; expected an integer of 240 or more"),
        ("fit --keypoints k.json --set mesh.vertices=many", "mesh.vertices: 'many'; expected 'auto'"),
        ("fit --keypoints k.json --set mesh.clothes=no", "mesh.clothes: 'no'; expected a number"),
        ("fit --keypoints k.json --set mesh.size=96", "mesh: settings of a stage that needs part labels"),
        ("fit --keypoints k.json --set threads=-1", "threads: -1; expected 0 or more"),
        ("fit photo.png --set threads=some", "threads: 'some'; expected 0 or more"),
        ("scene photo.png p.png --set min_score=0.5", "min_score: 0.5, as a setting; expected the option --min-score"),
        ("fit --keypoints k.json --set outline=labels-first --set triangles=true", "labels-first"),
        (
            "fit --keypoints k.json --set outline=thick",
            "outline: 'thick'; expected true, false, a table or 'labels-first'",
        ),
        (
            "fit --keypoints k.json --set triangles.subdivisions=4",
            "triangles.subdivisions: 4; expected 0 to 3, or auto",
        ),
        ("fit --keypoints k.json --set triangles.tolerance=1", "triangles.tolerance: 1.0"),
        (
            "fit --keypoints k.json --set triangles.subdivisions=auto --set triangles.tolerance=0",
            "triangles.tolerance: 0.0",
        ),
        ("fit --keypoints k.json --set start=search", "start: unknown; expected one of stages, weights, "),
        ("fit --keypoints k.json --set finish.size=64", "finish: unknown; expected one of stages, weights, "),
        ("fit --keypoints k.json --set labels.steps=3", "labels.steps: unknown; expected one of name, bodies, "),
        ("fit --keypoints k.json --set labels.size=-1", "labels.size: -1; expected an integer from 0 to "),
        ("fit --keypoints k.json --set weights.prior=-1", "weights.prior: -1.0; expected 0 or a positive number"),
        ("fit --keypoints k.json --set labels.weights.seg=nan", "labels.weights.seg: nan; expected 0 or a positive"),
        ("fit --keypoints k.json --set labels.frozen=['hips']", "labels.frozen: ['hips']; expected some of"),
        ("fit --keypoints k.json --set labels.renderer.samples_per_pixel=0", "labels.renderer.samples_per_pixel: 0.0"),
        ("fit --keypoints k.json --set labels.weights.seg=much", "labels.weights.seg: 'much'; expected a number"),
        ("fit --keypoints k.json --set search.end.size=64", "search.end: unknown; expected one of lift, "),
        ("fit --keypoints k.json --set seed", "--set: seed; expected key=value"),
        ("fit --keypoints k.json --config none.toml", "none.toml: No such file"),
        ("fit --keypoints k.json --config k.json", "k.json: "),
        ("fit --keypoints k.json --start search --set network=own.safetensors", "network: own.safetensors, with"),
        ("register body.npz --labels cdcl14", "--labels: cdcl14, without part labels; expected --parts with it"),
        ("demo --profile --keypoints k.json --labels cdcl14", "--labels: cdcl14, without part labels; expected --par"),
        ("demo --profile --set speed=2", "speed: unknown; expected one of supervision, "),
    ],
)
def test_usage_errors_are_one_line(line: str, says: str, run: Run, files: Path) -> None:
    code, said, complaint = run(line)
    assert (code, said) == (2, "")
    assert complaint.startswith("partdr: ")
    assert complaint.count("\n") == 1
    assert says in complaint


@pytest.fixture
def options_of(run: Run, files: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], FitOptions]:
    """Options that reach the fit from a line of arguments."""
    seen: list[FitOptions] = []

    def fit_body(*_: Any, options: FitOptions, **__: Any) -> None:
        seen.append(options)
        raise InputError("enough")

    monkeypatch.setattr(fitting, "fit_body", fit_body)

    def call(line: str) -> FitOptions:
        assert run(f"fit {GOOD} {ALONE} {line}")[2] == "partdr: enough\n"
        return seen[-1]

    return call


def test_triangles_reach_the_fit(options_of: Callable[[str], FitOptions]) -> None:
    settings = (
        "--set triangles.subdivisions=3",
        "--set triangles.subdivisions=auto --set triangles.tolerance=0.2",
        "--set triangles=true",
    )
    for setting, level, tolerance in zip(settings, (3, "auto", 1), (0.5, 0.2, 0.5), strict=True):
        usual, options = FitOptions.at("balanced", "search"), options_of(f"--start search {setting}")
        for stages, seen in ((usual.stages, options.stages), (usual.search, options.search)):
            reach = [stage.renderer.max_distance for stage in stages]
            assert [stage.renderer for stage in seen] == [RendererMesh(level, tolerance, each) for each in reach]
    assert options_of("--set labels.renderer.gradient=coverage").stages[1].renderer == RendererEllipsoids("coverage")


def test_no_lens_is_assumed_if_there_is_to_be_no_camera(options_of: Callable[[str], FitOptions]) -> None:
    assert options_of("").guess_camera
    assert not options_of("--focal none").guess_camera


def test_settings_reach_the_fit(options_of: Callable[[str], FitOptions]) -> None:
    Path("own.toml").write_text(
        "trust_background = true\nseed = 3\n[weights]\nprior = 5\n[outline.weights]\nseg = 2.0\n"
        '["lift"]\nbodies = 4\n[search."labels, fine"]\nsize = 64\n'
    )
    usual = FitOptions.at("accurate", "search").with_outline()

    def weighed(stage: Stage) -> Stage:  # also those that have weights of their own
        return stage if stage.weights is None else replace(stage, weights=replace(stage.weights, prior=5.0))

    last = weighed(usual.stages[-1])
    assert last.weights is not None
    expected = replace(
        usual,
        trust_background=True,
        seed=4,
        weights=replace(usual.weights, prior=5.0),
        stages=(
            replace(usual.stages[0], bodies=4, iterations=7),
            *usual.stages[1:-1],
            replace(last, weights=replace(last.weights, seg=2.0)),
        ),
        search=tuple(weighed(replace(each, size=64) if each.name == "labels, fine" else each) for each in usual.search),
    )
    labels_first = options_of("--set outline=labels-first --set weights.prior=5 --set labels.weights.prior=6")
    assert [stage.weights and stage.weights.prior for stage in labels_first.stages] == [None, 6.0, 5.0]
    labels = options_of("--set weights.prior=5 --set labels.weights.seg=2").stages[1].weights
    assert labels == replace(usual.weights, prior=5.0, seg=2.0)
    mesh = MeshOptions(apart=0.1, clothes=None, vertices=900)
    line = "--quality accurate --start search --config own.toml --set seed=4 --set lift.iterations=7"
    assert options_of(line) == expected
    given = "--set mesh.apart=0.1 --set mesh.clothes=none --set mesh.vertices=900"
    assert options_of(f"{given} --model anny").mesh == mesh
    assert options_of("--set mesh.vertices=auto --model anny").mesh == MeshOptions()


@pytest.mark.parametrize("quality", ["fast", "accurate"])
def test_the_outline_stage_is_chosen(quality: str, options_of: Callable[[str], FitOptions]) -> None:
    usual = FitOptions.at(quality)
    for setting, expected in (
        ("false", usual),
        ("true", usual.with_outline()),
        ("labels-first", usual.with_outline(labels_first=True)),
    ):
        assert options_of(f"--quality {quality} --set outline={setting}") == expected
    assert options_of("--set search=[]").search == ()


def test_names_of_options_are_those_of_the_stages(options_of: Callable[[str], FitOptions]) -> None:
    assert [each.value for each in fit_request.QualityName] == list(STAGES["network"])
    assert [each.value for each in fit_request.StartName] == list(STAGES)
    assert options_of("") == FitOptions.at("balanced")


def test_garbage_is_collected_late_at_first_and_then_more_often() -> None:
    """Imports and a fit of a photo make millions of objects that stay, and collections of them would take as long."""
    code = (
        "import gc\nfrom warp_partdr.cli import main as command\n"
        "def main():\n    print(gc.get_threshold()[0])\n    gc.collect()\n    gc.collect()\n"
        "    print(gc.get_threshold()[0], gc.get_freeze_count() > 1000)\n    raise SystemExit(0)\n"
        "command.main = main\ncommand.run()"
    )
    said = subprocess.check_output([sys.executable, "-c", code], text=True, timeout=HANG)
    assert said.split() == ["4000000", "100000", "True"]
