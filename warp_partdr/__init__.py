"""Differentiable rendering of body parts, and reconstruction of human pose and shape.

Importing this package loads nothing but itself: each public name is fetched from its module when it is first used
(PEP 562), so that neither torch nor Warp nor PyVista starts before it is needed, and no kernel is compiled.

A new public name goes into ``_EXPORTS`` and into the ``TYPE_CHECKING`` block; a test keeps the two alike.
"""

from importlib import import_module
from typing import TYPE_CHECKING

__version__ = "0.1.0"

# Public name: the submodule that defines it. No name may be that of a submodule, which would hide it once imported.
_EXPORTS = {
    "RendererEllipsoids": "render.renderers",
    "RendererMesh": "render.renderers",
    "anny": "clothing.anny",
    "anny_shape": "clothing.anny",
    "Detailed": "clothing.model",
    "DetailedModel": "clothing.model",
    "load_model": "clothing.load",
    "pose_from_ellipbody": "clothing.pose",
    "EllipBody": "body.ellipbody",
    "PosedEllipBody": "body.ellipbody",
    "LabelSet": "body.labels",
    "label_set": "body.labels",
    "regroup": "body.labels",
    "rotation_from_6d": "body.rotations",
    "rotation_from_axis_angle": "body.rotations",
    "rotation_to_6d": "body.rotations",
    "rotation_to_axis_angle": "body.rotations",
    "Skeleton": "body.skeletons",
    "skeleton": "body.skeletons",
    "JOINT_NAMES": "body.template",
    "LENGTH_NAMES": "body.template",
    "PART_NAMES": "body.template",
    "THICKNESS_NAMES": "body.template",
    "BodyFile": "results.body_file",
    "load_body": "results.body_file",
    "Crop": "cameras",
    "Perspective": "cameras",
    "WeakPerspective": "cameras",
    "detailed_mesh": "clothing.mesh",
    "Ellipsoids": "render.ellipsoids",
    "EllipsoidImage": "render.ellipsoids",
    "draw_ellipsoids": "render.ellipsoids",
    "ellipsoid_label_loss": "render.ellipsoids",
    "Energy": "refinement.energy",
    "Observation": "inputs.observation",
    "Weights": "refinement.energy",
    "InputError": "errors",
    "ellipbody_scene": "results.ellipbody_files",
    "FitOptions": "fit.options",
    "FitResult": "fit.result",
    "fit_body": "fit.fitting",
    "about_network": "network.checkpoint",
    "load_label_network": "network.checkpoint",
    "EllipBodyNet": "network.ellipbodynet",
    "LabelNetwork": "network.label_network",
    "load_ellipbodynet": "network.picture_checkpoint",
    "predict_bodies": "network.predict",
    "observe": "inputs.observation",
    "CapturedRefinement": "refinement.captured",
    "get_num_threads": "kernels.launch",
    "set_num_threads": "kernels.launch",
    "read_keypoints": "inputs.keypoint_files",
    "Keypoints2D": "inputs.keypoints",
    "choose_person": "inputs.keypoints",
    "PartMesh": "render.part_mesh",
    "ellipbody_mesh": "render.part_mesh",
    "save_fit": "results.save",
    "BodyParameters": "body.parameters",
    "PartLabels": "inputs.part_labels",
    "read_label_set": "inputs.part_labels",
    "read_parts": "inputs.part_labels",
    "read_photo": "inputs.part_labels",
    "PosePrior": "body.pose_prior",
    "up_direction": "body.pose_prior",
    "Posed": "body.posing",
    "pose": "body.posing",
    "Stage": "fit.stages",
    "Refined": "refinement.steps",
    "Registered": "clothing.registration",
    "RegistrationOptions": "clothing.registration",
    "RegistrationWeights": "clothing.registration",
    "register": "clothing.registration",
    "refine": "refinement.refine",
    "PartImage": "render.mesh",
    "mesh_label_loss": "render.mesh",
    "draw_mesh": "render.mesh",
    "coarsest_subdivisions": "render.subdivisions",
    "silhouette_error": "render.subdivisions",
}

__all__ = sorted(["__version__", *_EXPORTS])

if TYPE_CHECKING:
    from .body.ellipbody import EllipBody as EllipBody
    from .body.ellipbody import PosedEllipBody as PosedEllipBody
    from .body.labels import LabelSet as LabelSet
    from .body.labels import label_set as label_set
    from .body.labels import regroup as regroup
    from .body.parameters import BodyParameters as BodyParameters
    from .body.pose_prior import PosePrior as PosePrior
    from .body.pose_prior import up_direction as up_direction
    from .body.posing import Posed as Posed
    from .body.posing import pose as pose
    from .body.rotations import rotation_from_6d as rotation_from_6d
    from .body.rotations import rotation_from_axis_angle as rotation_from_axis_angle
    from .body.rotations import rotation_to_6d as rotation_to_6d
    from .body.rotations import rotation_to_axis_angle as rotation_to_axis_angle
    from .body.skeletons import Skeleton as Skeleton
    from .body.skeletons import skeleton as skeleton
    from .body.template import JOINT_NAMES as JOINT_NAMES
    from .body.template import LENGTH_NAMES as LENGTH_NAMES
    from .body.template import PART_NAMES as PART_NAMES
    from .body.template import THICKNESS_NAMES as THICKNESS_NAMES
    from .cameras import Crop as Crop
    from .cameras import Perspective as Perspective
    from .cameras import WeakPerspective as WeakPerspective
    from .clothing.anny import anny as anny
    from .clothing.anny import anny_shape as anny_shape
    from .clothing.load import load_model as load_model
    from .clothing.mesh import detailed_mesh as detailed_mesh
    from .clothing.model import Detailed as Detailed
    from .clothing.model import DetailedModel as DetailedModel
    from .clothing.pose import pose_from_ellipbody as pose_from_ellipbody
    from .clothing.registration import Registered as Registered
    from .clothing.registration import RegistrationOptions as RegistrationOptions
    from .clothing.registration import RegistrationWeights as RegistrationWeights
    from .clothing.registration import register as register
    from .errors import InputError as InputError
    from .fit.fitting import fit_body as fit_body
    from .fit.options import FitOptions as FitOptions
    from .fit.result import FitResult as FitResult
    from .fit.stages import Stage as Stage
    from .inputs.keypoint_files import read_keypoints as read_keypoints
    from .inputs.keypoints import Keypoints2D as Keypoints2D
    from .inputs.keypoints import choose_person as choose_person
    from .inputs.observation import Observation as Observation
    from .inputs.observation import observe as observe
    from .inputs.part_labels import PartLabels as PartLabels
    from .inputs.part_labels import read_label_set as read_label_set
    from .inputs.part_labels import read_parts as read_parts
    from .inputs.part_labels import read_photo as read_photo
    from .kernels.launch import get_num_threads as get_num_threads
    from .kernels.launch import set_num_threads as set_num_threads
    from .network.checkpoint import about_network as about_network
    from .network.checkpoint import load_label_network as load_label_network
    from .network.ellipbodynet import EllipBodyNet as EllipBodyNet
    from .network.label_network import LabelNetwork as LabelNetwork
    from .network.picture_checkpoint import load_ellipbodynet as load_ellipbodynet
    from .network.predict import predict_bodies as predict_bodies
    from .refinement.captured import CapturedRefinement as CapturedRefinement
    from .refinement.energy import Energy as Energy
    from .refinement.energy import Weights as Weights
    from .refinement.refine import refine as refine
    from .refinement.steps import Refined as Refined
    from .render.ellipsoids import EllipsoidImage as EllipsoidImage
    from .render.ellipsoids import Ellipsoids as Ellipsoids
    from .render.ellipsoids import draw_ellipsoids as draw_ellipsoids
    from .render.ellipsoids import ellipsoid_label_loss as ellipsoid_label_loss
    from .render.mesh import PartImage as PartImage
    from .render.mesh import draw_mesh as draw_mesh
    from .render.mesh import mesh_label_loss as mesh_label_loss
    from .render.part_mesh import PartMesh as PartMesh
    from .render.part_mesh import ellipbody_mesh as ellipbody_mesh
    from .render.renderers import RendererEllipsoids as RendererEllipsoids
    from .render.renderers import RendererMesh as RendererMesh
    from .render.subdivisions import coarsest_subdivisions as coarsest_subdivisions
    from .render.subdivisions import silhouette_error as silhouette_error
    from .results.body_file import BodyFile as BodyFile
    from .results.body_file import load_body as load_body
    from .results.ellipbody_files import ellipbody_scene as ellipbody_scene
    from .results.save import save_fit as save_fit
else:

    def __getattr__(name: str) -> object:
        """Fetch a public name from its submodule, once."""
        if name not in _EXPORTS:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        value = getattr(import_module(f".{_EXPORTS[name]}", __name__), name)
        globals()[name] = value
        return value


def __dir__() -> list[str]:
    """Public names alone, not the submodules that happen to be loaded."""
    return list(__all__)
