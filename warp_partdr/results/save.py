"""Files that ``partdr fit`` and ``partdr register`` write, each as a set (``result_sets``)."""

from __future__ import annotations

import json
import platform
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
import warp as wp

from .. import __version__, metrics
from ..body.labels import BACKGROUND, IGNORE, LabelSet, label_set, regroup
from ..body.parameters import BodyParameters
from ..body.posing import LandmarkGather
from ..body.rotations import rotation_from_axis_angle
from ..body.template import JOINT_NAMES
from ..cameras import Camera, first_of, zoomed
from ..errors import check_type
from ..files.json_files import rounded
from ..inputs.evidence import Evidence
from ..inputs.keypoints import Keypoints2D, person_height
from ..inputs.part_labels import PartLabels
from ..interop.torch_threads import one_torch_thread
from ..models.clothes import CLOTHED
from ..models.measuring import BODY_MEASURES, measure_body
from ..models.model import detailed_mesh
from ..models.registration import Registered
from ..models.smpl_parameters import POSES, to_smplx
from ..models.suit import in_suit
from ..render.mesh import draw_mesh
from ..solve.confidence.judge import BodyConfidence, confidence_record, judge_fits
from ..solve.ellipsoids.result import FitResult
from .body_file import BodyFile
from .ellipbody_files import ellipbody_glb
from .fit_charts import loss_chart, panels
from .further_files import save_further
from .overlays import draw_detailed, draw_overlay, overlay_size, shade_for_overlay
from .palette import group_colours
from .png_files import save_png
from .result_sets import FIT_REPORT, PEOPLE_REPORT, REGISTRATION_REPORT, names_file, replacing
from .skinned_files import save_detailed
from .views import VIEWS, PlacedBody, draw_views

RESULT_FILES = ("body.npz", "body.json", "ellipbody.glb", "overlay.png", "parts.png", "loss.png", FIT_REPORT)
DETAILED_FILES = (*(f"detailed.{ending}" for ending in ("png", "glb", "obj", "ply", "bvh", "npz")), REGISTRATION_REPORT)
SMPLX_FILE = "detailed.smplx.npz"  # one more file, only for SMPL's models


@one_torch_thread()
def save_fit(
    result: FitResult,
    folder: str | Path,
    *,
    photo: np.ndarray | None = None,
    sources: Mapping[str, str | None] | None = None,
    mesh: Registered | None = None,
    confidence: BodyConfidence | None = None,
) -> dict[str, Any]:
    """Write body.npz, body.json, ellipbody.glb, overlay.png, parts.png, loss.png and report.json.

    Args:
        result: Result of ``fit_body``.
        folder: Folder for the files, made if it does not exist.
        photo: Picture, shape (H, W, 3), uint8; None: there is none. If there are labels, it may have been scaled down.
        sources: Names of the networks that found "keypoints" and "parts", for the report, as ``PhotoFit`` has them.
        mesh: Detailed body of the same person (``MeshFit.body``). Its stature and girths are added to body.json.
        confidence: Confidence in the body, for the report; None: that of ``judge_fits`` without a detector.

    Returns:
        Report, as report.json holds it.

    Raises:
        TypeError: If an argument has another type.

    Examples:
        After ``result = fit_body(person, parts)``:

        >>> from pathlib import Path
        >>> from warp_partdr import read_photo, save_fit
        >>> report = save_fit(result, "fitted", photo=read_photo("photo.png"))
        >>> bool(report["parts"]["part_f1"] > 0.7)
        True
        >>> sorted(path.name for path in Path("fitted").glob("body.*"))
        ['body.json', 'body.npz']
    """
    check_type("result", result, FitResult, "of fit_body")
    check_photo(photo)
    evidence = result.evidence
    size = image_size(evidence.keypoints, evidence.picture, photo)
    report = make_report(result) | confidence_record(confidence or judge_fits([result])[0])
    if sources is not None:
        report["sources"] = dict(sources)
    comparison = None
    if evidence.picture is not None:
        label_set = evidence.picture.label_set
        # A large picture is scored at a smaller size.
        zoom, scored = overlay_size(size)
        parts = result.draw(scored, camera=zoomed(result.camera, zoom, scored)).labels[0].cpu().numpy()
        drawn, target = label_set.part_groups[parts], evidence.target(scored)
        report |= score_labels(drawn, target, label_set)
        comparison = panels(target, drawn, group_colours(label_set.part_groups))
    overlay = draw_overlay(result, size, photo)
    # An older registration clothes another body. People of a photo, but not of a film, have an overlay of this name.
    outdates: tuple[str, ...] = (FIT_REPORT, REGISTRATION_REPORT)
    if names_file(Path(folder, PEOPLE_REPORT), "overlay.png"):
        outdates += (PEOPLE_REPORT,)
    with replacing(Path(folder), FIT_REPORT, report, outdates=outdates) as temporary:
        position = result.posed.joints[0, 0]
        body_file(result.parameters, result.camera, size, position).save(temporary / "body.npz")
        save_description(describe_body(result, mesh), temporary)
        (temporary / "ellipbody.glb").write_bytes(ellipbody_glb(result.posed))
        save_png(overlay, temporary / "overlay.png")
        if comparison is not None:
            save_png(comparison, temporary / "parts.png")
        save_png(loss_chart(result), temporary / "loss.png")
    return report


def check_photo(photo: np.ndarray | None) -> None:
    """Raise unless it is None or a picture, as ``read_photo`` returns it."""
    check_type("photo", photo, np.ndarray | None, "of read_photo")
    if photo is not None and (photo.dtype != np.uint8 or photo.ndim != 3 or photo.shape[2] != 3 or not photo.size):
        raise ValueError(f"photo: {photo.dtype} {photo.shape}; expected uint8 (H, W, 3), as of read_photo")


def image_size(keypoints: Keypoints2D, parts: PartLabels | None, photo: np.ndarray | None) -> tuple[int, int]:
    """Size (H, W) of the picture [px]; without photo and labels, a size that holds all keypoints."""
    for image in (None if parts is None else parts.groups, photo):
        if image is not None:
            return int(image.shape[0]), int(image.shape[1])
    width, height = np.ceil(keypoints.points[keypoints.visible].max(0) * 1.1 + 1).astype(int)
    return int(max(height, 1)), int(max(width, 1))


@one_torch_thread()
def save_registered(
    registered: Registered,
    folder: str | Path,
    camera: Camera,
    size: tuple[int, int],
    *,
    photo: np.ndarray | None = None,
    evidence: Evidence | None = None,
    clothes: torch.Tensor | None = None,
    formats: Sequence[str] = (),
    bare: bool = False,
    views: PlacedBody | None = None,
    shaded: np.ndarray | None = None,
    **about: Any,
) -> dict[str, Any]:
    """Write the first body as ``DETAILED_FILES``, and return the report.

    For SMPL, SMPL-H and SMPL-X, ``SMPLX_FILE`` is written, too. It holds the arguments of the ``smplx`` package, and
    the camera by the names of ``body.npz``. If parts grew, the model has no such body, and the file is not written.

    Args:
        registered: Registered bodies in the camera frame.
        folder: Folder for the files, made if it does not exist.
        camera: Camera of the picture.
        size: Size (H, W) of the picture [px].
        photo: Picture, shape (H, W, 3), uint8; None: there is none.
        evidence: Evidence of the person in that picture. If it has labels, the report has scores: "parts" for the bare
            meshes that are written and, if there are clothes, "parts_clothed" for the mesh in its clothes.
        clothes: Thicknesses of clothes on the parts ``CLOTHED`` [m], shape (1, 8), as the picture shows them. The
            meshes in the files have none, and the picture has their outline.
        formats: Formats in ``FURTHER``, for more files.
        bare: True draws and writes the skin. By default the picture and the meshes wear a plain T-shirt and shorts.
        views: Same body with its place before the camera, of which ``VIEWS`` is drawn, too; None: it is not drawn.
        shaded: Body for detailed.png, as ``shade_detailed`` draws it at the size of overlays; None: it is drawn.
        **about: Further entries of the report.

    Examples:
        After ``mesh = refine_mesh(result)``:

        >>> from pathlib import Path
        >>> from warp_partdr import save_registered
        >>> report = save_registered(mesh.body, "detailed", mesh.camera, (512, 384))
        >>> (Path("detailed") / "detailed.glb").exists()
        True
    """
    model = registered.model
    clothed = registered if clothes is None else replace(registered, detailed=registered.clothed(clothes))
    if views is not None:
        shaded = shade_for_overlay(views.surface, camera, size)
    picture = draw_detailed(registered, camera, size, photo, clothes=clothes, bare=bare, shaded=shaded)
    losses = {name: round(float(value[0]), 4) for name, value in registered.losses.items()}
    report: dict[str, Any] = {
        "model": model.name,
        "losses": losses,
        "measurements_cm": describe_mesh(registered),
        **about,
    }
    if clothes is not None:
        report["clothes_cm"] = {
            name: round(100 * thick, 1) for name, thick in zip(CLOTHED, clothes[0].tolist(), strict=True)
        }
    if evidence is not None and evidence.picture is not None:
        label_set = evidence.picture.label_set
        report |= _score_detailed(registered, evidence, label_set, camera, size)
        if clothes is not None:
            in_clothes = _score_detailed(clothed, evidence, label_set, camera, size)
            report |= {f"{name}_clothed": scores for name, scores in in_clothes.items()}
    with replacing(Path(folder), REGISTRATION_REPORT, report, outdates=(REGISTRATION_REPORT,)) as temporary:
        save_detailed(registered, temporary, bare=bare)
        save_further(registered if bare else in_suit(registered), temporary / "detailed", formats)
        save_detailed_arrays(registered, temporary, clothes)
        save_png(picture, temporary / "detailed.png")
        if views is not None:
            save_png(draw_views([views], size, photo), temporary / VIEWS)
        if model.name in POSES and bool((registered.growth[0] == 1).all()):
            smplx = to_smplx(model, registered.shape[:1], registered.rotations[:1], registered.translation[:1])
            of_smplx: dict[str, Any] = {**smplx, **camera_arrays(camera, size)}
            np.savez(temporary / SMPLX_FILE, **of_smplx)
    return report


def _score_detailed(
    body: Registered, evidence: Evidence, labels: LabelSet, camera: Camera, size: tuple[int, int]
) -> dict[str, Any]:
    """Score the first detailed body's mesh against the labels of a picture of (H, W) pixels."""
    zoom, scored = overlay_size(size)
    vertices = body.detailed.vertices[:1].detach()
    own_camera = zoomed(first_of(camera).to(vertices.device), zoom, scored)
    image = draw_mesh(vertices, detailed_mesh(body.model, labels.at_joints), own_camera, scored)
    return score_labels(labels.part_groups[image.labels[0].cpu().numpy()], evidence.target(scored), labels)


def save_detailed_arrays(registered: Registered, folder: Path, clothes: torch.Tensor | None) -> None:
    """Write detailed.npz: the first body's shape, pose and, if it has any, clothes."""
    tensors = {name: value for name, value in vars(registered).items() if isinstance(value, torch.Tensor)}
    tensors |= {} if clothes is None else {"clothes": clothes}
    numbers: dict[str, Any] = {name: value[0].cpu().numpy() for name, value in tensors.items()}
    np.savez(folder / "detailed.npz", model=np.array(registered.model.name), **numbers)


def body_file(
    parameters: BodyParameters, camera: Camera, size: tuple[int, int], position: torch.Tensor | None = None
) -> BodyFile:
    """Make the contents of ``body.npz`` from the first body and a camera of the full picture.

    Args:
        parameters: Parameters of the body.
        camera: Camera of the picture, with square pixels.
        size: Size (H, W) of the picture [px].
        position: Position of the pelvis in the frame of a perspective camera [m], shape (3,); None: weak perspective.
    """
    parameters = parameters.detach()
    numbers = {
        "global_orient": parameters.global_orient()[0],
        "translation": parameters.lengths.new_zeros(3) if position is None else position.detach(),
        "rotations": rotation_from_axis_angle(parameters.free_rotations())[0],
        "lengths": parameters.lengths[0],
        "thicknesses": parameters.thicknesses[0],
    }
    arrays = {name: value.cpu().numpy() for name, value in numbers.items()}
    return BodyFile(**arrays, **camera_arrays(camera, size))


def camera_arrays(camera: Camera, size: tuple[int, int]) -> dict[str, np.ndarray]:
    """Arrays of the first camera, which has square pixels, for a picture of (H, W) pixels, named as in ``body.npz``."""
    scale, _, *centre = camera.intrinsics[0].detach().cpu()
    return {
        "camera_scale": scale.numpy(),
        "camera_translation": torch.stack(centre).numpy(),
        "camera_perspective": np.array(int(camera.perspective)),
        "image_size": np.array(size),
    }


def describe_mesh(body: Registered) -> dict[str, float]:
    """Measure stature and girths of the first detailed body [cm]."""
    measures = measure_body(body.model, body.select(slice(1)).rest())[0]
    return {name: round(100 * value, 1) for name, value in zip(BODY_MEASURES, measures.tolist(), strict=True)}


def save_description(described: Mapping[str, Any], folder: Path) -> None:
    """Write body.json with the description that ``describe_body`` returns."""
    (folder / "body.json").write_text(json.dumps(described, indent=1) + "\n")


def describe_body(result: FitResult, mesh: Registered | None = None) -> dict[str, Any]:
    """Describe a body by measurements in cm and joint positions, for people and programs that don't read npz."""
    saved = body_file(result.parameters, result.camera, (1, 1))
    described = describe_posed(saved, result.posed.joints, result.camera, mesh, guessed=result.camera_guessed)
    if result.stature is not None:
        described["stature_given_cm"] = round(100 * result.stature, 1)
    return described


def describe_distance(result: FitResult) -> str:
    """Words about the lens for which a body's distance from the camera is right."""
    if not result.camera.perspective or result.camera_guessed:
        return "for an assumed lens"
    return "for a known focal length"


def describe_posed(
    saved: BodyFile,
    positions: torch.Tensor,
    camera: Camera,
    mesh: Registered | None = None,
    *,
    guessed: bool = False,
) -> dict[str, Any]:
    """Describe a body by measurements and joints.

    Args:
        saved: Body as ``body.npz`` holds it.
        positions: Positions of its joints in the camera frame [m], shape (1, 21, 3).
        camera: Camera of the full picture.
        mesh: Detailed body of the same person, whose stature and girths are added.
        guessed: True if the camera is not known, and a lens is assumed.
    """
    measured = saved.body("cpu").measure()
    joints = positions[0].detach().cpu().numpy()
    pixels = camera.project(positions)[0, :, :2].detach().cpu().numpy()
    scale, _, *centre = camera.intrinsics[0].detach().cpu().tolist()
    described: dict[str, Any] = {
        "measurements_cm": {name: round(100 * value, 1) for name, value in measured.items()}
        | ({} if mesh is None else describe_mesh(mesh)),
        "joints": {
            "frame": "camera: x right, y down, z away from the viewer; metres from the "
            + ("camera" if camera.perspective else "pelvis"),
            "names": list(JOINT_NAMES),
            "points_m": rounded(joints, 4),
            "pixels": rounded(pixels, 2),
        },
        "camera": {
            "model": "perspective: u = focal X / Z + principal[0], v = focal Y / Z + principal[1]",
            "focal_px": round(scale, 2),
            "principal_px": rounded(centre, 2),
        }
        if camera.perspective
        else {
            "model": "weak perspective: u = scale X + translation[0], v = scale Y + translation[1]",
            "scale_px_per_m": round(scale, 2),
            "translation_px": rounded(centre, 2),
        },
    }
    if guessed:
        described["camera"]["guessed"] = True
    return described


def make_report(result: FitResult) -> dict[str, Any]:
    """Report on a fit: losses, distance of the keypoints, times and warnings."""
    keypoints = result.evidence.keypoints
    confident = keypoints.confident
    names = [name for name, counts in zip(keypoints.format.marks, confident, strict=True) if counts]
    landmarks = LandmarkGather(names, result.camera.intrinsics.device)(result.posed)
    projected = result.camera.project(landmarks)[0, :, :2].detach().cpu().numpy()
    distance = float(np.linalg.norm(projected - keypoints.points[confident], axis=1).mean())
    height = person_height(keypoints)
    return {
        "warnings": list(result.warnings),
        "energy": {name: round(value, 4) for name, value in result.energy.items()},
        "energy_total": round(sum(result.energy.values()), 4),
        "energy_of_finalists": [round(value, 4) for value in result.finalists],
        "hypotheses": result.hypotheses,
        "start": result.start,
        "depth": _depth_report(result),
        "distance": describe_distance(result),
        "keypoints": {
            "confident": int(confident.sum()),
            "mean_distance_px": round(distance, 2),
            "mean_distance_share_of_person_height": round(distance / height, 4) if height else None,
        },
        "seconds": {name: round(value, 2) for name, value in result.stage_seconds.items()},
        "seconds_total": round(sum(result.stage_seconds.values()), 2),
        "versions": {
            "warp-partdr": __version__,
            "warp": wp.config.version,
            "torch": torch.__version__,
            "python": platform.python_version(),
            "machine": platform.machine(),
        },
    }


def _depth_report(result: FitResult) -> dict[str, Any]:
    """Report on depth: flips that were tried, and the network's uncertainty of depths and its distance."""
    order, uncertainty = result.depth_order, result.uncertainty
    report: dict[str, Any] = {}
    if order is not None:
        report |= {"flips_tried": list(order.tried), "flipped": order.flipped, "limbs_hidden": list(order.hidden)}
    if uncertainty is not None:
        depths = zip(JOINT_NAMES[1:], uncertainty.depths[0].tolist(), strict=True)
        report |= {
            "spread_m": {name: round(depth, 3) for name, depth in depths},  # 68 %, relative to the pelvis
            "network_distance_m": round(1 / max(float(uncertainty.nearness[0]), 1e-3), 2),
        }
    return report


def score_labels(drawn: np.ndarray, target: np.ndarray, source: LabelSet) -> dict[str, Any]:
    """Score a body's group ids against the picture's.

    Args:
        drawn: Group ids of the body, shape (H, W), uint8.
        target: Group ids of the picture, shape (H, W), uint8, 255 = ignore.
        source: Label set of both.

    Returns:
        Scores under "parts", and, if the set can be mapped to LSP's six parts, also under "parts_lsp6".
    """
    scores = {"parts": {"label_set": source.name, **_scores(drawn, target, source.group_names)}}
    lsp6 = label_set("lsp6")
    try:
        table = regroup(source, lsp6)
    except ValueError:
        return scores  # the set is not finer than LSP's six parts
    return scores | {"parts_lsp6": _scores(table[drawn], table[target], lsp6.group_names)}


def _scores(drawn: np.ndarray, target: np.ndarray, names: tuple[str, ...]) -> dict[str, Any]:
    counts = metrics.confusion(drawn, target, len(names) + 1)
    person = (target != BACKGROUND) & (target != IGNORE)
    return {
        "foreground_f1": round(metrics.part_f1(metrics.foreground_counts(counts)), 4),
        "part_f1": round(metrics.part_f1(counts), 4),
        "part_accuracy": round(metrics.accuracy(counts), 4),
        "f1": {
            name: None if np.isnan(score) else round(float(score), 4)
            for name, score in zip(("background", *names), metrics.f1_scores(counts), strict=True)
        },
        # The mean F1 over person and background hides how much of the person is left out.
        "left_out": round(float((drawn == BACKGROUND)[person].mean()), 4) if person.any() else None,
        "pixels": {"person": int(person.sum()), "ignored": int((target == IGNORE).sum())},
    }
