"""Command ``partdr register``, from body.npz to a detailed body, and functions that ``partdr fit`` shares with it."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Argument, Option

from ..errors import InputError
from .options import (
    BareOption,
    BodyFormat,
    DeviceOption,
    LabelsOption,
    OutOption,
    check_further,
    read_photo_with_warnings,
)

if TYPE_CHECKING:
    import numpy as np

    from ..body.posing import Posed
    from ..cameras import Camera
    from ..inputs.evidence import Evidence
    from ..inputs.part_labels import PartLabels
    from ..models.model import DetailedModel
    from ..models.registration import Registered
    from ..results.views import PlacedBody
    from .progress import FitProgress

REGISTER_HELP = """Fit a detailed model to a body: it reads body.npz of `partdr fit`, and writes a skinned mesh.

Examples: `partdr register out/body.npz --photo photo.png --out detailed`;
`partdr register regressed.npz --model SMPLX.npz --parts p.png --labels cdcl14`

**Another method's body**, .npz or .json, is refined against --parts and written with the same parameters. It holds
SMPL's parameters by smplx's names (betas, global_orient, body_pose, transl or pred_cam_t, focal_length), or Multi-HMR's
(rotvec, shape, transl_pelvis, K). Give the file of its SMPL model to --model.

**Results** in FOLDER are detailed.png (look at it first), detailed.glb (mesh, skeleton and skin weights, posed; it
opens in Blender), detailed.obj, detailed.ply (with part colours), detailed.bvh (skeleton and pose), detailed.npz
(shape, rotations and position for the model) and registration.json (terms of the loss; with --parts also F1 against the
labels, for the bare mesh that these files hold and, if there are clothes, for the mesh in its clothes). For SMPL's
models there is also detailed.smplx.npz, with betas, global_orient, body_pose, ... and transl for the smplx package
(use_pca=False, flat_hand_mean=True), and the camera. Older results in FOLDER are replaced.
"""
MODEL_HELP = "anny, mhr:PATH, soma:PATH, skel:PATH or an SMPL, SMPL-H or SMPL-X file"


@dataclass(frozen=True)
class ClotheOptions:
    """Options for a fit's body, whose ellipsoids the model follows."""

    inscribed: Annotated[
        bool,
        Option("--inscribed", help="Keep the skin outside the ellipsoids. By default, it matches their outlines."),
    ] = False
    grow: Annotated[
        bool, Option("--grow", help="Let parts grow beyond the model's range, for bodies whose lengths were edited.")
    ] = False


@dataclass(frozen=True, kw_only=True)
class RegisterRequest:
    """Arguments and options of ``partdr register``."""

    body: Annotated[Path, Argument(help="File body.npz of `partdr fit`, or another method's body.", metavar="BODY")]
    model: Annotated[str, Option(help=f"Detailed model: {MODEL_HELP}.", metavar="NAME")] = "anny"
    photo: Annotated[Path | None, Option(help="Picture of the fit, over which the body is drawn.", metavar="FILE")] = (
        None
    )
    parts: Annotated[
        Path | None,
        Option(help="Part labels of the fit, with which the detailed body is compared.", metavar="FILE"),
    ] = None
    labels: LabelsOption = None
    keypoints: Annotated[
        Path | None, Option(help="2D keypoints that another method's body must follow, too.", metavar="FILE")
    ] = None
    out: OutOption = Path("out")
    to: Annotated[
        list[BodyFormat] | None,
        Option(
            help="Also write detailed.usda, .usdz or .fbx (by Blender). May be given several times.", metavar="NAME"
        ),
    ] = None
    bare: BareOption = False
    device: DeviceOption = "auto"
    options: ClotheOptions

    @cached_property
    def formats(self) -> tuple[str, ...]:
        """Formats of further files; raises InputError if one can't be written here."""
        return check_further(self.to)

    def check_out(self) -> None:
        """Raise an InputError if results can't be written, or would replace a file that was given."""
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

    picture = None if request.photo is None else read_photo_with_warnings(request.photo)
    parts = read_labelled_parts(request.parts, request.labels)
    _ = request.formats  # raises faults before anything is made
    summary = _refine(request, picture, parts) if is_given(request.body) else _clothe_fit(request, picture, parts)
    typer.echo(summary)


def _clothe_fit(request: RegisterRequest, photo: np.ndarray | None, parts: PartLabels | None) -> str:
    """Fit the model to the body of a fit, write it, and return a line about it."""
    from ..inputs.part_labels import check_sizes
    from ..results.body_file import BODY_ARRAYS, load_body

    if request.keypoints is not None:
        raise InputError(f"--keypoints: with {request.body}, a fit's; expected another method's body")
    fitted = load_body(request.body)
    height, width = fitted.image_size.tolist()
    check_sizes(
        body=(height, width),
        photo=None if photo is None else (photo.shape[0], photo.shape[1]),
        parts=None if parts is None else (parts.groups.shape[0], parts.groups.shape[1]),
    )

    import torch

    from ..body.posing import pose
    from ..interop.devices import choose_device
    from .progress import FitProgress

    where = choose_device(request.device)
    request.check_out()
    model = read_model(request.model, where)
    posed = pose(*(torch.from_numpy(getattr(fitted, name))[None].to(where) for name in BODY_ARRAYS))
    evidence = None if parts is None else _evidence_of(posed, fitted.camera(), parts)
    picture = BodyPicture(fitted.camera(), (height, width), photo, evidence)
    with FitProgress() as progress:
        return clothe(
            posed,
            model,
            request.out,
            picture,
            request.options,
            formats=request.formats,
            bare=request.bare,
            progress=progress,
        )


@dataclass(frozen=True, eq=False)
class BodyPicture:
    """Picture that a body was fitted to.

    Attributes:
        camera: Camera of the picture.
        image_size: Size (H, W) of the picture [px].
        photo: Picture, shape (H, W, 3), uint8; None: there is none.
        evidence: Keypoints and labels of the person; None: they are not known.
        lens_assumed: True if the camera is not known; None: not of a fit, so that no views are drawn.
    """

    camera: Camera
    image_size: tuple[int, int]
    photo: np.ndarray | None
    evidence: Evidence | None
    lens_assumed: bool | None = None

    def views(self, body: Registered, *, bare: bool) -> PlacedBody | None:
        """The body placed before the camera, for views of it, with or without its suit; None if they are not drawn."""
        from ..results.views import place_alone

        if self.evidence is None or self.lens_assumed is None:
            return None
        keypoints = self.evidence.keypoints
        return place_alone(body, self.camera, self.image_size, keypoints, lens_assumed=self.lens_assumed, bare=bare)


def _refine(request: RegisterRequest, photo: np.ndarray | None, parts: PartLabels | None) -> str:
    """Refine another method's body, write it, and return a line about it."""
    body, options = request.body, request.options
    if parts is None:
        raise InputError(f"--parts: missing; expected the part labels that {body}, another method's, is to follow")
    if options.inscribed or options.grow:
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
        seconds = round(time.perf_counter() - started, 2)
        report = save_registered(
            fit.body,
            request.out,
            fit.camera,
            (height, width),
            photo=photo,
            evidence=fit.ellipbody.evidence,
            clothes=fit.clothes,
            formats=request.formats,
            bare=request.bare,
            start=str(body),
            seconds=seconds,
        )
    for warning in fit.ellipbody.evidence.warnings:
        typer.echo(f"partdr: warning: {warning}", err=True)
    return describe_detailed(report, request.out)


def _evidence_of(posed: Posed, camera: Camera, parts: PartLabels) -> Evidence:
    """Weigh the labels of the person where a body is; raise InputError if there are none."""
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
    """Load the model that ``--model`` names."""
    from ..models.load import load_model

    try:
        return load_model(name, device=device)
    except ValueError as error:
        raise InputError(f"--model: {error}") from error


def clothe(
    posed: Posed,
    model: DetailedModel,
    out: Path,
    picture: BodyPicture,
    options: ClotheOptions = ClotheOptions(),
    *,
    formats: tuple[str, ...] = (),
    bare: bool = False,
    progress: FitProgress,
) -> str:
    """Register a model to one EllipBody (B = 1), write it with ``save_registered``, and return a line about it.

    With ``options.inscribed``, the ellipsoids must lie within the skin. With ``options.grow``, the model follows each
    of EllipBody's lengths and thicknesses, and parts may grow beyond the model's range. The sizes of a fit are too
    rough for that: hands and feet came out as thin as boards.

    Args:
        posed: Posed EllipBody, B = 1, in the camera frame [m].
        model: Detailed model.
        out: Folder for the files.
        picture: Picture that the body was fitted to.
        options: Options of the registration.
        formats: Formats of further files.
        bare: True shows the skin instead of a plain suit.
        progress: Progress bar.
    """
    import warp as wp

    from ..kernels import registration
    from ..kernels.mesh import rasterize, resolve
    from ..models.registration import RegistrationOptions, RegistrationWeights, register
    from ..results.save import save_registered

    for module in (registration, rasterize, resolve):
        wp.load_module(module, device=str(posed.joints.device))
    if options.inscribed:
        weights = RegistrationWeights.inscribed()
        if not options.grow:
            weights = replace(weights, measures=0.0)
    elif options.grow:
        weights = RegistrationWeights()
    else:
        weights = RegistrationWeights.fitted()
    registration_options = RegistrationOptions(weights=weights, growth=options.grow)
    started = time.perf_counter()
    registered = register(posed, model, options=registration_options, progress=progress)
    seconds = round(time.perf_counter() - started, 2)
    progress("writing results", 1, 1)
    report = save_registered(
        registered,
        out,
        picture.camera,
        picture.image_size,
        photo=picture.photo,
        evidence=picture.evidence,
        formats=formats,
        bare=bare,
        views=picture.views(registered, bare=bare),
        seconds=seconds,
    )
    return describe_detailed(report, out)


def describe_detailed(report: dict[str, Any], out: Path) -> str:
    """Line about a detailed body's report and its files."""
    scores = f"{describe_scores(report)}; " if "parts" in report else ""
    if "parts_clothed" in report:
        scores += f"in clothes {describe_scores(report, 'parts_clothed')}; "
    files = f"{out / 'detailed.png'} shows the detailed body, {out / 'detailed.glb'} opens in Blender"
    return f"{report['model']}: {scores}{files}"


def describe_scores(report: dict[str, Any], key: str = "parts") -> str:
    """Words about a body's scores against the labels, which are under ``key`` in a report."""
    scores = report[key]
    left_out = "" if scores["left_out"] is None else f", {100 * scores['left_out']:.0f} % of the person left out"
    return f"foreground F1 {scores['foreground_f1']:.3f}, part F1 {scores['part_f1']:.3f}{left_out}"
