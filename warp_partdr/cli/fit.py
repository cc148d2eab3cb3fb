"""The command ``partdr fit``: bodies of everyone in a photo or film, or of the person whose keypoints are given."""

from __future__ import annotations

from ..body.labels import LABEL_SETS
from ..body.skeletons import SKELETONS
from ..inputs.films import is_film
from .fit_request import FitRequest

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
`outline=true` (nearer outlines, farther joints), `outline=labels-first` (even more so), both with --model none.
"""


def fit(request: FitRequest) -> None:
    """Fit bodies; see ``FIT_HELP``."""
    if request.photo is not None and is_film(request.photo):
        from .fit_film import fit_motions

        fit_motions(request)
    elif request.files.keypoints is None:
        from .fit_photo import fit_everyone

        fit_everyone(request)
    else:
        from .fit_person import fit_person

        fit_person(request)
