"""A fit imports no large package that it can do without: their imports would take longer than the fit."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from conftest import HANG
from helpers.files import EXAMPLE

HEAVY = {"torch._dynamo", "sympy", "scipy", "networkx", "trimesh", "matplotlib", "pyvista", "pandas", "transformers"}


@pytest.mark.parametrize(
    "given", [[], ["--keypoints", str(EXAMPLE / "keypoints.json"), "--parts", str(EXAMPLE / "parts.png"), "--labels"]]
)
def test_a_fit_imports_no_compiler_and_no_scipy(given: list[str], tmp_path: Path) -> None:
    line = ["partdr", "fit", str(EXAMPLE / "photo.png"), *given, *(["cdcl14"] if given else []), "--out", "out"]
    code = (
        f"import sys; sys.argv = {line}\nfrom warp_partdr.cli.main import main\n"
        f"try: main()\nexcept SystemExit as left: sys.exit(left.code or repr({HEAVY} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path, timeout=HANG)
    assert done.stderr.strip().splitlines()[-1] == "set()"
    assert any((tmp_path / "out").glob("**/detailed.glb"))
