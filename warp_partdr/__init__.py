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
    "anny": "body.anny",
    "anny_shape": "body.anny",
    "Detailed": "body.detailed",
    "DetailedModel": "body.detailed",
    "load_model": "body.detailed_files",
    "pose_from_ellipbody": "body.detailed_pose",
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
    "BodyFile": "body_file",
    "load_body": "body_file",
    "Crop": "cameras",
    "Perspective": "cameras",
    "WeakPerspective": "cameras",
    "detailed_mesh": "detailed",
    "Ellipsoids": "ellipsoids",
    "EllipsoidImage": "ellipsoids",
    "draw_ellipsoids": "ellipsoids",
    "ellipsoid_label_loss": "ellipsoids",
    "Energy": "energy",
    "Observation": "energy",
    "Weights": "energy",
    "InputError": "errors",
    "ellipbody_scene": "export",
    "FitOptions": "fitting",
    "FitResult": "fitting",
    "fit_body": "fitting",
    "about_network": "network.checkpoint",
    "load_label_network": "network.checkpoint",
    "EllipBodyNet": "network.ellipbodynet",
    "LabelNetwork": "network.label_network",
    "load_ellipbodynet": "network.picture_checkpoint",
    "predict_bodies": "network.predict",
    "observe": "observation",
    "FusedRefinement": "fused",
    "minimise": "fused",
    "get_num_threads": "kernels.threads",
    "set_num_threads": "kernels.threads",
    "read_keypoints": "keypoint_files",
    "Keypoints2D": "keypoints",
    "choose_person": "keypoints",
    "PartMesh": "mesh",
    "ellipbody_mesh": "mesh",
    "save_fit": "output",
    "BodyParameters": "parameters",
    "PartLabels": "part_files",
    "read_label_set": "part_files",
    "read_parts": "part_files",
    "read_photo": "part_files",
    "PosePrior": "pose_prior",
    "up_direction": "pose_prior",
    "Posed": "posing",
    "pose": "posing",
    "Stage": "quality",
    "Refined": "refinement",
    "Registered": "registration",
    "RegistrationOptions": "registration",
    "RegistrationWeights": "registration",
    "register": "registration",
    "refine": "refinement",
    "PartImage": "render",
    "label_loss": "render",
    "rasterize_parts": "render",
    "coarsest_subdivisions": "subdivisions",
    "silhouette_error": "subdivisions",
}

__all__ = sorted(["__version__", *_EXPORTS])

if TYPE_CHECKING:
    from .body.anny import anny as anny
    from .body.anny import anny_shape as anny_shape
    from .body.detailed import Detailed as Detailed
    from .body.detailed import DetailedModel as DetailedModel
    from .body.detailed_files import load_model as load_model
    from .body.detailed_pose import pose_from_ellipbody as pose_from_ellipbody
    from .body.ellipbody import EllipBody as EllipBody
    from .body.ellipbody import PosedEllipBody as PosedEllipBody
    from .body.labels import LabelSet as LabelSet
    from .body.labels import label_set as label_set
    from .body.labels import regroup as regroup
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
    from .body_file import BodyFile as BodyFile
    from .body_file import load_body as load_body
    from .cameras import Crop as Crop
    from .cameras import Perspective as Perspective
    from .cameras import WeakPerspective as WeakPerspective
    from .detailed import detailed_mesh as detailed_mesh
    from .ellipsoids import EllipsoidImage as EllipsoidImage
    from .ellipsoids import Ellipsoids as Ellipsoids
    from .ellipsoids import draw_ellipsoids as draw_ellipsoids
    from .ellipsoids import ellipsoid_label_loss as ellipsoid_label_loss
    from .energy import Energy as Energy
    from .energy import Observation as Observation
    from .energy import Weights as Weights
    from .errors import InputError as InputError
    from .export import ellipbody_scene as ellipbody_scene
    from .fitting import FitOptions as FitOptions
    from .fitting import FitResult as FitResult
    from .fitting import fit_body as fit_body
    from .fused import FusedRefinement as FusedRefinement
    from .fused import minimise as minimise
    from .kernels.threads import get_num_threads as get_num_threads
    from .kernels.threads import set_num_threads as set_num_threads
    from .keypoint_files import read_keypoints as read_keypoints
    from .keypoints import Keypoints2D as Keypoints2D
    from .keypoints import choose_person as choose_person
    from .mesh import PartMesh as PartMesh
    from .mesh import ellipbody_mesh as ellipbody_mesh
    from .network.checkpoint import about_network as about_network
    from .network.checkpoint import load_label_network as load_label_network
    from .network.ellipbodynet import EllipBodyNet as EllipBodyNet
    from .network.label_network import LabelNetwork as LabelNetwork
    from .network.picture_checkpoint import load_ellipbodynet as load_ellipbodynet
    from .network.predict import predict_bodies as predict_bodies
    from .observation import observe as observe
    from .output import save_fit as save_fit
    from .parameters import BodyParameters as BodyParameters
    from .part_files import PartLabels as PartLabels
    from .part_files import read_label_set as read_label_set
    from .part_files import read_parts as read_parts
    from .part_files import read_photo as read_photo
    from .pose_prior import PosePrior as PosePrior
    from .pose_prior import up_direction as up_direction
    from .posing import Posed as Posed
    from .posing import pose as pose
    from .quality import Stage as Stage
    from .refinement import Refined as Refined
    from .refinement import refine as refine
    from .registration import Registered as Registered
    from .registration import RegistrationOptions as RegistrationOptions
    from .registration import RegistrationWeights as RegistrationWeights
    from .registration import register as register
    from .render import PartImage as PartImage
    from .render import label_loss as label_loss
    from .render import rasterize_parts as rasterize_parts
    from .subdivisions import coarsest_subdivisions as coarsest_subdivisions
    from .subdivisions import silhouette_error as silhouette_error
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
