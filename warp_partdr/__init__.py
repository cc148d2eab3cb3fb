"""Differentiable rendering of body parts, and reconstruction of human pose and shape.

Public names are those of this package and of its public submodules: ``warp_partdr.metrics`` (errors of bodies and part
maps), ``warp_partdr.plot`` (figures) and ``warp_partdr.benchmark`` (fits on people of known truth). Each name has one
public path. All other modules are the implementation and may change at any time.

Importing this package loads nothing but itself: each public name is fetched from its module when it is first used
(PEP 562), so that neither torch nor Warp nor PyVista starts before it is needed, and no kernel is compiled.

Where this package is the first to import Warp, Warp tells warnings and errors alone; after that,
``wp.config.log_level = wp.LOG_INFO`` shows its other messages. A program that imports Warp first keeps its own setting.

A new public name goes into ``_EXPORTS`` and into the ``TYPE_CHECKING`` block; a test keeps the two alike.
"""

from typing import TYPE_CHECKING

from ._lazy import lazy_names

__version__ = "0.1.0"

# Public name: the submodule that defines it. No name may be that of a submodule, which would hide it once imported.
_EXPORTS = {
    "EllipBody": "body.ellipbody",
    "label_set": "body.labels",
    "landmark_positions": "body.landmarks",
    "BodyLeaves": "body.parameters",
    "BodyParameters": "body.parameters",
    "PosePrior": "body.pose_prior",
    "pose": "body.posing",
    "Posed": "body.posing",
    "rotation_from_6d": "body.rotations",
    "rotation_from_axis_angle": "body.rotations",
    "rotation_to_6d": "body.rotations",
    "rotation_to_axis_angle": "body.rotations",
    "skeleton": "body.skeletons",
    "BONE_STARTS": "body.template",
    "JOINT_NAMES": "body.template",
    "LENGTH_NAMES": "body.template",
    "PART_NAMES": "body.template",
    "SIZE_COLUMNS": "body.template",
    "THICKNESS_NAMES": "body.template",
    "open_source": "bulk.opening",
    "PeopleFitter": "bulk.people",
    "make_dataset": "bulk.run",
    "Shards": "bulk.shards",
    "Crop": "cameras",
    "Perspective": "cameras",
    "ScreenCamera": "cameras",
    "WeakPerspective": "cameras",
    "anny": "models.anny",
    "anny_shape": "models.anny",
    "load_model": "models.load",
    "detailed_mesh": "models.model",
    "pose_from_ellipbody": "models.pose",
    "register": "models.registration",
    "Registered": "models.registration",
    "RegistrationOptions": "models.registration",
    "RegistrationWeights": "models.registration",
    "from_smplx": "models.smpl_parameters",
    "to_smplx": "models.smpl_parameters",
    "vertex_parts": "models.surfaces",
    "find_film_people": "networks.detection.film_people",
    "BoxNetwork": "networks.detection.given_boxes",
    "InputError": "errors",
    "explain": "solve.ellipsoids.explain",
    "fit_body": "solve.ellipsoids.fitting",
    "refine_mesh": "solve.mesh.mesh_stage",
    "refine_meshes": "solve.mesh.mesh_stage",
    "FitOptions": "solve.ellipsoids.options",
    "FitResult": "solve.ellipsoids.result",
    "change_options": "solve.ellipsoids.settings",
    "Stage": "solve.ellipsoids.stages",
    "read_cameras": "inputs.camera_files",
    "read_keypoints": "inputs.keypoint_files",
    "choose_person": "inputs.keypoints",
    "observe": "inputs.observation",
    "read_parts": "inputs.part_labels",
    "read_photo": "inputs.part_labels",
    "set_graph_memory": "interop.graph_cache",
    "TrainingStep": "interop.training_step",
    "set_num_threads": "kernels.launch",
    "load_label_network": "networks.regression.checkpoint",
    "predict_bodies": "networks.regression.predict",
    "load_keypoint_network": "networks.predictors.checkpoints",
    "load_part_network": "networks.predictors.checkpoints",
    "find_film_predictions": "networks.predictors.film_predictions",
    "GivenNetworks": "networks.predictors.film_predictions",
    "KeypointNetwork": "networks.predictors.networks",
    "PartNetwork": "networks.predictors.networks",
    "Energy": "solve.ellipsoids.energy",
    "Weights": "solve.ellipsoids.energy",
    "energy_loss": "solve.ellipsoids.energy_loss",
    "refine": "solve.ellipsoids.refine",
    "draw_ellipsoids": "render.ellipsoids",
    "ellipsoid_label_loss": "render.ellipsoids",
    "Ellipsoids": "render.ellipsoids",
    "draw_mesh": "render.mesh",
    "mesh_label_loss": "render.mesh",
    "ellipbody_mesh": "render.part_mesh",
    "PartMesh": "render.part_mesh",
    "RendererEllipsoids": "render.renderers",
    "RendererMesh": "render.renderers",
    "coarsest_subdivisions": "render.subdivisions",
    "silhouette_error": "render.subdivisions",
    "load_body": "results.body_file",
    "check_result": "results.result_sets",
    "save_fit": "results.save",
    "save_registered": "results.save",
    "save_film_fit": "results.save_film",
    "save_photo_fit": "results.save_photo",
    "place_cameras": "pipelines.camera_poses",
    "fit_film": "pipelines.film",
    "place_film_cameras": "pipelines.film_cameras",
    "align_films": "pipelines.film_times",
    "fit_scene": "solve.scene.fitting",
    "match_films": "pipelines.matched_times",
    "fit_photo": "pipelines.photo",
    "Scene": "inputs.scene",
    "SceneObservation": "inputs.scene",
    "View": "inputs.scene",
    "ObservedFilm": "pipelines.observed_film",
}

__all__ = sorted(["__version__", *_EXPORTS])

if TYPE_CHECKING:
    from .body.ellipbody import EllipBody as EllipBody
    from .body.labels import label_set as label_set
    from .body.landmarks import landmark_positions as landmark_positions
    from .body.parameters import BodyLeaves as BodyLeaves
    from .body.parameters import BodyParameters as BodyParameters
    from .body.pose_prior import PosePrior as PosePrior
    from .body.posing import Posed as Posed
    from .body.posing import pose as pose
    from .body.rotations import rotation_from_6d as rotation_from_6d
    from .body.rotations import rotation_from_axis_angle as rotation_from_axis_angle
    from .body.rotations import rotation_to_6d as rotation_to_6d
    from .body.rotations import rotation_to_axis_angle as rotation_to_axis_angle
    from .body.skeletons import skeleton as skeleton
    from .body.template import BONE_STARTS as BONE_STARTS
    from .body.template import JOINT_NAMES as JOINT_NAMES
    from .body.template import LENGTH_NAMES as LENGTH_NAMES
    from .body.template import PART_NAMES as PART_NAMES
    from .body.template import SIZE_COLUMNS as SIZE_COLUMNS
    from .body.template import THICKNESS_NAMES as THICKNESS_NAMES
    from .bulk.opening import open_source as open_source
    from .bulk.people import PeopleFitter as PeopleFitter
    from .bulk.run import make_dataset as make_dataset
    from .bulk.shards import Shards as Shards
    from .cameras import Crop as Crop
    from .cameras import Perspective as Perspective
    from .cameras import ScreenCamera as ScreenCamera
    from .cameras import WeakPerspective as WeakPerspective
    from .errors import InputError as InputError
    from .inputs.camera_files import read_cameras as read_cameras
    from .inputs.keypoint_files import read_keypoints as read_keypoints
    from .inputs.keypoints import choose_person as choose_person
    from .inputs.observation import observe as observe
    from .inputs.part_labels import read_parts as read_parts
    from .inputs.part_labels import read_photo as read_photo
    from .inputs.scene import Scene as Scene
    from .inputs.scene import SceneObservation as SceneObservation
    from .inputs.scene import View as View
    from .interop.graph_cache import set_graph_memory as set_graph_memory
    from .interop.training_step import TrainingStep as TrainingStep
    from .kernels.launch import set_num_threads as set_num_threads
    from .models.anny import anny as anny
    from .models.anny import anny_shape as anny_shape
    from .models.load import load_model as load_model
    from .models.model import detailed_mesh as detailed_mesh
    from .models.pose import pose_from_ellipbody as pose_from_ellipbody
    from .models.registration import Registered as Registered
    from .models.registration import RegistrationOptions as RegistrationOptions
    from .models.registration import RegistrationWeights as RegistrationWeights
    from .models.registration import register as register
    from .models.smpl_parameters import from_smplx as from_smplx
    from .models.smpl_parameters import to_smplx as to_smplx
    from .models.surfaces import vertex_parts as vertex_parts
    from .networks.detection.film_people import find_film_people as find_film_people
    from .networks.detection.given_boxes import BoxNetwork as BoxNetwork
    from .networks.predictors.checkpoints import load_keypoint_network as load_keypoint_network
    from .networks.predictors.checkpoints import load_part_network as load_part_network
    from .networks.predictors.film_predictions import GivenNetworks as GivenNetworks
    from .networks.predictors.film_predictions import find_film_predictions as find_film_predictions
    from .networks.predictors.networks import KeypointNetwork as KeypointNetwork
    from .networks.predictors.networks import PartNetwork as PartNetwork
    from .networks.regression.checkpoint import load_label_network as load_label_network
    from .networks.regression.predict import predict_bodies as predict_bodies
    from .pipelines.camera_poses import place_cameras as place_cameras
    from .pipelines.film import fit_film as fit_film
    from .pipelines.film_cameras import place_film_cameras as place_film_cameras
    from .pipelines.film_times import align_films as align_films
    from .pipelines.matched_times import match_films as match_films
    from .pipelines.observed_film import ObservedFilm as ObservedFilm
    from .pipelines.photo import fit_photo as fit_photo
    from .render.ellipsoids import Ellipsoids as Ellipsoids
    from .render.ellipsoids import draw_ellipsoids as draw_ellipsoids
    from .render.ellipsoids import ellipsoid_label_loss as ellipsoid_label_loss
    from .render.mesh import draw_mesh as draw_mesh
    from .render.mesh import mesh_label_loss as mesh_label_loss
    from .render.part_mesh import PartMesh as PartMesh
    from .render.part_mesh import ellipbody_mesh as ellipbody_mesh
    from .render.renderers import RendererEllipsoids as RendererEllipsoids
    from .render.renderers import RendererMesh as RendererMesh
    from .render.subdivisions import coarsest_subdivisions as coarsest_subdivisions
    from .render.subdivisions import silhouette_error as silhouette_error
    from .results.body_file import load_body as load_body
    from .results.result_sets import check_result as check_result
    from .results.save import save_fit as save_fit
    from .results.save import save_registered as save_registered
    from .results.save_film import save_film_fit as save_film_fit
    from .results.save_photo import save_photo_fit as save_photo_fit
    from .solve.ellipsoids.energy import Energy as Energy
    from .solve.ellipsoids.energy import Weights as Weights
    from .solve.ellipsoids.energy_loss import energy_loss as energy_loss
    from .solve.ellipsoids.explain import explain as explain
    from .solve.ellipsoids.fitting import fit_body as fit_body
    from .solve.ellipsoids.options import FitOptions as FitOptions
    from .solve.ellipsoids.refine import refine as refine
    from .solve.ellipsoids.result import FitResult as FitResult
    from .solve.ellipsoids.settings import change_options as change_options
    from .solve.ellipsoids.stages import Stage as Stage
    from .solve.mesh.mesh_stage import refine_mesh as refine_mesh
    from .solve.mesh.mesh_stage import refine_meshes as refine_meshes
    from .solve.scene.fitting import fit_scene as fit_scene
else:
    __getattr__ = lazy_names(__name__, _EXPORTS)


def __dir__() -> list[str]:
    """Public names alone, not the submodules that happen to be loaded."""
    return list(__all__)
