"""The command ``partdr``."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from .errors import InputError

app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    rich_markup_mode="markdown",
    context_settings={"help_option_names": ["-h", "--help"]},
)


@app.callback()
def _root() -> None:
    """Differentiable rendering of body parts, and reconstruction of human pose and shape."""


@app.command()
def fit(
    photo: Annotated[Path | None, typer.Argument(help="The picture, for the overlay; optional.", metavar="[PHOTO]")] = None,
    keypoints: Annotated[Path, typer.Option(help="2D keypoints, JSON.", metavar="FILE.json")] = ...,  # type: ignore[assignment]
    parts: Annotated[
        Path | None, typer.Option(help="Part labels: ids as 8-bit PNG or .npy, or probabilities as .npy.", metavar="FILE")
    ] = None,
    labels: Annotated[
        str, typer.Option(help="What the ids of --parts mean: a label set's name, or a JSON of your own.", metavar="NAME")
    ] = "ellipbody20",
    out: Annotated[Path, typer.Option(help="Folder for the results.", metavar="FOLDER")] = Path("out"),
    keypoint_format: Annotated[
        str | None, typer.Option(help="Skeleton of the keypoints, if the file does not say.", metavar="NAME")
    ] = None,
    person: Annotated[
        int | None, typer.Option(help="Which person of the keypoint file, 0 = first; default: the largest.", metavar="N")
    ] = None,
    device: Annotated[str, typer.Option(help="cpu or cuda; auto takes CUDA where there is some.")] = "auto",
    seed: Annotated[int, typer.Option(help="Of the random choice among too many hypotheses.")] = 0,
) -> None:
    """Fit a body of 20 ellipsoids to one person: 2D keypoints and part labels in, pose and measurements out.

    **Keypoints**: `{"format": "coco17", "keypoints": [[x, y, confidence], ...]}`, OpenPose's own JSON, COCO annotations,
    or a plain list. Formats: coco17, body25, blazepose33, h36m17, lsp14, mpii16.

    **Label sets**: ellipbody20, body14, lsp6, surreal14, cdcl14, densepose24, lip20, atr18, pascal6, sapiens28, up3d31,
    full1. Id 255 is ignored. Without --parts, the keypoints alone are fitted.

    **Results** in FOLDER: overlay.png (look at this first), parts.png, body.npz (parameters), body.json (measurements in
    cm, joints), ellipbody.glb (opens in Blender), loss.png, report.json.

    Example: `partdr fit photo.jpg --keypoints photo.json --parts photo.png --labels cdcl14 --out fitted`
    """
    # loaded here, so that --help is quick
    import warp as wp

    wp.config.quiet = True
    from .fitting import FitOptions, fit_body
    from .inputs import check_sizes, choose_person, read_keypoints, read_label_set, read_parts, read_photo
    from .output import save_fit
    from .progress import FitProgress

    where = _device(device)
    picture = None if photo is None else read_photo(photo)
    label_set = read_label_set(labels)
    image = None if parts is None else read_parts(parts, label_set)
    check_sizes(
        photo=None if picture is None else picture.shape[:2], parts=None if image is None else image.groups.shape
    )
    people = read_keypoints(keypoints, keypoint_format)
    chosen = choose_person(people, None if image is None else image.groups, person)
    others = tuple(other for other in people if other is not chosen)
    with FitProgress() as progress:
        result = fit_body(
            chosen, image, others=others, options=FitOptions(seed=seed), device=where, progress=progress
        )
        report = save_fit(result, out, keypoints=chosen, parts=image, photo=picture, others=others)
    _summarise(report, out)


def _device(name: str) -> str:
    import torch

    if name == "auto":
        return "cuda" if torch.cuda.is_available() else "cpu"
    if name != "cpu" and not (name.split(":")[0] == "cuda" and torch.cuda.is_available()):
        raise InputError(f"--device: {name}; expected cpu, or cuda on a machine that has it")
    return name


def _summarise(report: dict, out: Path) -> None:  # type: ignore[type-arg]
    share = report["keypoints"]["mean_distance_share_of_person_height"]
    lines = [
        f"{report['hypotheses']} hypotheses, {report['seconds_total']:.1f} s",
        f"keypoints {report['keypoints']['mean_distance_px']:.1f} px off on average"
        + (f" ({100 * share:.1f} % of the person's height)" if share else ""),
    ]
    if "parts" in report:
        scores = report["parts"]
        lines.append(f"foreground F1 {scores['foreground_f1']:.3f}, part F1 {scores['part_f1']:.3f}")
    typer.echo("; ".join(lines))
    typer.echo(f"{out / 'overlay.png'} shows the body, {out / 'body.json'} its measurements")


def main() -> None:
    """Run the command; bad input is one line on stderr and exit code 2."""
    try:
        app()
    except InputError as error:
        typer.echo(f"partdr: {error}", err=True)
        sys.exit(2)
