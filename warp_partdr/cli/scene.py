"""Command ``partdr scene``: the motion of all people in films of several cameras."""

from __future__ import annotations

from ..inputs.films import film_facts
from .fit_film import fit_films
from .scene_request import SceneRequest

SCENE_HELP = """Fit motions to all people in films of several cameras. A second view measures depth.

Examples: `partdr scene left.mp4 right.mp4`; `partdr scene left.jpg right.jpg`; for one person and four calibrated
cameras, `partdr scene cam*.mp4 --cameras calibration/ --person 0`

Films (or photos) must start at the same moment; otherwise `--align` finds their common start. Their rates may differ or
vary, because frames are matched by their times. People are matched between the films by the points where rays meet.

**Cameras** must stand still. --cameras takes a file or a folder of Pose2Sim, Anipose, FreeMoCap, Caliscope, OpenCV,
EasyMocap, MC-Calib, Kalibr or Qualisys, or a JSON file of this project (docs/reference/inputs.md), in metres. A camera
belongs to
the film with its name or number (cam1 to cam1_sync.mp4); without such names, cameras are in the order of the films.
Distortion is removed. Without --cameras, the positions of the cameras are found from the people. Then give a person's
height, `--set stature=1.78` (metres), or distances follow from the sizes that people seem to have.

Results are those of `partdr fit film.mp4`, in the frame of the first film's camera, with an overlay of each film. If a
run was ended, the same command continues it. **Settings** for --set and --config are the same, too: `window=64`,
`overlap=12`, `smoothing=0.15` seconds, `mesh.iterations=60`, and more.
"""


def scene(request: SceneRequest) -> None:
    """Fit motions; see ``SCENE_HELP``."""
    for film in request.films:
        film_facts(film)  # raises faults of the file before anything is loaded
    fit_films(request.films, request, request.rig)
