"""A user's installation: everything in the wheel, and a light import."""

from __future__ import annotations

import ast
import importlib
import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
import zipfile
from configparser import ConfigParser
from email.parser import Parser
from itertools import chain
from pathlib import Path

import pytest
from packaging.version import Version

import warp_partdr

ROOT = Path(__file__).resolve().parents[2]
# Folder at the top of the repository: where it lies in the package.
SOURCES = {
    "warp_partdr": "warp_partdr",
    "kernels": "warp_partdr/kernels",
    "body": "warp_partdr/body",
    "demos/viewer": "warp_partdr/viewer",
}
# Loaded only when a feature needs it; the plain import starts not even torch and Warp.
EXTRAS = set(
    "PIL accelerate anny av matplotlib pxr pyvista rich safetensors scipy tensorboard transformers trimesh typer vtk "
    "vtkmodules".split()
)

LAZY_FACES = ("warp_partdr", "warp_partdr.benchmark", "warp_partdr.plot")

pytestmark = pytest.mark.skipif(not (ROOT / "pyproject.toml").exists(), reason="needs the repository around the tests")


def _source_files() -> set[str]:
    """The path in the wheel of each file below the source folders."""
    return {
        f"{target}/{path.relative_to(ROOT / folder).as_posix()}"
        for folder, target in SOURCES.items()
        for path in (ROOT / folder).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> zipfile.ZipFile:
    """The wheel, built from a copy: a build folder left in the tree can't bring back files that are gone."""
    copy, out = tmp_path_factory.mktemp("source"), tmp_path_factory.mktemp("wheel")
    for name in ("pyproject.toml", "setup.py", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, copy)
    for folder in SOURCES:
        shutil.copytree(ROOT / folder, copy / folder, ignore=shutil.ignore_patterns("__pycache__"))
    build = "import sys; from setuptools import build_meta; print(build_meta.build_wheel(sys.argv[1]))"
    done = subprocess.run([sys.executable, "-c", build, out], cwd=copy, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    (path,) = out.glob("*.whl")
    return zipfile.ZipFile(path)


def test_every_python_folder_is_a_package_and_listed() -> None:
    listed = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["packages"]
    files = _source_files()
    folders = {path.rpartition("/")[0] for path in files if path.endswith(".py")}
    assert sorted(listed) == sorted(folder.replace("/", ".") for folder in folders), "pyproject.toml: packages"
    assert [folder for folder in sorted(folders) if f"{folder}/__init__.py" not in files] == []


def test_the_source_files_are_in_the_wheel_and_nothing_else(wheel: zipfile.ZipFile) -> None:
    assert {name for name in wheel.namelist() if ".dist-info/" not in name} == _source_files()
    assert {"warp_partdr/assets/example/photo.png", "warp_partdr/py.typed"} < _source_files()


def test_the_wheels_metadata_is_complete(wheel: zipfile.ZipFile) -> None:
    (folder,) = {name.partition("/")[0] for name in wheel.namelist() if ".dist-info/" in name}
    metadata = Parser().parsestr(wheel.read(f"{folder}/METADATA").decode())
    assert metadata["Version"] == warp_partdr.__version__
    assert metadata["License-Expression"] == "Apache-2.0"
    shown, readme = metadata.get_payload(), (ROOT / "README.md").read_text()
    assert metadata["Description-Content-Type"] == "text/markdown"
    for kept in (r"\]\(https:.*?\)", r"```.*?```", r"^#[^\n]*", r"^\|[^\n]*?\|"):
        found = re.findall(kept, shown, re.M | re.S)
        assert found == re.findall(kept, readme, re.M | re.S) != []
    assert len(re.findall(r"\]\(", shown)) == len(re.findall(r"\]\(https:", shown))  # an index has no files
    assert f"{folder}/licenses/LICENSE" in wheel.namelist()
    scripts = ConfigParser()
    scripts.read_string(wheel.read(f"{folder}/entry_points.txt").decode())
    module, _, function = scripts["console_scripts"]["partdr"].partition(":")
    assert callable(getattr(importlib.import_module(module), function))


def test_constraints_pin_every_direct_dependency() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    needed = [*project["dependencies"], *chain.from_iterable(project["optional-dependencies"].values())]
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    pinned = {line.partition("==")[0] for line in lines if "==" in line}
    assert sorted({re.split(r"[\[>]", name)[0] for name in needed} - pinned) == []


def test_the_oldest_versions_are_the_stated_ones() -> None:
    """The oldest Python has wheels for all of them. Ray, peers, USD and body models are left out."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    left_out = {"ray", "bodies", "peers", "usd", "dev", "docs", "release"}
    stated = [*project["dependencies"], *chain.from_iterable(extras[each] for each in sorted(set(extras) - left_out))]
    bounds = {name: Version(bound) for name, _, bound in (entry.partition(">=") for entry in stated)}
    lines = (ROOT / "constraints-oldest.txt").read_text().splitlines()
    pinned = {name: Version(pin) for name, found, pin in (line.partition("==") for line in lines) if found}
    assert pinned == bounds


@pytest.mark.parametrize(("environment", "quiet"), [({}, False), ({"CI": "true"}, True)], ids=["person", "ci"])
def test_a_person_sees_what_pip_does(environment: dict[str, str], quiet: bool, tmp_path: Path) -> None:
    clean = {name: value for name, value in os.environ.items() if name != "CI"}
    command = ["make", "--dry-run", "install", f"VENV={tmp_path / 'venv'}"]
    done = subprocess.run(command, env=clean | environment, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    installs = [line for line in done.stdout.splitlines() if "pip install" in line]
    assert installs
    assert all(("-qq" in line) is quiet for line in installs)


@pytest.mark.parametrize(
    ("code", "late"),
    [
        ("import warp_partdr", EXTRAS | {"numpy", "torch", "warp"}),
        ("import warp_partdr.benchmark, warp_partdr.plot", EXTRAS | {"numpy", "torch", "warp"}),
        ("import warp_partdr as p\nfor name in p.__all__: getattr(p, name)", EXTRAS),
    ],
)
def test_imports_are_light_and_compile_nothing(code: str, late: set[str], tmp_path: Path) -> None:
    cache = tmp_path / "kernels"
    cache.mkdir()
    done = subprocess.run(
        [sys.executable, "-c", f"import json, sys\n{code}\nprint(json.dumps(list(sys.modules)))"],
        env={**os.environ, "WARP_CACHE_PATH": str(cache)},
        cwd=tmp_path,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert [path for path in cache.rglob("*") if path.is_file()] == [], "a kernel was compiled"
    loaded = {name.partition(".")[0] for name in json.loads(done.stdout.splitlines()[-1])}
    assert sorted(loaded & late) == []


def test_every_public_name_is_there_and_no_submodule_hides_one() -> None:
    for name in warp_partdr.__all__:
        assert getattr(warp_partdr, name) is not None
    assert dir(warp_partdr) == warp_partdr.__all__  # whatever is loaded by now
    modules = {path.stem for path in (ROOT / "warp_partdr").glob("*.py")} | {"body", "kernels"}
    assert sorted(modules & set(warp_partdr.__all__)) == []


@pytest.mark.parametrize("face", LAZY_FACES)
def test_a_name_that_is_not_public_is_an_error(face: str) -> None:
    module = importlib.import_module(face)
    assert dir(module) == module.__all__
    with pytest.raises(AttributeError, match=f"module '{face}' has no attribute 'no_such_name'"):
        _ = module.no_such_name


@pytest.mark.parametrize("face", LAZY_FACES)
def test_type_checkers_see_the_names_that_users_see(face: str) -> None:
    """The imports under TYPE_CHECKING and the table of lazy names are the same."""
    tree = ast.parse(Path(importlib.import_module(face).__file__ or "").read_text())
    (block,) = [node for node in tree.body if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"]
    seen = {
        alias.asname: node.module for node in block.body if isinstance(node, ast.ImportFrom) for alias in node.names
    }
    assert seen == importlib.import_module(face)._EXPORTS
