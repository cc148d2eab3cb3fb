"""Options of few steps, one of each kind of work, for tests that do not depend on the numbers.

A test that needs another number replaces that number alone.
"""

from __future__ import annotations

from dataclasses import replace

from warp_partdr.models.registration import RegistrationOptions
from warp_partdr.solve.ellipsoids.options import FitOptions
from warp_partdr.solve.ellipsoids.stages import Stage
from warp_partdr.solve.mesh.mesh_options import MeshOptions
from warp_partdr.solve.scene.options import SceneOptions

# A fit of ellipsoids that starts from the network, and one that searches.
QUICK_FIT = FitOptions(stages=(Stage("lift", 8, 6, 0.1), Stage("labels", 2, 4, 0.02, 64)))
QUICK_SEARCH = FitOptions(
    start="search",
    stages=(Stage("lift", 64, 20, 0.1), Stage("keypoints", 64, 10, 0.04), Stage("labels", 6, 40, 0.02, 96)),
)
QUICK_MESH = MeshOptions(iterations=20, size=96, vertices=800)
QUICK_SCENE = SceneOptions(mesh=replace(QUICK_MESH, iterations=30, learning_rate=0.02), together=128)
QUICK_REGISTRATION = RegistrationOptions(iterations=40)
# Options of the commands that fit a scene or a film.
QUICK_COMMAND = "--device cpu --set mesh.iterations=3 --set mesh.size=96"
