"""The command ``partdr register``, from body.npz to a detailed body, and what ``partdr fit`` shares with it."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Argument, Option

from ..errors import InputError
from .options import BodyFormat, DeviceOption, LabelsOption, OutOption, check_further, read_shown_photo

if TYPE_CHECKING:
    import numpy as np

    from ..body.posing import Posed
    from ..cameras import Camera
    from ..inputs.evidence import Evidence
    from ..inputs.part_labels import PartLabels
    from ..models.model import DetailedModel
    from .progress import FitProgress

REGISTER_HELP = """Clothe a fitted body in a detailed model: body.npz of `partdr fit` in, a skinned mesh out.

Examples: `partdr register out/body.npz --photo photo.png --out detailed`;
`partdr register regressed.npz --model SMPLX.npz --parts p.png --labels cdcl14`

**Another method's body**, .npz or .json, is refined against --parts and comes out as the same parameters: SMPL's by
smplx's names (betas, global_orient, body_pose, transl or pred_cam_t, focal_length), or Multi-HMR's (rotvec, shape,
transl_pelvis, K); --model says which file of SMPL's it is of.

**Results** in FOLDER: detailed.png (look at this first), detailed.glb (mesh, skeleton and skin weights, posed; opens in
Blender), detailed.obj, detailed.ply (with part colours), detailed.bvh (skeleton and pose), detailed.npz (shape,
rotations and position for the model) and registration.json (terms of the loss; with --parts, F1 against the labels of
the bare mesh that these files hold, and of the mesh in its clothes if there are any); of SMPL's models
detailed.smplx.npz, too: betas, global_orient, body_pose, ... and transl, as the smplx package takes them
(use_pca=False, flat_hand_mean=True), and the camera. Older results there are replaced.
"""
MODEL_HELP = "anny, mhr:PATH, soma:PATH, skel:PATH or an SMPL, SMPL-H or SMPL-X file"


@dataclass(frozen=True)
class ClotheOptions:
    """Options for a fit's body: how the model is to follow its ellipsoids."""

    inscribed: Annotated[
        bool, Option("--inscribed", help="Keep the skin outside the ellipsoids; a fit's match its outlines instead.")
    ] = False
    grow: Annotated[
        bool, Option("--grow", help="Let parts grow beyond the model's people: for bodies whose lengths were edited.")
    ] = False


@dataclass(frozen=True, kw_only=True)
class RegisterRequest:
    """Arguments and options of ``partdr register``."""

    body: Annotated[Path, Argument(help="body.npz of partdr fit, or another method's body.", metavar="BODY")]
    model: Annotated[str, Option(help=f"{MODEL_HELP}.", metavar="NAME")] = "anny"
    photo: Annotated[Path | None, Option(help="The fit's picture, to draw the body over.", metavar="FILE")] = None
    parts: Annotated[
        Path | None, Option(help="The fit's part labels, to say how well the detailed body fills them.", metavar="FILE")
    ] = None
    labels: LabelsOption = None
    keypoints: Annotated[
        Path | None, Option(help="2D keypoints, if another method's body is to follow them, too.", metavar="FILE")
    ] = None
    out: OutOption = Path("out")
    to: Annotated[
        list[BodyFormat] | None, Option(help="Also detailed.usda, .usdz or .fbx (by Blender).", metavar="NAME")
    ] = None
    device: DeviceOption = "auto"
    how: ClotheOptions

    @cached_property
    def formats(self) -> tuple[str, ...]:
        """Formats of more files; an InputError if one can't be written here."""
        return check_further(self.to)

    def check_out(self) -> None:
        """Raise an InputError if results can't be written, or would replace one of the files that were given."""
        from ..results.result_sets import check_folder, check_inputs
        from ..results.save import DETAILED_FILES, SMPLX_FILE

        check_folder(self.out)
        named = [Path(name) for name in (self.labels, self.model) if name]
        check_inputs(
            self.out, [self.body, self.photo, self.parts, self.keypoints, *named], [*DETAILED_FILES, SMPLX_FILE]
        )


def register_body(request: RegisterRequest) -> None:
    """Register a detailed model; see ``REGISTER_HELP``."""
    from ..inputs.part_labels import read_labelled_parts
    from ..solve.mesh.given_files import is_given

    picture = None if request.photo is None else read_shown_photo(request.photo)
    parts = read_labelled_parts(request.parts, request.labels)
    _ = request.formats  # faults in it are told before anything is made
    told = _refine(request, picture, parts) if is_given(request.body) else _clothe_fit(request, picture, parts)
    typer.echo(told)


def _clothe_fit(request: RegisterRequest, photo: np.ndarray | None, parts: PartLabels | None) -> str:
    """Clothe the body of a fit and write it; returns a line about it."""
    from ..inputs.part_labels import check_sizes
    from ..results.body_file import BODY_ARRAYS, load_body

    if request.keypoints is not None:
        raise InputError(f"--keypoints: with {request.body}, a fit's; expected another method's body")
    fitted = load_body(request.body)
    height, width = fitted.image_size.tolist()
    seen = {"photo": photo, "parts": None if parts is None else parts.groups}
    check_sizes(body=(height, width), **{name: each.shape[:2] for name, each in seen.items() if each is not None})

    import torch

    from ..body.posing import pose
    from ..interop.devices import choose_device
    from .progress import FitProgress

    where = choose_device(request.device)
    request.check_out()
    model = read_model(request.model, where)
    posed = pose(*(torch.from_numpy(getattr(fitted, name))[None].to(where) for name in BODY_ARRAYS))
    evidence = None if parts is None else _evidence_of(posed, fitted.camera(), parts)
    view = SeenBody(fitted.camera(), (height, width), photo, evidence)
    with FitProgress() as progress:
        return clothe(posed, model, request.out, view, request.how, formats=request.formats, progress=progress)


@dataclass(frozen=True, eq=False)
class SeenBody:
    """Picture in which a body was seen.

    Attributes:
        camera: The camera of the picture.
        image_size: (H, W) of the picture [px].
        photo: The picture, shape (H, W, 3), uint8; None: there is none.
        evidence: Keypoints and labels of the person; None: they are not known.
    """

    camera: Camera
    image_size: tuple[int, int]
    photo: np.ndarray | None
    evidence: Evidence | None


def _refine(request: RegisterRequest, photo: np.ndarray | None, parts: PartLabels | None) -> str:
    """Refine another method's body and write it; returns a line about it."""
    body, how = request.body, request.how
    if parts is None:
        raise InputError(f"--parts: missing; expected the part labels that {body}, another method's, is to follow")
    if how.inscribed or how.grow:
        raise InputError(f"--inscribed, --grow: with {body}, another method's body; expected one of partdr fit")

    from ..inputs.keypoint_files import read_keypoints
    from ..inputs.keypoints import choose_person
    from ..inputs.part_labels import check_sizes
    from ..interop.devices import choose_device
    from ..results.save import save_registered
    from ..solve.mesh.given_files import read_given
    from ..solve.mesh.given_start import refine_given
    from .progress import FitProgress

    height, width = parts.groups.shape[:2]
    check_sizes(photo=None if photo is None else photo.shape[:2], parts=(height, width))
    where = choose_device(request.device)
    request.check_out()
    given, camera = read_given(body, read_model(request.model, where), (height, width))
    people = []
    if request.keypoints is not None:
        people = read_keypoints(request.keypoints, photo=request.photo, size=(height, width))
    person = choose_person(people, parts.groups) if people else None
    others = [other for other in people if other is not person]
    started = time.perf_counter()
    with FitProgress() as progress:
        fit = refine_given(given, camera, parts, person, others=others, progress=progress)
        progress("writing results", 1, 1)
        seconds = round(time.perf_counter() - started, 3)
        report = save_registered(
            fit.body,
            request.out,
            fit.camera,
            (height, width),
            photo=photo,
            evidence=fit.ellipbody.evidence,
            clothes=fit.clothes,
            formats=request.formats,
            start=str(body),
            seconds=seconds,
        )
    for warning in fit.ellipbody.evidence.warnings:
        typer.echo(f"partdr: warning: {warning}", err=True)
    return say_detailed(report, request.out)


def _evidence_of(posed: Posed, camera: Camera, parts: PartLabels) -> Evidence:
    """The labels of the person where a body is; an InputError if there are none."""
    import numpy as np

    from ..body.posing import LandmarkGather
    from ..body.skeletons import skeleton
    from ..inputs.evidence import weigh_evidence
    from ..inputs.keypoints import Keypoints2D

    landmarks = LandmarkGather(skeleton("coco17").landmarks, posed.joints.device)(posed).cpu()
    points = camera.project(landmarks)[0, :, :2].numpy()
    try:
        return weigh_evidence(Keypoints2D("coco17", points, np.ones(len(points), dtype=np.float32)), parts)[0]
    except InputError as error:
        raise InputError("--parts: no labelled pixel where the body is; expected the labels of its picture") from error


def read_model(name: str, device: str) -> DetailedModel:
    """The model that ``--model`` names."""
    from ..models.load import load_model

    try:
        return load_model(name, device=device)
    except ValueError as error:
        raise InputError(f"--model: {error}") from error


def clothe(
    posed: Posed,
    model: DetailedModel,
    out: Path,
    seen: SeenBody,
    how: ClotheOptions = ClotheOptions(),
    *,
    formats: tuple[str, ...] = (),
    progress: FitProgress,
) -> str:
    """Register a model to one EllipBody (B = 1) and write it as ``save_registered`` does; returns a line about it.

    ``how.inscribed``: the ellipsoids are to lie within the skin. ``how.grow``: EllipBody's lengths and thicknesses
    count one by one, and parts may grow beyond the model's people. A fit's are too rough for that: hands and feet came
    out as thin as boards.
    """
    import warp as wp

    from ..kernels import registration
    from ..kernels.mesh import rasterize, resolve
    from ..models.registration import RegistrationOptions, RegistrationWeights, register
    from ..results.save import save_registered

    for module in (registration, rasterize, resolve):
        wp.load_module(module, device=str(posed.joints.device))
    if how.inscribed:
        weights = (
            RegistrationWeights.inscribed() if how.grow else replace(RegistrationWeights.inscribed(), measures=0.0)
        )
    else:
        weights = RegistrationWeights() if how.grow else RegistrationWeights.fitted()
    options = RegistrationOptions(weights=weights, growth=how.grow)
    started = time.perf_counter()
    registered = register(posed, model, options=options, progress=progress)
    seconds = round(time.perf_counter() - started, 3)
    progress("writing results", 1, 1)
    report = save_registered(
        registered,
        out,
        seen.camera,
        seen.image_size,
        photo=seen.photo,
        evidence=seen.evidence,
        formats=formats,
        seconds=seconds,
    )
    return say_detailed(report, out)


def say_detailed(report: dict[str, Any], out: Path) -> str:
    """A line about a detailed body's report, and where it is."""
    scores = f"{describe_scores(report)}; " if "parts" in report else ""
    if "parts_clothed" in report:
        scores += f"in clothes {describe_scores(report, 'parts_clothed')}; "
    files = f"{out / 'detailed.png'} shows the detailed body, {out / 'detailed.glb'} opens in Blender"
    return f"{report['model']}: {scores}{files}"


def describe_scores(report: dict[str, Any], key: str = "parts") -> str:
    """Scores of a body against the labels, in words; those under a key of a fit's report, or a registration's."""
    scores = report[key]
    left_out = "" if scores["left_out"] is None else f", {100 * scores['left_out']:.0f} % of the person left out"
    return f"foreground F1 {scores['foreground_f1']:.3f}, part F1 {scores['part_f1']:.3f}{left_out}"
