"""The command ``partdr``."""

from __future__ import annotations

import math
import sys
from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .. import __version__
from ..body.labels import DESCRIBED
from ..body.skeletons import SKELETONS
from ..errors import InputError
from ..interop.devices import choose_device
from .bench import bench
from .demo import DEMO_HELP, demo
from .evaluate import evaluate
from .predict import PREDICT_HELP, predict
from .register import MODEL_HELP, REGISTER_HELP, LabelsOption, clothe, f1_scores, read_model, register_body
from .train import TRAIN_HELP, train

if TYPE_CHECKING:
    from ..fit.options import FitOptions


class Renderer(StrEnum):
    """What draws the body in a fit."""

    exact = "exact"
    mesh = "mesh"


class SubdivisionsName(StrEnum):
    """Level of the mesh."""

    e0 = "0"
    e1 = "1"
    e2 = "2"
    e3 = "3"
    auto = "auto"


class StartName(StrEnum):
    """Where a fit starts; ``quality.STAGES`` has the same names."""

    network = "network"
    search = "search"


class QualityName(StrEnum):
    """How much a fit spends on accuracy; ``quality.STAGES`` has the same names."""

    fast = "fast"
    balanced = "balanced"
    accurate = "accurate"


_UsageError: Any = typer.BadParameter.__base__  # typer keeps it in different places, its subclass in one

app = typer.Typer(
    add_completion=False,
    rich_markup_mode="markdown",
    context_settings={"help_option_names": ["-h", "--help"]},
)

app.add_typer(bench, name="bench")
app.add_typer(evaluate, name="evaluate")
app.command("register", help=REGISTER_HELP)(register_body)
app.command("train", help=TRAIN_HELP)(train)
app.command("predict", help=PREDICT_HELP)(predict)
app.command("demo", help=DEMO_HELP)(demo)

NO_MODEL = "none"

_FIT_HELP = f"""Fit a body of 20 ellipsoids to one person: 2D keypoints and part labels in, pose and measurements out.
Then clothe it in a detailed model: a skinned mesh.

Example: `partdr fit photo.jpg --keypoints photo.json --parts photo.png --labels cdcl14 --out fitted`

**Keypoints**, in pixels of the picture: `{{"format": "coco17", "keypoints": [[x, y, confidence], ...]}}`, a plain list,
OpenPose's own JSON, COCO annotations, or MMPose predictions. Formats: {", ".join(SKELETONS)}.

**Part labels**, as large as the picture: an image of ids, or a network's probabilities. Label sets:
{DESCRIBED}; or a JSON file of your own: `{{"groups": {{"head": ["head", "neck"], ...}}, "ids": {{"0":
"background", "1": "head", ...}}}}`, whose parts are those of ellipbody20. Id 255 is ignored. Without --parts, the
keypoints alone are fitted.

**Results** in FOLDER: overlay.png (look at this first), parts.png, body.npz (parameters), body.json (measurements in
cm, joints), ellipbody.glb (opens in Blender), loss.png, report.json. Of the detailed model: detailed.png, detailed.glb,
detailed.obj, detailed.ply, detailed.bvh, detailed.npz, registration.json, as `partdr register` leaves them. Older
results there are replaced.
"""


_QUALITY_HELP = (
    "Part F1, joint error and time on PartBench's clean people: fast 0.86, 36 mm, 0.4 of balanced's time; balanced "
    "0.88, 39 mm; accurate 0.90, 46 mm, 1.15 times it; of the search 0.87, 48 mm; 0.89, 53 mm; 0.89, 52 mm. "
    "Options for the last stage replace that of the quality."
)


def _print_version(asked: bool) -> None:
    if asked:
        typer.echo(f"partdr {__version__}")
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[
        bool, typer.Option("--version", help="Print the version and leave.", callback=_print_version, is_eager=True)
    ] = False,
) -> None:
    """Differentiable rendering of body parts, and reconstruction of human pose and shape."""


@app.command(help=_FIT_HELP)
def fit(
    keypoints: Annotated[Path, typer.Option(help="2D keypoints, JSON.", metavar="FILE.json")],
    photo: Annotated[
        Path | None, typer.Argument(help="The picture, for the overlay; optional.", metavar="PHOTO", show_default=False)
    ] = None,
    parts: Annotated[
        Path | None, typer.Option(help="Part labels: ids as PNG or .npy, or probabilities as .npy.", metavar="FILE")
    ] = None,
    labels: LabelsOption = None,
    out: Annotated[Path, typer.Option(help="Folder for the results.", metavar="FOLDER")] = Path("out"),
    model: Annotated[
        str, typer.Option(help=f"Detailed model to end with: {MODEL_HELP}; none skips it.", metavar="NAME")
    ] = "anny",
    keypoint_format: Annotated[
        str | None, typer.Option(help="Format of the keypoints, if the file does not say.", metavar="NAME")
    ] = None,
    person: Annotated[
        int | None,
        typer.Option(help="Whom to fit, of the people with keypoints: 0 = first; default: the largest.", metavar="N"),
    ] = None,
    device: Annotated[
        str, typer.Option(help="cpu or cuda; auto takes CUDA where there is some.", metavar="NAME")
    ] = "auto",
    quality: Annotated[QualityName, typer.Option(help=_QUALITY_HELP)] = QualityName.balanced,
    start: Annotated[
        StartName,
        typer.Option(
            help="network: what the label network says, and a search too where that ends far from keypoints or labels; "
            "search: many hypotheses."
        ),
    ] = StartName.network,
    network: Annotated[
        Path | None,
        typer.Option(help="A label network of `partdr train` instead of the packaged one.", metavar="FILE.safetensors"),
    ] = None,
    outline: Annotated[
        bool,
        typer.Option(
            help="End with a stage that fills the labels' outlines; without it, joints are nearer to the truth."
        ),
    ] = True,
    labels_first: Annotated[
        bool,
        typer.Option(
            "--labels-first", help="Follow the labels' outlines as far as the model can; joints get worse in 3D."
        ),
    ] = False,
    trust_background: Annotated[
        bool,
        typer.Option(
            help="Believe background where confident keypoints say that a limb is: for labels that miss nothing."
        ),
    ] = False,
    renderer: Annotated[
        Renderer, typer.Option(help="Draw exact ellipsoids, or their triangle mesh as the paper does: slower.")
    ] = Renderer.exact,
    subdivisions: Annotated[
        SubdivisionsName | None,
        typer.Option(
            help="Of --renderer mesh: level of the triangle meshes, default 1, as in the paper; auto: the coarsest "
            "within --tolerance of the ellipsoids.",
            show_default=False,
        ),
    ] = None,
    tolerance: Annotated[
        float | None,
        typer.Option(
            help="Of --subdivisions auto, in pixels of the drawn crop; default 0.5.", metavar="PX", show_default=False
        ),
    ] = None,
    threads: Annotated[int, typer.Option(help="CPU threads that share the bodies; 0: one a core.", metavar="N")] = 0,
    seed: Annotated[int, typer.Option(help="Of the random choice among too many hypotheses.", metavar="N")] = 0,
    explain: Annotated[
        bool, typer.Option("--explain", help="First say what of this input is modelled, what is left out, and why.")
    ] = False,
) -> None:
    """Fit a body to one person; see ``_FIT_HELP``."""
    # Loaded here, so that --help is quick, and torch after the files, so that faults in them are found at once.
    from ..inputs.keypoint_files import read_keypoints
    from ..inputs.keypoints import choose_person
    from ..inputs.part_labels import check_sizes, label_set_of, read_parts, read_photo
    from ..inputs.person import check_inside

    if labels is not None and parts is None:
        raise InputError(f"--labels: {labels}, without part labels; expected --parts with it")
    picture = None if photo is None else read_photo(photo)
    image = None if parts is None else read_parts(parts, label_set_of(parts, labels))
    groups = None if image is None else image.groups
    check_sizes(photo=None if picture is None else picture.shape[:2], parts=None if groups is None else groups.shape)
    people = read_keypoints(keypoints, keypoint_format)
    chosen = choose_person(people, groups, person)
    others = tuple(other for other in people if other is not chosen)
    check_inside(chosen, next((seen.shape[:2] for seen in (picture, groups) if seen is not None), None))

    import warp as wp

    wp.config.log_level = wp.LOG_WARNING
    from ..body.ellipbody import DEFAULT_SUBDIVISIONS
    from ..fit.fitting import fit_body
    from ..fit.options import FitOptions
    from ..kernels.launch import set_num_threads
    from ..render.renderers import RendererMesh
    from ..render.subdivisions import DEFAULT_TOLERANCE, Subdivisions
    from ..results.result_sets import check_folder, check_inputs
    from ..results.save import DETAILED_FILES, RESULT_FILES, image_size, save_fit
    from .progress import FitProgress

    if labels_first and not outline:
        raise InputError("--labels-first: with --no-outline; expected one of the two")
    if labels_first and renderer is Renderer.mesh:
        raise InputError("--labels-first: with --renderer mesh, which has no coverage gradient; expected exact")
    if subdivisions is not None and renderer is not Renderer.mesh:
        raise InputError(f"--subdivisions: {subdivisions.value}, of exact ellipsoids; expected --renderer mesh with it")
    if tolerance is not None and subdivisions is not SubdivisionsName.auto:
        raise InputError(f"--tolerance: {tolerance}; expected --subdivisions auto with it")
    if tolerance is not None and not 0 < tolerance < math.inf:
        raise InputError(f"--tolerance: {tolerance}; expected a positive number of pixels")
    if threads < 0:
        raise InputError(f"--threads: {threads}; expected 0 or more")
    set_num_threads(threads)
    check_folder(out)
    given = (photo, keypoints, parts, network, *(Path(name) for name in (labels, model) if name))
    check_inputs(out, given, (*RESULT_FILES, *DETAILED_FILES))
    where = choose_device(device)
    detailed_model = None if model == NO_MODEL else read_model(model, where)
    if network is not None and start is StartName.search:
        raise InputError(f"--network: {network}, with --start search, which has none; expected one of the two")
    options = replace(
        FitOptions.at(quality.value, start.value),
        seed=seed,
        trust_background=trust_background,
        network=None if network is None else str(network),
    )
    if renderer is Renderer.mesh:
        level: Subdivisions = DEFAULT_SUBDIVISIONS
        if subdivisions is not None:
            level = "auto" if subdivisions is SubdivisionsName.auto else int(subdivisions.value)
        options = options.drawn_by(
            lambda old: RendererMesh(level, tolerance or DEFAULT_TOLERANCE, max_distance=old.max_distance)
        )
    if labels_first:
        options = options.labels_first()
    if not outline:
        options = options.without_outline()
    if explain:
        from rich.console import Console

        from ..fit.explain import explain as choices_of
        from ..fit.explain import print_choices

        print_choices(choices_of(chosen, image, others=others, options=options), Console(highlight=False))
    with FitProgress() as progress:
        _load_kernels(where, options, with_labels=image is not None)
        result = fit_body(chosen, image, others=others, options=options, device=where, progress=progress)
        progress("writing results", 1, 1)
        report = save_fit(result, out, photo=picture)
    for warning in result.warnings:
        typer.echo(f"partdr: warning: {warning}", err=True)
    _summarise(report, out)
    if detailed_model is None:
        return
    try:
        with FitProgress() as progress:
            seen = result.camera, image_size(chosen, image, picture), picture, result.evidence
            said = clothe(result.posed, detailed_model, out, *seen, progress=progress)
    except (ValueError, RuntimeError) as error:  # also those of torch and Warp: no memory left, for example
        raise InputError(f"{error}; {out} holds the fit without its detailed body") from error
    typer.echo(said)


def _load_kernels(device: str, options: FitOptions, *, with_labels: bool) -> None:
    """Compile a fit's kernels, or load them: later, one of its stages would seem to take so long."""
    import warp as wp

    from ..kernels import kinematics, labels
    from ..kernels.ellipsoids import picture, silhouette
    from ..kernels.mesh import push_xy, push_z, rasterize
    from ..kernels.refine import state
    from ..render.renderers import RendererEllipsoids, RendererMesh

    modules: list[Any] = [kinematics, rasterize]
    if device == "cpu":  # on CUDA, these are compiled for block sizes that their launches know
        modules.append(state.MODULE)
    if with_labels and isinstance(options.renderer, RendererMesh):
        modules += [push_xy, push_z]
    elif with_labels and device == "cpu":
        drawn = [stage.renderer for stage in options.stages if stage.size]
        gradients = sorted({each.gradient for each in drawn if isinstance(each, RendererEllipsoids)})
        modules += [labels, silhouette, picture]
        modules += [f"warp_partdr.kernels.ellipsoids.{gradient}" for gradient in gradients]
    for module in modules:
        wp.load_module(module, device=device)


def _where_from(report: dict[str, Any]) -> str:
    count, seconds = report["hypotheses"], report["seconds_total"]
    if report["start"] == "network" and count == 1:
        return f"started from the label network's body, {seconds:.1f} s"
    return f"{count} hypotheses, the {report['start']}'s won, {seconds:.1f} s"


def _summarise(report: dict[str, Any], out: Path) -> None:
    share = report["keypoints"]["mean_distance_share_of_person_height"]
    lines = [
        _where_from(report),
        f"keypoints {report['keypoints']['mean_distance_px']:.1f} px off on average"
        + (f" ({100 * share:.1f} % of the person's height)" if share else ""),
    ]
    if "parts" in report:
        lines.append(f1_scores(report))
    typer.echo("; ".join(lines))
    typer.echo(f"{out / 'overlay.png'} shows the body, {out / 'body.json'} its measurements")


def main() -> None:
    """Run the command; bad input is one line on stderr and exit code 2."""
    try:
        code = app(sys.argv[1:] or ["--help"], prog_name="partdr", standalone_mode=False)
    except InputError as error:
        code = _complain(str(error))
    except _UsageError as error:
        command = error.ctx.command_path if error.ctx else "partdr"
        code = _complain(f"{error.format_message().rstrip('.')}; see {command} --help")
    except typer.Abort:
        code = 130
    sys.exit(code)


def _complain(message: str) -> int:
    typer.echo(f"partdr: {' '.join(message.split())}", err=True)
    return 2
