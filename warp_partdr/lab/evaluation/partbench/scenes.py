"""PartBench's scenes, and how they are fitted: all together, or without what the scene adds."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import torch

from ....errors import InputError
from ....inputs.scene import View
from ....pipelines.camera_poses import place_cameras
from ....solve.mesh.mesh_options import MeshOptions
from ....solve.scene.fitting import fit_scene
from ....solve.scene.observations import observe_scene
from ....solve.scene.options import SceneOptions
from ...synthetic.mocap import Clip
from ...synthetic.mocap_files import FRAME_RATE, held_out_windows
from ...synthetic.partbench_people import NUM_PEOPLE
from ...synthetic.scene_people import SceneSample, in_wrong_order, make_clip, make_group, make_pair, make_views
from ..scene_scoring import SceneBodies, score_scene
from ..scoring import Score
from .samples import CLIP, GROUPS, PAIRS, SCENES, VIEWS, check_people, source_name

CAMERAS = (2, 4)  # of the level "views"
_SECONDS = 2.0  # of a clip
# Standard deviations [frames] of 1/30 s, of the usual smoothing after fits of single frames.
SMOOTHED = {f"frames alone, smoothed by {width:g}": width for width in (1.0, 2.0, 3.0, 4.5, 6.0)}
SMOOTHED_APART = {f"frames apart, smoothed by {width:g}": width for width in (2.0, 3.0, 4.5)}
# PartDR's rule, which alone has a z gradient, pulls about thrice as hard.
_PARTDR = MeshOptions(gradient="partdr", seg=0.033)


def partbench_scenes(
    indices: Sequence[int] = range(NUM_PEOPLE), levels: Sequence[str] = SCENES, mocap: Path | None = None
) -> list[SceneSample]:
    """Scenes of these people at each level, at the noise of "realistic".

    Args:
        indices: Numbers of the people. In a clip they have the shapes, and in "pairs" and "groups" they are the first
            person.
        levels: Levels among ``SCENES``.
        mocap: Folder of motion capture (``lab.synthetic.mocap_files``), which "clip" needs.

    Raises:
        InputError: If there are not so many people, or "clip" has no motion capture.
    """
    check_people(indices)
    samples = []
    for level in levels:
        if level == PAIRS:
            samples += [replace(make_pair(index), source=source_name(PAIRS)) for index in indices]
        elif level == GROUPS:
            samples += [replace(make_group(index), source=source_name(GROUPS)) for index in indices]
        elif level == VIEWS:
            samples += [
                replace(make_views(index, count), source=source_name(f"{VIEWS}, {count} cameras"))
                for count in CAMERAS
                for index in indices
            ]
        else:
            clips = _clips(mocap)
            samples += [
                replace(make_clip(index, clips[index % len(clips)], FRAME_RATE), source=source_name(CLIP))
                for index in indices
            ]
    return samples


def _clips(mocap: Path | None) -> list[Clip]:
    expected = "a folder with cmu_expmap.npz, as warp_partdr/lab/synthetic/mocap_files.py reads it"
    if mocap is None:
        raise InputError(f"--mocap: missing, but --level {CLIP} needs motion; expected {expected}")
    try:
        return held_out_windows(mocap, _SECONDS)
    except FileNotFoundError as error:
        raise InputError(f"--mocap: {error}; expected {expected}") from error


@dataclass(frozen=True)
class SceneMethod:
    """One way to fit a scene; as ``Method`` for a ``SceneSample``."""

    fit: Callable[[SceneSample, str], SceneBodies]
    levels: tuple[str, ...] = SCENES

    def serves(self, sample: object) -> bool:
        """True for scenes of its levels."""
        return isinstance(sample, SceneSample) and sample.source.startswith(tuple(map(source_name, self.levels)))

    def fit_sample(self, sample: SceneSample, device: str) -> SceneBodies:
        """Fit a scene."""
        return self.fit(sample, device)

    def score(self, sample: SceneSample, name: str, result: SceneBodies, seconds: float) -> Score:
        """Compare the bodies with the truth."""
        return score_scene(sample, name, result, seconds)


def fit_all_together(
    sample: SceneSample, device: str, *, options: SceneOptions | None = None, smoothing: float = 0.0
) -> SceneBodies:
    """Fit the whole scene, from the wrong order where the sample says so, and perhaps smooth the bodies afterwards."""
    observed_bodies = None
    if options is None and sample.scene.num_frames > 1:
        options = SceneOptions.film()
    if sample.wrong_order:
        with torch.no_grad():
            observed_bodies = in_wrong_order(sample, observe_scene(sample.scene, device))
    return SceneBodies(
        [fit_scene(sample.scene, options=options, device=device, observed_bodies=observed_bodies)], smoothing
    )


def fit_each_alone(sample: SceneSample, device: str) -> SceneBodies:
    """Fit each person as if nobody else were there, from where the network puts it: never from the wrong order."""
    scene = sample.scene
    return SceneBodies(
        [
            fit_scene(
                replace(
                    scene,
                    observations=[replace(each, person=0) for each in scene.observations if each.person == person],
                ),
                device=device,
            )
            for person in range(scene.num_people)
        ]
    )


def fit_first_view(sample: SceneSample, device: str) -> SceneBodies:
    """Fit what the first camera sees alone."""
    scene = sample.scene
    return SceneBodies(
        [fit_scene(replace(scene, observations=[s for s in scene.observations if s.view == 0]), device=device)]
    )


def fit_frames_apart(sample: SceneSample, device: str, *, smoothing: float) -> SceneBodies:
    """Fit each frame as if there were no other, shape and size too, and smooth the bodies afterwards."""
    scene = sample.scene
    fits = [
        fit_scene(
            replace(scene, observations=[replace(s, frame=0) for s in scene.observations if s.frame == frame]),
            device=device,
        )
        for frame in range(scene.num_frames)
    ]
    return SceneBodies(fits, smoothing, by_frame=True)


def fit_places_too(sample: SceneSample, device: str) -> SceneBodies:
    """Fit the scene without knowing where any camera but the first stands."""
    first, *others = sample.scene.views
    unknown = replace(sample.scene, views=[first, *(View(view.camera) for view in others)])
    observed_bodies = observe_scene(unknown, device)
    return SceneBodies(
        [
            fit_scene(
                place_cameras(unknown, observed_bodies=observed_bodies), device=device, observed_bodies=observed_bodies
            )
        ]
    )


_FRAMES_ALONE = replace(SceneOptions.film(), smoothing=0.0, one_size=False)  # but with one shape, the mean of all
_NO_EXCHANGES = SceneOptions(mesh=_PARTDR, exchanges=False)
SCENE_METHODS: dict[str, SceneMethod] = {
    "scene": SceneMethod(fit_all_together),
    "each alone": SceneMethod(fit_each_alone, (PAIRS, GROUPS)),
    "scene, no ground": SceneMethod(partial(fit_all_together, options=SceneOptions(ground=0.0)), (PAIRS, GROUPS)),
    "scene, no exchanges": SceneMethod(partial(fit_all_together, options=SceneOptions(exchanges=False)), (PAIRS,)),
    "scene, z gradient, no exchanges": SceneMethod(partial(fit_all_together, options=_NO_EXCHANGES), (PAIRS,)),
    "scene, no z gradient, no exchanges": SceneMethod(
        partial(fit_all_together, options=replace(_NO_EXCHANGES, mesh=replace(_PARTDR, depth_weight=0.0))), (PAIRS,)
    ),
    "scene, no size of the clip": SceneMethod(
        partial(fit_all_together, options=replace(SceneOptions.film(), one_size=False)), (CLIP,)
    ),
    "scene, feet slide": SceneMethod(
        partial(fit_all_together, options=replace(SceneOptions.film(), sliding=0.0)), (CLIP,)
    ),
    "frames alone": SceneMethod(partial(fit_all_together, options=_FRAMES_ALONE), (CLIP,)),
    **{
        name: SceneMethod(partial(fit_all_together, options=_FRAMES_ALONE, smoothing=width), (CLIP,))
        for name, width in SMOOTHED.items()
    },
    **{
        name: SceneMethod(partial(fit_frames_apart, smoothing=width), (CLIP,)) for name, width in SMOOTHED_APART.items()
    },
    "first camera alone": SceneMethod(fit_first_view, (VIEWS,)),
    "cameras found": SceneMethod(fit_places_too, (VIEWS,)),
}
