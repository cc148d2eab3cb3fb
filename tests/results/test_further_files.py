"""Detailed bodies as USD, read back by pxr, and as FBX by a stand-in for Blender."""

from __future__ import annotations

import json
import os
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import helpers.bodies
import numpy as np
import pytest
import torch
from helpers.skins import moving, read_glb, standing

from warp_partdr.errors import InputError
from warp_partdr.models.registration import Registered
from warp_partdr.results import further_files
from warp_partdr.results.further_files import FURTHER, check_formats, save_further
from warp_partdr.results.skinned_files import Poses

registered = helpers.bodies.registered  # a fixture

STAND_IN = """#!{python}
import json, os, pathlib, shutil, sys
pathlib.Path({log!r}).write_text(json.dumps(sys.argv[1:]))
source, target, rate = sys.argv[sys.argv.index("--") + 1:]
shutil.copy(source, {log!r} + ".glb")
if {fails}:
    print("Error: no such operator", file=sys.stderr)
    sys.exit(1)
pathlib.Path(target).write_bytes(b"Kaydara FBX Binary")
"""


def skinned(stage: Any, time: Any) -> np.ndarray:
    """Points of the mesh as UsdSkel shows them at a time."""
    from pxr import Usd, UsdGeom, UsdSkel, Vt

    root = UsdSkel.Root(stage.GetDefaultPrim())
    cache = UsdSkel.Cache()
    assert cache.Populate(root, Usd.PrimDefaultPredicate)
    (binding,) = cache.ComputeSkelBindings(root, Usd.PrimDefaultPredicate)
    skeleton = cache.GetSkelQuery(binding.GetSkeleton())
    (target,) = binding.GetSkinningTargets()
    points = UsdGeom.Mesh(target.GetPrim()).GetPointsAttr().Get()
    found = Vt.Vec3fArray(points)
    assert target.ComputeSkinnedPoints(skeleton.ComputeSkinningTransforms(time), found, time)
    return np.array(found)


@pytest.mark.parametrize("kind", ["usda", "usdz"])
def test_usd_shows_the_posed_body(registered: Registered, tmp_path: Path, kind: str) -> None:
    pxr = pytest.importorskip("pxr.Usd", reason="needs the extra 'usd'")
    from pxr import UsdGeom, UsdSkel

    assert save_further(registered, tmp_path / "detailed", [kind]) == [f"detailed.{kind}"]
    stage = pxr.Stage.Open(str(tmp_path / f"detailed.{kind}"))
    assert UsdGeom.GetStageUpAxis(stage) == "Y"
    assert UsdGeom.GetStageMetersPerUnit(stage) == 1.0
    assert not stage.HasAuthoredTimeCodeRange()
    expected = standing(registered, registered.detailed.vertices[0])
    assert np.abs(skinned(stage, pxr.TimeCode.Default()) - expected).max() < 1e-4
    assert abs(expected[:, 1].min()) < 1e-6
    skeleton = UsdSkel.Skeleton(stage.GetPrimAtPath("/body/skeleton"))
    assert list(skeleton.GetJointNamesAttr().Get()) == list(registered.model.joint_names)
    valid, why = UsdSkel.Topology(skeleton.GetJointsAttr().Get()).Validate()
    assert valid, why
    rest = registered.rest().joints[0].cpu().numpy()
    bound = np.array([np.array(each) for each in skeleton.GetBindTransformsAttr().Get()])
    np.testing.assert_allclose(bound[:, 3, :3], rest, atol=1e-6)
    # What rests is bound, so that tools which ignore the motion show no torn mesh.
    query = UsdSkel.Cache().GetSkelQuery(skeleton)
    at_rest = np.array([np.array(each) for each in query.ComputeJointSkelTransforms(pxr.TimeCode.Default(), True)])
    np.testing.assert_allclose(at_rest, bound, atol=1e-5)
    extent = np.array(UsdSkel.Root(stage.GetDefaultPrim()).GetExtentAttr().Get())
    assert (extent[0] < expected.min(0) + 0.2).all()
    assert (extent[1] > expected.max(0) - 0.2).all()


def test_a_motion_s_usd_has_the_poses_over_time(registered: Registered, tmp_path: Path) -> None:
    pxr = pytest.importorskip("pxr.Usd", reason="needs the extra 'usd'")
    poses = moving(registered)
    save_further(registered, tmp_path / "person0", ["usdz"], poses)
    stage = pxr.Stage.Open(str(tmp_path / "person0.usdz"))
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode(), stage.GetTimeCodesPerSecond()) == (0, 4, 10)
    shape = registered.shape[:1].expand(5, -1)
    bodies = registered.model.pose(shape, poses.rotations, poses.translation)
    lift = np.array([0.0, poses.lowest, 0.0])
    for time in range(5):
        expected = bodies.vertices[time].cpu().numpy() * [1.0, -1.0, -1.0] - lift
        assert np.abs(skinned(stage, pxr.TimeCode(time)) - expected).max() < 1e-4
    assert (bodies.vertices[0] - bodies.vertices[2]).abs().max() > 0.2


def test_a_motion_s_usd_has_the_poses_at_their_times(registered: Registered, tmp_path: Path) -> None:
    pxr = pytest.importorskip("pxr.Usd", reason="needs the extra 'usd'")
    poses = replace(moving(registered), times=3 + np.array([0.0, 0.1, 0.25, 0.3, 0.9]))
    save_further(registered, tmp_path / "person0", ["usda"], poses)
    stage = pxr.Stage.Open(str(tmp_path / "person0.usda"))
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode(), stage.GetTimeCodesPerSecond()) == (0, 9, 10)
    keys = stage.GetPrimAtPath("/body/skeleton/motion").GetAttribute("rotations").GetTimeSamples()
    assert keys == [0, 1, pytest.approx(2.5), 3, 9]


def stand_in(folder: Path, monkeypatch: pytest.MonkeyPatch, *, fails: bool = False) -> Path:
    """A command ``blender`` that logs its arguments, and where."""
    commands = folder / "commands"
    commands.mkdir()
    log = folder / "arguments.json"
    command = commands / "blender"
    command.write_text(STAND_IN.format(python=sys.executable, log=str(log), fails=fails))
    command.chmod(0o755)
    monkeypatch.setenv("PATH", f"{commands}{os.pathsep}{os.environ['PATH']}")
    return log


def test_blender_gets_poses_on_whole_frames(
    registered: Registered, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    written: list[Poses] = []
    write = further_files.glb
    monkeypatch.setattr(
        further_files, "glb", lambda body, poses, bare: written.append(poses) or write(body, poses, bare=bare)
    )
    stand_in(tmp_path, monkeypatch)
    poses = replace(moving(registered), times=np.array([0.0, 0.1, 0.25, 0.3, 0.5]))
    save_further(registered, tmp_path / "person0", ["fbx"], poses)
    np.testing.assert_allclose(written[0].times, np.arange(6) / 10)


def test_blender_makes_fbx_of_the_glb(registered: Registered, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    log = stand_in(tmp_path, monkeypatch)
    save_further(registered, tmp_path / "person0", ["fbx"], moving(registered))
    assert (tmp_path / "person0.fbx").read_bytes().startswith(b"Kaydara")
    arguments = json.loads(log.read_text())
    assert arguments[:4] == ["--background", "--factory-startup", "--python-exit-code", "1"]
    assert (arguments[4], arguments[6]) == ("--python-expr", "--")
    compile(arguments[5], "script", "exec")
    assert "import_scene.gltf(filepath=source)" in arguments[5]
    assert "export_scene.fbx(filepath=target" in arguments[5]
    assert arguments[8:] == [str(tmp_path / "person0.fbx"), "10.000000"]
    assert not Path(arguments[7]).exists()  # a temporary file
    document, _ = read_glb(Path(f"{log}.glb").read_bytes())
    assert len(document["animations"]) == 1


def test_faults_of_blender_are_told(registered: Registered, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stand_in(tmp_path, monkeypatch, fails=True)
    with pytest.raises(InputError, match="no such operator; expected Blender that writes FBX"):
        save_further(registered, tmp_path / "detailed", ["fbx"])


BPY_STAND_IN = """
import sys
from types import SimpleNamespace

data = SimpleNamespace(objects=[], actions=[])
context = SimpleNamespace(scene=SimpleNamespace(render=SimpleNamespace(fps=24, fps_base=1.0)))


def export(filepath, **how):
    with open(filepath, "wb") as file:
        file.write(b"Kaydara by bpy")


ops = SimpleNamespace(
    import_scene=SimpleNamespace(gltf=lambda filepath: open(filepath, "rb").close()),
    export_scene=SimpleNamespace(fbx=export),
)
"""


def test_the_module_bpy_makes_fbx_where_there_is_no_blender(
    registered: Registered, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "bpy.py").write_text(BPY_STAND_IN)
    monkeypatch.setenv("PATH", "")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    check_formats("--to", ["fbx"])
    save_further(registered, tmp_path / "person0", ["fbx"])
    assert (tmp_path / "person0.fbx").read_bytes() == b"Kaydara by bpy"
    (tmp_path / "bpy.py").write_text("raise ImportError('numpy is too new')")
    with pytest.raises(InputError, match="fbx: bpy: ImportError: numpy is too new; expected Blender"):
        save_further(registered, tmp_path / "person1", ["fbx"])


def test_what_cannot_be_written_is_told_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "")
    monkeypatch.setattr("warp_partdr.results.further_files.find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"--to: fbx: no command 'blender' and no module 'bpy'.*or pip install bpy"):
        check_formats("--to", ["fbx"])
    monkeypatch.setitem(sys.modules, "pxr", None)
    with pytest.raises(InputError, match="--to: usdz: USD needs usd-core: pip install 'usd-core"):
        check_formats("--to", ["usdz"])
    with pytest.raises(InputError, match=f"also: 'stl'; expected of {', '.join(FURTHER)}"):
        check_formats("also", ["stl"])


def test_formats_come_from_settings(monkeypatch: pytest.MonkeyPatch) -> None:
    from warp_partdr.cli.options import BodyFormat, take_formats

    monkeypatch.setattr("warp_partdr.results.further_files.check_formats", lambda option, formats: None)
    values: dict[str, Any] = {"also": "usdz, fbx,usdz", "threads": 1}
    assert take_formats(values) == ("usdz", "fbx")
    assert values == {"threads": 1}
    assert take_formats({"also": ["usda"]}) == ("usda",)
    assert take_formats({}) == ()
    with pytest.raises(InputError, match="also: 3; expected of usda, usdz, fbx"):
        take_formats({"also": 3})
    assert [each.value for each in BodyFormat] == list(FURTHER)


def test_every_weight_is_in_usd(registered: Registered) -> None:
    from warp_partdr.results.binding import Binding

    weights = registered.model.skin_weights.cpu()
    binding = Binding.of(registered)
    dense = torch.zeros(weights.shape, dtype=torch.float64)
    dense.scatter_add_(1, torch.from_numpy(binding.bones), torch.from_numpy(binding.shares))
    assert (dense - weights.double()).abs().max() < 1e-6
