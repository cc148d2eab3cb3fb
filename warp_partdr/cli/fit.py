"""Command ``partdr fit``: bodies of all people in a photo or film, or of the person whose keypoints are given."""

from __future__ import annotations

from ..body.labels import LABEL_SETS
from ..body.skeletons import SKELETONS
from ..inputs.films import is_film
from .fit_request import FitRequest

FIT_HELP = f"""Fit a body of 20 ellipsoids and a skinned mesh to all people in a photo or film, or to one person.

Examples: `partdr fit photo.jpg`; `partdr fit p.jpg --keypoints p.json --parts p.png --labels cdcl14`

**2D keypoints** are JSON: `{{"format": "coco17", "keypoints": [[x, y, confidence], ...]}}`, or a file of OpenPose,
COCO, MMPose and others. Formats: {", ".join(SKELETONS)}; or your own.

**Part labels** are as large as the picture: ids, a network's probabilities, or each person's mask (full1). Without
them, only keypoints are fitted. Label sets: {", ".join(LABEL_SETS)}; or a JSON file of your own
(docs/reference/inputs.md).

**Results** for a person: overlay.png (look at it first), parts.png, loss.png, body.json (measurements), body.npz,
ellipbody.glb (for Blender), report.json; and for the mesh views.png (from four sides), detailed.png, detailed.glb,
detailed.obj, detailed.ply, detailed.bvh, detailed.npz, registration.json. For a photo, each person has a folder;
report.html shows all people, the least confident body first (look at it first), views.png shows them from four sides,
and people.json lists them. For a film: overlay.mp4, scene.glb, people.json, and a .npz, .glb and .bvh for each person.
Older results are replaced.

**Settings** (docs/reference/settings.md): `stature=1.78` (a person's height [m], in films, too),
`trust_background=true`, `landmarks=full` (for photos and films: faster keypoints, farther from the truth),
`weights.prior=5`, `labels.size=256`,
`mesh.apart=0.1`, `threads=4`, `also=usdz,fbx` (more files, also usda); with --model none also `outline=true`
(outlines nearer to the labels, joints farther from the truth) and `outline=labels-first` (even more so).
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
