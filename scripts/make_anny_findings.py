"""Make the packaged findings about Anny, ``warp_partdr/assets/anny_findings.npz``: its skin, and its reduced meshes.

    python scripts/make_anny_findings.py

``warp_partdr/models/packaged.py`` reads the file. It is to be made anew after ``make_anny_asset.py``, and after changes
of how vertices are chosen; ``tests/models/test_packaged.py`` says so.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from warp_partdr.lab.harness import run_script
from warp_partdr.models.anny import anny
from warp_partdr.models.packaged import FINDINGS, findings_start
from warp_partdr.models.reduction import few_name, find_few, first_count
from warp_partdr.models.surfaces import SKIN, find_seen_vertices
from warp_partdr.solve.mesh.drawn_model import few_joints
from warp_partdr.solve.mesh.mesh_options import MeshOptions

ASSET = Path(__file__).resolve().parents[1] / "warp_partdr" / FINDINGS


def main() -> None:
    """Find and write."""
    whole, few = anny(), few_joints(anny())
    arrays: dict[str, Any] = {}
    for model in (whole, few):
        arrays[findings_start(model, SKIN) + "seen"] = find_seen_vertices(model).bool().numpy()
    for options in (MeshOptions.at("balanced"), MeshOptions.at("accurate")):
        count = int(first_count(options.skin_error))
        start = findings_start(few, few_name(count))
        found = find_few(few, count)
        arrays |= {start + name: values for name, values in vars(found).items()}
        arrays[start + "moves"] = found.moves.astype(np.float32)
    np.savez_compressed(ASSET, **arrays)


if __name__ == "__main__":
    run_script(main)
