"""The command ``partdr fit``: a body from one person's keypoints and part labels."""

from __future__ import annotations

from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Argument, Option

from ..body.labels import LABEL_SETS
from ..body.skeletons import SKELETONS
from ..errors import InputError, shown
from ..inputs.films import is_film
from ..networks.detection import MIN_SCORE
from .loading import NO_MODEL, load_kernels, load_mesh_kernels
from .options import (
    CameraOptions,
    DeviceOption,
    MinScoreOption,
    OutOption,
    PhotoFiles,
    SettingOptions,
    check_person,
    check_score,
    take_formats,
    take_whole,
)
from .register import MODEL_HELP, SeenBody, clothe, describe_scores, read_model, say_detailed

if TYPE_CHECKING:
    import numpy as np

    from ..cameras import Perspective
    from ..inputs.person import PersonInputs
    from ..models.model import DetailedModel
    from ..solve.ellipsoids.options import FitOptions
    from ..solve.mesh.mesh_stage import MeshFit

_FAULTS = (ValueError, RuntimeError)  # of a detailed body, also those of torch and Warp: no memory left, for example

# Keys of ``solve.ellipsoids.stages.STAGES``, which is not loaded for --help.
StartName = StrEnum("StartName", ["network", "search"])
QualityName = StrEnum("QualityName", ["fast", "balanced", "accurate"])

FIT_HELP = f"""Fit a body of 20 ellipsoids, and a skinned mesh, to everyone in a photo or film: people.json.

Examples: `partdr fit photo.jpg`; `partdr fit p.jpg --keypoints p.json --parts p.png --labels cdcl14`

**2D keypoints**, JSON: `{{"format": "coco17", "keypoints": [[x, y, confidence], ...]}}`, or as OpenPose, COCO, MMPose
and others do. Formats: {", ".join(SKELETONS)}; or your own.

**Part labels**, as large as the picture: ids, a network's probabilities, or each person's mask (full1); without them,
keypoints alone are fitted. Label sets: {", ".join(LABEL_SETS)}; or a JSON file of your own (docs/inputs.md).

**Results**: overlay.png (look at it first), parts.png, loss.png, body.json (measurements), body.npz, ellipbody.glb
(for Blender), report.json; detailed.png, detailed.glb, detailed.obj, detailed.ply, detailed.bvh, detailed.npz,
registration.json; of films overlay.mp4, scene.glb, and a .npz, .glb and .bvh each. Older ones are replaced.

**Settings** (docs/fitting.md): `stature=1.78` (one person's height [m], in films too), `trust_background=true`,
`landmarks=full` (of photos and films: quicker keypoints, farther from the truth), `weights.prior=5`, `labels.size=256`,
`mesh.apart=0.1`, `threads=4`, `also=usdz,fbx` (more files; usda, too);
`outline=false` (nearer joints), `outline=labels-first` (nearer outlines), both with --model none.
"""

# Of these, the default stands in the text: typer would give each a line of its own.
_MODEL_HELP = f"Detailed model: {MODEL_HELP}; none skips it. Default: anny."
_QUALITY_HELP = "fast, balanced (default) or accurate, whose mesh stage takes three times as long (docs/accuracy.md)."
_START_HELP = "network (default; a search if that ends far off) or search."


def fit(
    files: PhotoFiles,
    photo: Annotated[Path | None, Argument(help="Photo or film; with keypoints optional.", metavar="PHOTO")] = None,
    out: OutOption = Path("out"),
    model: Annotated[str, Option(help=_MODEL_HELP, metavar="NAME", show_default=False)] = "anny",
    quality: Annotated[
        QualityName, Option(help=_QUALITY_HELP, metavar="NAME", show_default=False)
    ] = QualityName.balanced,
    start: Annotated[StartName, Option(help=_START_HELP, metavar="NAME", show_default=False)] = StartName.network,
    min_score: MinScoreOption = None,
    device: DeviceOption = "auto",
    explain: Annotated[
        bool, Option("--explain", help="First say what is modelled, what is left out, and why.")
    ] = False,
    *,
    view: CameraOptions,
    settings: SettingOptions,
) -> None:
    """Fit a body to one person; see ``FIT_HELP``."""
    # Loaded here, so that --help is quick, and torch after the files, so that faults in them are found at once.
    values = settings.read()
    if "min_score" in values:
        raise InputError(f"min_score: {shown(values['min_score'])}, as a setting; expected the option --min-score")
    score = check_score("--min-score", MIN_SCORE if min_score is None else min_score)
    check_person(files.person)
    if photo is not None and is_film(photo):
        from .fit_film import fit_motions

        if explain:
            raise InputError("--explain: with a film; expected a photo")
        if quality is not QualityName.balanced or start is not StartName.network:
            raise InputError("--quality, --start: with a film; expected none, or --set mesh.iterations=30, for example")
        fit_motions(files, photo, out, device, model, view, values, score)
        return
    if files.keypoints is None:
        from .fit_photo import PhotoSettings, fit_everyone

        if explain:
            raise InputError("--explain: without --keypoints; expected them with it")
        formats = take_formats(values)
        options = before_mesh(fit_options(quality, start, values), values)
        chosen = PhotoSettings(take_whole(values, "threads"), score, options, formats)
        fit_everyone(files, photo, out, device, model, view, chosen)
        return
    if min_score is not None:
        raise InputError(f"--min-score: {min_score:g}, with --keypoints; expected a photo alone")
    person = files.read(photo)

    from ..interop.devices import choose_device
    from ..kernels.launch import set_num_threads
    from ..results.result_sets import check_folder, check_inputs
    from ..results.save import DETAILED_FILES, RESULT_FILES, SMPLX_FILE, image_size, save_fit
    from ..solve.ellipsoids.fitting import fit_body
    from ..solve.ellipsoids.settings import MESH
    from ..solve.ellipsoids.stages import OUTLINE
    from ..solve.mesh.mesh_stage import refine_mesh
    from .progress import FitProgress

    where = choose_device(device)
    set_num_threads(take_whole(values, "threads"))
    formats = take_formats(values)
    if formats and model == NO_MODEL:
        raise InputError(f"also: {', '.join(formats)}, with --model none; expected a detailed model")
    options = fit_options(quality, start, values)
    clothed = person.parts is not None and model != NO_MODEL
    if MESH in values and not clothed:
        raise InputError(f"{MESH}: settings of a stage that needs part labels and a detailed model; expected both")
    if OUTLINE in values and person.parts is None:
        raise InputError(f"{OUTLINE}: settings of a stage that needs part labels; expected some")
    if clothed:
        options = before_mesh(options, values)
    check_folder(out)
    named = (options.network, files.keypoint_format, files.labels, model)
    given = (photo, files.keypoint_file(photo), files.parts, settings.config, *(Path(name) for name in named if name))
    check_inputs(out, given, (*RESULT_FILES, *DETAILED_FILES, SMPLX_FILE))
    size = image_size(person.keypoints, person.parts, person.photo)
    camera = view.of_photo(size, photo)
    if view.refused:
        options = replace(options, guess_camera=False)
    detailed_model = None if model == NO_MODEL else read_model(model, where)
    if explain:
        _explain(person, options, camera, detailed_model)
    mesh, failure = None, None
    with FitProgress() as progress:
        load_kernels(where, options, with_labels=person.parts is not None)
        result = fit_body(
            person.keypoints,
            person.parts,
            others=person.others,
            options=options,
            device=where,
            camera=camera,
            progress=progress,
        )
        if clothed:
            try:
                load_mesh_kernels(where)
                mesh = refine_mesh(result, detailed_model, options=options.mesh, progress=progress)
                result = mesh.ellipbody
            except _FAULTS as error:
                failure = error
        progress("writing results", 1, 1)
        report = save_fit(result, out, photo=person.photo, mesh=None if mesh is None else mesh.body)
    for warning in result.warnings:
        typer.echo(f"partdr: warning: {warning}", err=True)
    _summarise(report, out)
    if detailed_model is None:
        return
    try:
        if failure is not None:
            raise failure
        with FitProgress() as progress:
            seen = SeenBody(result.camera, size, person.photo, result.evidence)
            if mesh is None:
                told = clothe(result.posed, detailed_model, out, seen, formats=formats, progress=progress)
            else:
                told = _save_mesh(mesh, out, size, person.photo, formats)
    except _FAULTS as error:
        raise InputError(f"{error}; {out} holds the fit without its detailed body") from error
    typer.echo(told)


def _save_mesh(
    mesh: MeshFit, out: Path, size: tuple[int, int], photo: np.ndarray | None, formats: tuple[str, ...]
) -> str:
    """Files of the mesh stage, and a line about them."""
    from ..results.save import save_registered

    fit = mesh.ellipbody
    report = save_registered(
        mesh.body,
        out,
        fit.camera,
        size,
        photo=photo,
        evidence=fit.evidence,
        clothes=mesh.clothes,
        formats=formats,
        seconds=round(fit.stage_seconds["mesh"], 3),
    )
    return say_detailed(report, out)


def fit_options(quality: QualityName, start: StartName, values: dict[str, Any]) -> FitOptions:
    """Options of a quality and a start, with settings."""
    from ..solve.ellipsoids.options import FitOptions
    from ..solve.ellipsoids.settings import change_options

    options = change_options(FitOptions.at(quality.value, start.value), values)  # type: ignore[arg-type]
    if options.network is not None and start is StartName.search:
        raise InputError(f"network: {options.network}, with --start search, which has none; expected one of the two")
    return options


def before_mesh(options: FitOptions, values: dict[str, Any]) -> FitOptions:
    """Options of a fit that the mesh stage goes on from: without the outline stage, whose result it would not use.

    An InputError if that stage was changed.
    """
    from ..solve.ellipsoids.stages import OUTLINE

    if OUTLINE in values:
        told = f"{OUTLINE}: settings of a stage that the mesh stage replaces"
        raise InputError(f"{told}; expected --keypoints, --parts and --model none with it")
    return options.without_outline()


def _explain(
    person: PersonInputs, options: FitOptions, camera: Perspective | None, model: DetailedModel | None
) -> None:
    from rich.console import Console

    from ..solve.ellipsoids.explain import explain, explain_mesh, print_choices

    choices = explain(person.keypoints, person.parts, others=person.others, options=options, camera=camera)
    if model is not None:
        choices.append(explain_mesh(model, person.parts, options.mesh))
    print_choices(choices, Console(highlight=False))


def _summarise(report: dict[str, Any], out: Path) -> None:
    count, start = report["hypotheses"], report["start"]
    alone = start == "network" and count == 1
    begun = "started from the label network's body" if alone else f"{count} hypotheses, the {start}'s won"
    share = report["keypoints"]["mean_distance_share_of_person_height"]
    off = f"keypoints {report['keypoints']['mean_distance_px']:.1f} px off on average"
    off += f" ({100 * share:.1f} % of the person's height)" if share else ""
    scores = [describe_scores(report)] if "parts" in report else []
    typer.echo("; ".join([f"{begun}, {report['seconds_total']:.1f} s", off, *scores]))
    typer.echo(f"{out / 'overlay.png'} shows the body, {out / 'body.json'} its measurements")
