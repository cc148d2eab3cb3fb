"""Docker images: what can be told of them without building them."""

from __future__ import annotations

import json
import re
import tomllib
from pathlib import Path
from typing import Any

import pytest
from test_packaging import SOURCES

ROOT = Path(__file__).resolve().parents[2]
FILES = ("Dockerfile", "Dockerfile.cuda")
PAGE = ROOT / "docs" / "how_to" / "docker.md"

pytestmark = pytest.mark.skipif(not (ROOT / "Dockerfile").exists(), reason="needs the repository around the tests")


def instructions(name: str) -> list[tuple[str, str]]:
    """Instructions of a Dockerfile with their arguments, without comments and line breaks."""
    text = re.sub(r"(?m)^#.*\n", "", (ROOT / name).read_text()).replace("\\\n", " ")
    parts = (line.partition(" ") for line in text.splitlines() if line.strip())
    return [(word, re.sub(r"\s+", " ", rest).strip()) for word, _, rest in parts]


def project() -> dict[str, Any]:
    return tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]


def test_the_build_sees_what_the_wheel_needs_and_nothing_else() -> None:
    lines = (ROOT / ".dockerignore").read_text().splitlines()
    rules = [line for line in lines if not line.startswith("#")]
    assert rules[0] == "*"
    assert rules[-1] == "**/__pycache__"
    kept = {rule.removeprefix("!") for rule in rules[1:-1]}
    assert kept == {"pyproject.toml", "setup.py", "README.md", "LICENSE", "constraints.txt", *SOURCES}
    assert [name for name in sorted(kept) if not (ROOT / name).exists()] == []


@pytest.mark.parametrize("name", FILES)
def test_an_image_is_made_of_files_that_are_there_by_pinned_versions(name: str) -> None:
    steps = instructions(name)
    copied = {rest.split()[0] for word, rest in steps if word == "COPY" and "--from" not in rest}
    assert copied == {".", "constraints.txt"}
    installs = [part for word, rest in steps if word == "RUN" for part in rest.split(" && ") if "pip install" in part]
    assert len(installs) == 2
    assert all("--constraint constraints.txt" in each for each in installs)
    stages = [rest for word, rest in steps if word == "FROM"]
    assert len(stages) == 2
    (version,) = {version for stage in stages for version in re.findall(r"^python:(\d\.\d+)-slim-\w+\b", stage)}
    assert f"Programming Language :: Python :: {version}" in project()["classifiers"]
    (extras,) = (rest.partition("=")[2] for word, rest in steps if word == "ARG" and rest.startswith("EXTRAS="))
    assert set(extras.split(",")) <= set(project()["optional-dependencies"])


@pytest.mark.parametrize("name", FILES)
def test_an_image_runs_the_command_as_a_user_who_is_not_root(name: str) -> None:
    steps = dict(instructions(name))  # the last of each kind counts
    assert json.loads(steps["ENTRYPOINT"]) == list(project()["scripts"])
    assert steps["USER"] not in ("", "root", "0")
    assert f"useradd {steps['USER']}" in steps["RUN"]
    assert steps["WORKDIR"] == "/data"
    assert "WARP_CACHE_PATH=/cache" in steps["ENV"]


def test_the_images_differ_in_what_a_gpu_needs_alone() -> None:
    cpu, cuda = (instructions(name) for name in FILES)
    assert [step for step in cpu if step not in cuda] == [("ARG", "PIP_EXTRA_INDEX_URL")]
    assert [word for word, rest in cuda if (word, rest) not in cpu] == ["ENV"]


def test_the_page_shows_the_commands_of_the_files() -> None:
    page = PAGE.read_text()
    for name in FILES:
        commands = re.findall(r"(?m)^#   (docker .*)$", (ROOT / name).read_text())
        assert len(commands) == 2
        assert [command for command in commands if command not in page] == []
        declared = {rest.partition("=")[0] for word, rest in instructions(name) if word == "ARG"}
        assert set(re.findall(r"--build-arg (\w+)", commands[0])) <= declared
