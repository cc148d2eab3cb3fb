"""Command ``partdr convert``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from typer import Argument

CONVERT_HELP = """Convert a pickle of SMPL, SMPL-H, SMPL-X or SKEL to .npz, without running code in it.

Examples: `partdr convert basicModel_neutral_lbs_10_207_0_v1.0.0.pkl smpl_neutral.npz`;
`partdr convert skel_models_v1.1/skel_male.pkl skel_male.npz`

A pickle can run code when it is loaded. This command takes only plain arrays from it and refuses everything else. You
can give the .npz to the option --model of `partdr fit` and `partdr register`.
"""


def convert(
    pickle: Annotated[Path, Argument(help="Model file, .pkl.", metavar="MODEL.pkl")],
    out: Annotated[Path, Argument(help="File to write, .npz.", metavar="MODEL.npz")],
) -> None:
    """Convert a model; see ``CONVERT_HELP``."""
    from ..models.model_pickles import convert_pickle

    typer.echo(f"{out}: {convert_pickle(pickle, out)}")
