"""The thermometer counts what its docstring says, on a small house of its own."""

from __future__ import annotations

import ast
import runpy
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[2]

pytestmark = pytest.mark.skipif(not (ROOT / "pyproject.toml").exists(), reason="needs the repository around the tests")

FILES = {
    "pyproject.toml": '[tool.setuptools.package-dir]\nwarp_partdr = "warp_partdr"\n"warp_partdr.body" = "body"\n',
    "warp_partdr/__init__.py": '_EXPORTS = {"fit_body": "solve.fit", "pose": "body.pose"}\n__all__ = [*_EXPORTS]\n',
    "warp_partdr/metrics.py": '__all__ = ["evaluate"]\n',
    "warp_partdr/solve/__init__.py": '__all__ = ["not_public"]\n',
    "warp_partdr/solve/fit.py": "def f():\n    from ..body import pose\n    how = {'a': 1}\n    return pose(**how)\n",
    "warp_partdr/bench/__init__.py": "from warp_partdr.solve import fit\nimport warp_partdr.metrics\n",
    "body/__init__.py": "",
    "body/pose.py": "a, b = 1, 2\n\n\n",
    "scripts/measure.py": "1\n2\n3\n",
    "tests/test_it.py": "1\n2\n",
}


@pytest.fixture(scope="module")
def thermometer() -> dict[str, Any]:
    return runpy.run_path(str(ROOT / "scripts" / "thermometer.py"))


@pytest.fixture
def house(thermometer: dict[str, Any], tmp_path: Path) -> Any:
    for name, text in FILES.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    return thermometer["House"](tmp_path)


def test_figures_of_a_small_house_are_counted(house: Any) -> None:
    assert house.figures() == {
        "product, lines": "11",
        "laboratory, lines": "5",
        "tests, lines": "2",
        "carriers of arguments": "1",
        "flagship calls that are public": "2 of 8",
        "public names": "3",
        "clever lines in a thousand": "153.8",  # two of 13 lines
        "rooms": "4",
        "floors": "3",
        "modules": "7",
        "arrows between rooms": "3",
    }


def test_arrows_are_of_imports_in_functions_too(house: Any) -> None:
    assert house.arrows == {("solve", "body"), ("bench", "solve"), ("bench", "metrics")}


def test_a_circle_of_rooms_is_told(house: Any) -> None:
    (house.root / "body" / "pose.py").write_text("from ..bench import start\n")
    with pytest.raises(SystemExit, match="a circle of rooms: bench, body, solve"):
        house.floors()


@pytest.mark.parametrize(
    ("code", "clever"),
    [
        ("a, b, c = f()", True),
        ("a, b = f()", False),
        ("a, b = 1, 2", True),
        ("a, b = (f(x) for x in y)", True),
        ("f(*(g(x) for x in y))", True),
        ("f(*rest)", True),
        ("return_ = f(g(**how))", True),
        ("f(*self.rest)", False),
        ("f(a, b=c)", False),
        ("for a, b, c in d:\n    pass", False),
        ("if a:\n    f(*rest)", True),
    ],
)
def test_clever_lines_are_recognised(thermometer: dict[str, Any], code: str, clever: bool) -> None:
    assert thermometer["count_clever"](ast.parse(code)) == clever
