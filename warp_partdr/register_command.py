"""The command ``partdr register``: from body.npz to a detailed body."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from .errors import InputError

REGISTER_HELP = """Clothe a fitted body in a detailed model: body.npz of `partdr fit` in, a skinned mesh out.

Example: `partdr register out/body.npz --out detailed`

**Results** in FOLDER: detailed.glb (mesh, skeleton and skin weights, posed; opens in Blender), detailed.obj,
detailed.ply (with part colours), detailed.bvh (skeleton and pose), detailed.npz (shape, rotations and position for the
model) and registration.json (terms of the loss). Older results there are replaced.
"""


def register_body(
    body: Annotated[Path, typer.Argument(help="body.npz of partdr fit.", metavar="BODY.npz")],
    model: Annotated[
        str, typer.Option(help="anny, or an .npz or .safetensors file of SMPL, SMPL-H or SMPL-X.", metavar="NAME")
    ] = "anny",
    out: Annotated[Path, typer.Option(help="Folder for the results.", metavar="FOLDER")] = Path("out"),
    inscribed: Annotated[
        bool,
        typer.Option("--inscribed", help="Keep the skin outside the ellipsoids; a fit's match its outlines instead."),
    ] = False,
    device: Annotated[
        str, typer.Option(help="cpu or cuda; auto takes CUDA where there is some.", metavar="NAME")
    ] = "auto",
) -> None:
    """Register a detailed model; see ``REGISTER_HELP``."""
    from .body_file import load_body

    fitted = load_body(body)

    import numpy as np
    import torch
    import warp as wp

    wp.config.log_level = wp.LOG_WARNING
    from .body.detailed_files import load_model
    from .detailed_files import save_detailed
    from .devices import choose_device
    from .output import check_folder, replacing
    from .posing import pose
    from .progress import FitProgress
    from .registration import RegistrationOptions, RegistrationWeights, register

    check_folder(out)
    where = choose_device(device)
    if where == "cpu":
        torch.set_num_threads(1)  # as ``fit`` does
    try:
        detailed_model = load_model(model, device=where)
    except ValueError as error:
        raise InputError(f"--model: {error}") from error
    names = ("global_orient", "translation", "rotations", "lengths", "thicknesses")
    posed = pose(*(torch.from_numpy(getattr(fitted, name))[None].to(where) for name in names))
    weights = RegistrationWeights.inscribed() if inscribed else RegistrationWeights()
    with FitProgress() as progress:
        registered = register(posed, detailed_model, options=RegistrationOptions(weights=weights), progress=progress)
    with replacing(out) as temporary:
        save_detailed(registered, temporary)
        numbers = {name: getattr(registered, name)[0].cpu().numpy() for name in ("shape", "rotations", "translation")}
        np.savez(temporary / "detailed.npz", model=np.array(detailed_model.name), **numbers)
        losses = {name: round(float(value[0]), 5) for name, value in registered.losses.items()}
        report = {"model": detailed_model.name, "losses": losses}
        (temporary / "registration.json").write_text(json.dumps(report, indent=1) + "\n")
    height = float(np.ptp(detailed_model.rest(registered.shape).vertices[0, :, 1].cpu().numpy()))
    typer.echo(f"{detailed_model.name}, {height:.2f} m tall at rest; {out / 'detailed.glb'} opens in Blender")
