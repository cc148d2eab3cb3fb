"""Fixtures of all tests: devices, seeds, Hypothesis profiles and the data beside the checkout."""

from __future__ import annotations

import os
import random
import subprocess
import sys
from dataclasses import dataclass
from functools import cache
from pathlib import Path

# The tests run in as many processes as there are cores: threads of torch that wait for one another, in these and in
# those that tests start, would take several times as long. Before torch is loaded.
os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
import pytest
import torch
import warp as wp
from hypothesis import settings

from warp_partdr.kernels import messages

wp.config.log_level = wp.LOG_WARNING

# Kernels compile within an example, so no example has a deadline. CI draws the same cases in every run.
settings.register_profile("developer", deadline=None)
settings.register_profile("ci", deadline=None, derandomize=True, print_blob=True)
settings.load_profile("ci" if os.environ.get("CI") else "developer")

# [s] limit of whatever a test waits for: only what hangs takes so long, however busy the machine is.
HANG = 1200

SHARED = Path(__file__).resolve().parents[2] / "shared"
DEVICES_VARIABLE = "PARTDR_TEST_DEVICES"


@cache
def _why_no_cuda() -> str:
    """Empty if both Warp and torch see a CUDA device, else which of them does not."""
    blind = [
        name
        for name, sees in (("Warp", wp.get_cuda_device_count() > 0), ("torch", torch.cuda.is_available()))
        if not sees
    ]
    return f"{' and '.join(blind)} see{'s' if len(blind) == 1 else ''} no CUDA device" if blind else ""


@cache
def _devices() -> tuple[str, ...]:
    """The devices to test on: those present, or exactly those that ``PARTDR_TEST_DEVICES`` lists ("cuda", "cpu,cuda").

    Raises:
        pytest.UsageError: If the variable lists a device that is not there: a run that was to test it must not pass.
    """
    wanted = os.environ.get(DEVICES_VARIABLE)
    if wanted is None:
        return ("cpu",) if _why_no_cuda() else ("cpu", "cuda")
    devices = tuple(name.strip() for name in wanted.split(","))
    for name in devices:
        if name not in ("cpu", "cuda"):
            raise pytest.UsageError(f"{DEVICES_VARIABLE}: {name!r}; expected cpu, cuda or cpu,cuda")
    if "cuda" in devices and _why_no_cuda():
        raise pytest.UsageError(f"{DEVICES_VARIABLE}: lists cuda, but {_why_no_cuda()}")
    return devices


def pytest_report_header() -> str:
    """Say in the first lines of a run what it covers."""
    why_not = "" if "cuda" in _devices() else f" (no cuda: {_why_no_cuda() or 'not listed in ' + DEVICES_VARIABLE})"
    return f"devices: {', '.join(_devices())}{why_not}; warp {wp.config.version}, torch {torch.__version__}"


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Run a test that asks for ``device`` once on every device."""
    if "device" in metafunc.fixturenames:
        metafunc.parametrize("device", _devices(), scope="session")


@pytest.fixture(autouse=True)
def _seeds() -> None:
    """Each test has the same global random numbers, whatever ran before."""
    random.seed(0)
    np.random.seed(0)  # noqa: NPY002  for code under test that draws from it; tests use ``rng``
    torch.manual_seed(0)


@pytest.fixture(autouse=True)
def _no_word_of_compiling(monkeypatch: pytest.MonkeyPatch) -> None:
    """Commands say the same on a machine that has compiled kernels before and on a new one."""
    monkeypatch.setattr(messages, "kernels_are_compiled", lambda: True)


@pytest.fixture
def rng() -> np.random.Generator:
    """A seeded generator."""
    return np.random.default_rng(0)


@pytest.fixture
def few_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    """Registrations take two steps where nothing else is asked for."""
    from warp_partdr.models import registration

    @dataclass(frozen=True)
    class FewSteps(registration.RegistrationOptions):
        iterations: int = 2

    monkeypatch.setattr(registration, "RegistrationOptions", FewSteps)


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder of photos and motion capture beside the checkout, which is not part of the repository."""
    if not SHARED.is_dir():
        pytest.skip(f"needs {SHARED.name}/ (photos, motion capture) beside the checkout")
    return SHARED


@pytest.fixture(scope="session")
def can_draw() -> None:
    """VTK ends the process where it finds no OpenGL at all, so another process tries."""
    code = "import pyvista; p = pyvista.Plotter(off_screen=True); p.add_mesh(pyvista.Sphere()); p.screenshot()"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=HANG)
    if done.returncode != 0:
        pytest.skip(f"VTK can't draw here: {done.stderr.strip().splitlines()[-1:]}")


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A current folder of its own."""
    monkeypatch.chdir(tmp_path)
