"""Files of films' people: what looks wrong in them is told."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scenes.films import write_film
from scenes.motions import COUNT, LATE, RATE, SIZE, made_fit

from warp_partdr.body.landmarks import annotated
from warp_partdr.body.skeletons import skeleton
from warp_partdr.detection.person import SKELETON
from warp_partdr.errors import InputError
from warp_partdr.results.save_film import save_film_fit
from warp_partdr.scenes.film import FilmFit


def seen_fit() -> FilmFit:
    """The fit of which keypoints are known, where the bodies have them."""
    fit = made_fit()
    (film,) = fit.films
    rows = film.people.rows.copy()
    for person, motion in fit.motions.items():
        names = annotated(skeleton(SKELETON).landmarks, motion.model.landmark_names)
        marks = motion.model.landmarks(motion.bodies().detailed, names)
        points = film.view.camera.project(marks)[..., :2].numpy()
        mine = rows["tracks"] == person
        rows["keypoints"][mine] = np.concatenate([points, np.ones_like(points[..., :1])], axis=-1)
        rows["boxes"][mine] = np.concatenate([points.min(1), points.max(1)], axis=-1)
    return replace(fit, films=(replace(film, people=replace(film.people, rows=rows)),))


@pytest.mark.parametrize("off", [0.0, 0.03, 0.09])
def test_a_body_far_from_its_keypoints_is_told(tmp_path: Path, off: float) -> None:
    """``off``: share of the second person's size by which keypoints are beside the body."""
    film = write_film(tmp_path / "walk.mp4", [np.full((*SIZE, 3), 90, np.uint8)] * COUNT, rate=RATE)
    fit = seen_fit()
    rows = fit.people.rows
    mine = (rows["tracks"] == 1) & (rows["frames"] >= LATE)
    sizes = (rows["boxes"][mine, 2:] - rows["boxes"][mine, :2]).max(1)
    rows["keypoints"][mine, :, 0] += off * sizes[:, None]
    told = save_film_fit(fit, tmp_path / "out", films=[film])["warnings"]
    expected = f"{film}: person1 ends 9.0 % of the person's size from BlazePose's keypoints; expected at most 6 %"
    assert told == ([expected] if off > 0.06 else [])


def test_other_films_than_the_fit_s_are_refused(tmp_path: Path) -> None:
    fit = made_fit()
    for wrong, told in (
        ({"films": []}, "films: 0 files; expected 1, those of the fit"),
        ({"films": ["walk.mp4"], "formats": ["obj"]}, "formats: 'obj'; expected of usda, usdz, fbx"),
    ):
        with pytest.raises(InputError, match=told):
            save_film_fit(fit, tmp_path / "out", **wrong)  # type: ignore[arg-type]
    assert not (tmp_path / "out").exists()
