"""Measure what the ground does for people whose camera nobody knows, as in the scene of a photo's fit.

    python scripts/measure_photo_ground.py [FIRST LAST]

Groups of PartBench, seen with noise, are fitted one by one with weak perspective (``--quality fast`` and the mesh
stage), and placed before a camera whose focal length is the picture's diagonal. The figure is the error of the ratio of
two people's distances, in percent, with 95 % intervals over groups.
"""

from __future__ import annotations

import argparse
from itertools import combinations

import numpy as np

from warp_partdr import metrics
from warp_partdr.evaluation.evaluate import one_thread
from warp_partdr.fit.fitting import fit_evidence
from warp_partdr.fit.mesh_stage import refine_meshes
from warp_partdr.fit.options import FitOptions
from warp_partdr.inputs.evidence import weigh_evidence
from warp_partdr.results.scene_places import place_on_ground
from warp_partdr.synthetic.scene_people import SceneSample, depths_of, make_group


def ratio_errors(sample: SceneSample) -> list[float]:
    """Mean error of the logarithm of two people's ratio of distances, without and with the ground."""
    sights = sample.scene.sights
    options = FitOptions.at("fast").without_outline()
    fits = refine_meshes([fit_evidence(weigh_evidence(each.keypoints, each.parts), options) for each in sights])
    places = place_on_ground(fits, [each.keypoints for each in sights], sample.parts.shape[1:])
    true = depths_of(sample.scene, sample.joints)
    found = [each.distance / each.scale for each in places], [each.distance for each in places]
    pairs = list(combinations(range(len(true)), 2))
    return [float(np.mean([abs(np.log(z[a] / z[b] * true[b] / true[a])) for a, b in pairs])) for z in found]


def main() -> None:
    """Fit, and print the errors and their difference."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("people", type=int, nargs="*", default=[100, 123], help="first and last")
    first, last = parser.parse_args().people
    one_thread()
    errors = 100 * np.array([ratio_errors(make_group(index)) for index in range(first, last + 1)])
    for name, values in zip(("without", "with", "difference"), (*errors.T, errors[:, 1] - errors[:, 0]), strict=True):
        low, high = metrics.bootstrap_sum(values, lambda sums: sums / len(errors))
        print(f"{name}: {values.mean():.1f} % ({low:.1f} to {high:.1f})")


if __name__ == "__main__":
    main()
