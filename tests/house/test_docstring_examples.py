"""Examples in docstrings: each public name has one, and each runs and gives the results that it shows.

An example is the section "Examples:" of a docstring. It runs in a folder with the photo, keypoints and part labels of
the packaged example. What takes long to make is given by name, where the words before the code speak of it.
"""

from __future__ import annotations

import ast
import doctest
import importlib
import importlib.util
import inspect
import re
import shutil
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.checkpoints import class_names, knowing_vitpose, tiny_segformer
from helpers.files import EXAMPLE, save_npz
from helpers.rigs import FRAMES, moving_film, swinging

import warp_partdr
from warp_partdr import benchmark
from warp_partdr.interop.torch_threads import one_torch_thread
from warp_partdr.networks.detection.film_people import row_keypoints
from warp_partdr.results.film_file import write_film

FACES = ("warp_partdr", "warp_partdr.benchmark", "warp_partdr.metrics", "warp_partdr.plot")
LATE = 6  # frames by which one of two films began later
CAMERAS = """
[left]
size = [640, 480]
matrix = [[600.0, 0.0, 320.0], [0.0, 600.0, 240.0], [0.0, 0.0, 1.0]]
distortions = [0.0, 0.0, 0.0, 0.0]
rotation = [0.0, 0.0, 0.0]
translation = [0.0, 0.0, 0.0]

[right]
size = [640, 480]
matrix = [[600.0, 0.0, 320.0], [0.0, 600.0, 240.0], [0.0, 0.0, 1.0]]
distortions = [0.0, 0.0, 0.0, 0.0]
rotation = [0.0, -1.2, 0.0]
translation = [3.0, 0.0, 2.0]
"""
NEEDED = {"make_dataset": "pyarrow", "walk.mp4": "av", "vitpose": "transformers", "segformer": "transformers"}


def docstrings() -> dict[str, str]:
    """Docstring of each public name, with its face, and of the members of classes that have an example."""
    found: dict[str, str] = {}
    for face in FACES:
        module = importlib.import_module(face)
        names = [name for name in module.__all__ if not name.startswith("_")]
        where = getattr(module, "_EXPORTS", dict.fromkeys(names, face.partition(".")[2]))
        for name in names:
            texts = docstrings_of(f"warp_partdr.{where[name]}")
            found |= {f"{face}.{each}": text for each, text in texts.items() if each == name}
            members = {each: text for each, text in texts.items() if each.startswith(f"{name}.")}
            found |= {f"{face}.{each}": text for each, text in members.items() if example_in(text)}
    return found


@cache
def docstrings_of(module: str) -> dict[str, str]:
    """Docstrings of a module's functions, classes and their members, and strings below constants, by name."""
    spec = importlib.util.find_spec(module)
    assert spec is not None
    assert spec.origin is not None
    body = ast.parse(Path(spec.origin).read_text(encoding="utf-8")).body
    found: dict[str, str] = {}
    for node, following in zip(body, [*body[1:], None], strict=True):
        if isinstance(node, ast.Assign | ast.AnnAssign):
            target = node.targets[0] if isinstance(node, ast.Assign) else node.target
            match following:
                case ast.Expr(value=ast.Constant(value=str(text))):
                    found[ast.unparse(target)] = inspect.cleandoc(text)
        elif isinstance(node, ast.FunctionDef | ast.ClassDef):
            found[node.name] = ast.get_docstring(node) or ""
            for member in node.body if isinstance(node, ast.ClassDef) else ():
                if isinstance(member, ast.FunctionDef):
                    found[f"{node.name}.{member.name}"] = ast.get_docstring(member) or ""
    return found


def example_in(docstring: str) -> str:
    """The section "Examples:" of a docstring; "" if it has none with code."""
    section = re.search(r"(?ms)^Examples:\n(.*?)(?=^\S|\Z)", docstring)
    return inspect.cleandoc(section[1]) if section and ">>> " in section[1] else ""


DOCSTRINGS = docstrings()
PUBLIC = [f"{face}.{name}" for face in FACES for name in importlib.import_module(face).__all__ if name[0] != "_"]


def test_each_public_name_has_an_example() -> None:
    assert len(PUBLIC) > 120
    assert [name for name in PUBLIC if not example_in(DOCSTRINGS.get(name, ""))] == []


def test_an_example_imports_what_it_shows_from_its_public_path() -> None:
    for path in PUBLIC:
        face, _, name = path.rpartition(".")
        code = "\n".join(re.findall(r"(?m)^(?:>>>|\.\.\.) (.*)$", example_in(DOCSTRINGS[path])))
        direct = re.search(rf"(?m)^from {re.escape(face)} import .*\b{name}\b", code)
        through = re.search(rf"(?m)^from warp_partdr import .*\b{face[12:]}\b", code) if face != "warp_partdr" else None
        assert direct or (through and f"{face[12:]}.{name}" in code), path


class Given:
    """Files and values that examples speak of, each made when it is first asked for."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        for name in ("photo.png", "keypoints.json", "parts.png"):
            shutil.copy(EXAMPLE / name, folder)
        self._values: dict[str, Any] = {}
        self._makers: dict[str, Callable[[], Any]] = {
            "parts": lambda: warp_partdr.read_parts("parts.png", "cdcl14"),
            "person": lambda: warp_partdr.read_keypoints("keypoints.json")[0],
            "result": self._fit,
            "mesh": lambda: warp_partdr.refine_mesh(self["result"]),
            "everyone": lambda: warp_partdr.fit_photo("photo.png"),
            "motion": self._fit_film,
            "early": lambda: moving_film(swinging(1.0), -0.5, range(FRAMES)),
            "late": lambda: moving_film(swinging(1.0), 0.6, range(LATE, FRAMES)),
            "left": lambda: self["matched"][0],
            "right": lambda: self["matched"][1],
            "matched": lambda: warp_partdr.match_films([self["early"], self["late"]], (LATE / 10, 0.0)),
            "seen_left": lambda: row_keypoints(self["left"].people.rows[0]),
            "seen_right": lambda: row_keypoints(self["right"].people.rows[0]),
            "views": self._views,
        }

    def __getitem__(self, name: str) -> Any:
        if name not in self._values:
            self._values[name] = self._makers[name]()
        return self._values[name]

    def named_in(self, words: str) -> dict[str, Any]:
        """Values whose names occur in the words before an example's code."""
        return {name: self[name] for name in self._makers if re.search(rf"\b{name}\b", words)}

    def make_files(self, example: str) -> None:
        """Make the files that an example names and that are not there yet."""
        makers: dict[str, Callable[[Path], object]] = {
            "walk.mp4": lambda path: write_film(path, [warp_partdr.read_photo("photo.png")] * 3, rate=10),
            "pictures": lambda path: (path.mkdir(), shutil.copy("photo.png", path)),
            "SMPL_NEUTRAL.npz": save_npz,
            "cameras.toml": lambda path: path.write_text(CAMERAS),
            "segformer": lambda path: tiny_segformer(path, class_names("atr18")),
            "vitpose": lambda path: knowing_vitpose(path, [(point % 16, point % 12) for point in range(17)]),
        }
        for name, make in makers.items():
            if re.search(rf"[\"`]{name}[\"`]", example) and not (self.folder / name).exists():
                make(self.folder / name)

    def _fit(self) -> warp_partdr.FitResult:
        result = warp_partdr.fit_body(self["person"], self["parts"])
        warp_partdr.save_fit(result, "fitted")
        return result

    def _fit_film(self) -> Any:
        return warp_partdr.fit_film([warp_partdr.ObservedFilm.of(warp_partdr.find_film_people("walk.mp4"))])

    def _views(self) -> benchmark.Views:
        samples = [benchmark.make_sample(index, "clean") for index in range(2)]
        joints = np.stack([sample.joints + np.array([0, 0, 4]) for sample in samples])
        return benchmark.Views(
            joint_names=np.array(samples[0].joint_names),
            joints_camera=joints,
            keypoints=1000 * joints[..., :2] / joints[..., 2:] + 500,
            person=np.array(["first", "second"]),
        )


@pytest.fixture(scope="module")
def given(tmp_path_factory: pytest.TempPathFactory) -> Given:
    return Given(tmp_path_factory.mktemp("examples"))


@pytest.mark.parametrize("name", [name for name, text in DOCSTRINGS.items() if example_in(text)])
def test_an_example_gives_what_it_shows(name: str, given: Given, monkeypatch: pytest.MonkeyPatch) -> None:
    example = example_in(DOCSTRINGS[name])
    for word, package in NEEDED.items():
        if word in example:
            pytest.importorskip(package, reason=f"needs {package}, of the extra test")
    monkeypatch.chdir(given.folder)
    given.make_files(example)
    words = example.partition(">>> ")[0]
    said: list[str] = []
    with one_torch_thread():
        test = doctest.DocTestParser().get_doctest(example, given.named_in(words), name, None, 0)
        doctest.DocTestRunner(optionflags=doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE).run(test, out=said.append)
    assert not said, "".join(said)
