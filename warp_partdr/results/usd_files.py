"""Detailed bodies as USD (UsdSkel): skinned and posed, or animated for a motion. This needs the extra ``usd``.

Lengths are in metres, y is up, and bodies stand on y = 0, as in ``skinned_files``. The file holds every weight of the
model.
"""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from ..errors import InputError, install_command
from ..models.model import DetailedModel
from ..models.normals import vertex_normals
from ..models.registration import Registered
from .binding import Binding, numbers_of, to_quaternions
from .ellipbody_files import GLTF_FROM_CAMERA
from .skinned_files import BODY_MATERIAL, Poses

_WHOLE = 1e-6  # [frames]; times that are so near to a whole frame are rounded to it


def check_usd(name: str) -> None:
    """Raise an InputError, which begins with ``name``, if usd-core is not installed."""
    try:
        from pxr import Usd  # noqa: F401
    except ImportError as error:
        raise InputError(f"{name}: USD needs usd-core: {install_command('usd')}") from error


def save_usd(registered: Registered, path: Path, poses: Poses | None = None) -> None:
    """Write the first body, in its pose or in several over time, as .usda, .usdc or .usdz."""
    from pxr import Sdf, UsdUtils

    if path.suffix == ".usdz":
        with TemporaryDirectory() as folder:
            inner = Path(folder) / path.with_suffix(".usdc").name
            save_usd(registered, inner, poses)
            UsdUtils.CreateNewUsdzPackage(Sdf.AssetPath(str(inner)), str(path))
        return
    _stage(registered, path, poses or Poses.first(registered)).Save()


def _stage(registered: Registered, path: Path, poses: Poses) -> Any:
    from pxr import Usd, UsdGeom, UsdSkel

    model, binding = registered.model, Binding.of(registered)
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    root = UsdSkel.Root.Define(stage, "/body")
    stage.SetDefaultPrim(root.GetPrim())
    skeleton = _add_skeleton(stage, model, binding)
    times = _add_motion(stage, skeleton, registered, poses)
    _add_skin(stage, skeleton, model, binding)
    if len(times) > 1:
        stage.SetTimeCodesPerSecond(poses.rate)
        stage.SetFramesPerSecond(poses.rate)
        stage.SetStartTimeCode(times[0])
        stage.SetEndTimeCode(times[-1])
    extent = root.CreateExtentAttr()
    for time in times:
        code = Usd.TimeCode(time) if len(times) > 1 else Usd.TimeCode.Default()
        extent.Set(UsdGeom.Boundable.ComputeExtentFromPlugins(root, code), code)
    return stage


def _add_skeleton(stage: Any, model: DetailedModel, binding: Binding) -> Any:
    """Add the joints at rest, where they are also bound."""
    from pxr import Tf, UsdSkel, Vt

    paths: list[str] = []
    for name, parent in zip(model.joint_names, model.parents, strict=True):
        own = Tf.MakeValidIdentifier(name)
        paths.append(own if parent < 0 else f"{paths[parent]}/{own}")
    parents = np.array(model.parents)
    offsets = binding.joints - np.where(parents[:, None] < 0, 0.0, binding.joints[parents])
    skeleton = UsdSkel.Skeleton.Define(stage, "/body/skeleton")
    skeleton.CreateJointsAttr(paths)
    skeleton.CreateJointNamesAttr(list(model.joint_names))
    skeleton.CreateBindTransformsAttr(Vt.Matrix4dArray(_translations(binding.joints)))
    skeleton.CreateRestTransformsAttr(Vt.Matrix4dArray(_translations(offsets)))
    return skeleton


def _translations(offsets: np.ndarray) -> list[Any]:
    from pxr import Gf

    return [Gf.Matrix4d().SetTranslate(Gf.Vec3d(*offset.tolist())) for offset in offsets]


def _add_motion(stage: Any, skeleton: Any, registered: Registered, poses: Poses) -> list[float]:
    """Add the joints' rotations and positions over time; return their time codes, ``poses.rate`` a second."""
    from pxr import Gf, Usd, UsdSkel, Vt

    rotations, translation = poses.numbers()
    rotations = rotations.copy()
    # The root turns the body from the camera frame to the frame of the files.
    rotations[:, 0] = GLTF_FROM_CAMERA @ rotations[:, 0]
    standing = translation @ GLTF_FROM_CAMERA.T - [0.0, poses.lowest, 0.0]
    rest = numbers_of(registered.rest().joints)
    parents = np.array(registered.model.parents)
    offsets = rest - rest[np.maximum(parents, 0)]
    turns = to_quaternions(rotations)
    motion = UsdSkel.Animation.Define(stage, "/body/skeleton/motion")
    motion.CreateJointsAttr(skeleton.GetJointsAttr().Get())
    motion.CreateScalesAttr(Vt.Vec3hArray([Gf.Vec3h(1, 1, 1)] * len(parents)))
    codes = (poses.times - poses.times[0]) * poses.rate
    times: list[float] = np.where(np.abs(codes - codes.round()) < _WHOLE, codes.round(), codes).tolist()
    rotation_keys, translation_keys = motion.CreateRotationsAttr(), motion.CreateTranslationsAttr()
    for row, time in enumerate(times):
        code = Usd.TimeCode(time) if len(times) > 1 else Usd.TimeCode.Default()
        offsets[parents < 0] = standing[row]
        quaternions = [Gf.Quatf(w, x, y, z) for x, y, z, w in turns[row].tolist()]
        rotation_keys.Set(Vt.QuatfArray(quaternions), code)
        translation_keys.Set(Vt.Vec3fArray.FromNumpy(offsets.astype(np.float32)), code)
    UsdSkel.BindingAPI.Apply(skeleton.GetPrim()).CreateAnimationSourceRel().SetTargets([motion.GetPath()])
    return times


def _add_skin(stage: Any, skeleton: Any, model: DetailedModel, binding: Binding) -> None:
    from pxr import Gf, Sdf, UsdGeom, UsdShade, UsdSkel, Vt

    faces, points = model.faces.cpu().numpy(), binding.points.astype(np.float32)
    mesh = UsdGeom.Mesh.Define(stage, "/body/skin")
    mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(points))
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(len(faces), 3, np.int32)))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(faces.astype(np.int32).reshape(-1)))
    mesh.CreateNormalsAttr(Vt.Vec3fArray.FromNumpy(vertex_normals(binding.points, faces).astype(np.float32)))
    mesh.SetNormalsInterpolation(UsdGeom.Tokens.vertex)
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    mesh.CreateExtentAttr(Vt.Vec3fArray.FromNumpy(np.stack([points.min(0), points.max(0)])))
    bound, count = UsdSkel.BindingAPI.Apply(mesh.GetPrim()), binding.bones.shape[1]
    bound.CreateSkeletonRel().SetTargets([skeleton.GetPath()])
    bound.CreateGeomBindTransformAttr(Gf.Matrix4d(1.0))
    bones, shares = binding.bones.astype(np.int32).reshape(-1), binding.shares.astype(np.float32).reshape(-1)
    bound.CreateJointIndicesPrimvar(False, count).Set(Vt.IntArray.FromNumpy(bones))
    bound.CreateJointWeightsPrimvar(False, count).Set(Vt.FloatArray.FromNumpy(shares))

    material = UsdShade.Material.Define(stage, "/body/look")
    shader = UsdShade.Shader.Define(stage, "/body/look/surface")
    shader.CreateIdAttr("UsdPreviewSurface")
    colour, roughness = BODY_MATERIAL["baseColorFactor"][:3], BODY_MATERIAL["roughnessFactor"]
    shader.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f).Set(Gf.Vec3f(*colour))
    shader.CreateInput("roughness", Sdf.ValueTypeNames.Float).Set(roughness)
    material.CreateSurfaceOutput().ConnectToSource(shader.ConnectableAPI(), "surface")
    UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(material)
