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
    "EllipBody": "body.ellipbody",
    "label_set": "body.labels",
    "BodyLeaves": "body.parameters",
    "BodyParameters": "body.parameters",
    "PosePrior": "body.pose_prior",
    "Posed": "body.posing",
    "pose": "body.posing",
    "skeleton": "body.skeletons",
    "JOINT_NAMES": "body.template",
    "PART_NAMES": "body.template",
    "Crop": "cameras",
    "Perspective": "cameras",
    "WeakPerspective": "cameras",
    "anny": "models.anny",
    "load_model": "models.load",
    "register": "models.registration",
    "InputError": "errors",
    "fit_body": "solve.ellipsoids.fitting",
    "FitOptions": "solve.ellipsoids.options",
    "FitResult": "solve.ellipsoids.result",
    "Stage": "solve.ellipsoids.stages",
    "read_keypoints": "inputs.keypoint_files",
    "choose_person": "inputs.keypoints",
    "observe": "inputs.observation",
    "read_parts": "inputs.part_labels",
    "read_photo": "inputs.part_labels",
    "set_num_threads": "kernels.launch",
    "load_label_network": "networks.regression.checkpoint",
    "predict_bodies": "networks.regression.predict",
    "Energy": "solve.ellipsoids.energy",
    "Weights": "solve.ellipsoids.energy",
    "refine": "solve.ellipsoids.refine",
    "Ellipsoids": "render.ellipsoids",
    "draw_ellipsoids": "render.ellipsoids",
    "ellipsoid_label_loss": "render.ellipsoids",
    "draw_mesh": "render.mesh",
    "mesh_label_loss": "render.mesh",
    "PartMesh": "render.part_mesh",
    "ellipbody_mesh": "render.part_mesh",
    "RendererEllipsoids": "render.renderers",
    "RendererMesh": "render.renderers",
    "load_body": "results.body_file",
    "save_fit": "results.save",
}

__all__ = sorted(["__version__", *_EXPORTS])

if TYPE_CHECKING:
    from .body.ellipbody import EllipBody as EllipBody
    from .body.labels import label_set as label_set
    from .body.parameters import BodyLeaves as BodyLeaves
    from .body.parameters import BodyParameters as BodyParameters
    from .body.pose_prior import PosePrior as PosePrior
    from .body.posing import Posed as Posed
    from .body.posing import pose as pose
    from .body.skeletons import skeleton as skeleton
    from .body.template import JOINT_NAMES as JOINT_NAMES
    from .body.template import PART_NAMES as PART_NAMES
    from .cameras import Crop as Crop
    from .cameras import Perspective as Perspective
    from .cameras import WeakPerspective as WeakPerspective
    from .errors import InputError as InputError
    from .inputs.keypoint_files import read_keypoints as read_keypoints
    from .inputs.keypoints import choose_person as choose_person
    from .inputs.observation import observe as observe
    from .inputs.part_labels import read_parts as read_parts
    from .inputs.part_labels import read_photo as read_photo
    from .kernels.launch import set_num_threads as set_num_threads
    from .models.anny import anny as anny
    from .models.load import load_model as load_model
    from .models.registration import register as register
    from .networks.regression.checkpoint import load_label_network as load_label_network
    from .networks.regression.predict import predict_bodies as predict_bodies
    from .render.ellipsoids import Ellipsoids as Ellipsoids
    from .render.ellipsoids import draw_ellipsoids as draw_ellipsoids
    from .render.ellipsoids import ellipsoid_label_loss as ellipsoid_label_loss
    from .render.mesh import draw_mesh as draw_mesh
    from .render.mesh import mesh_label_loss as mesh_label_loss
    from .render.part_mesh import PartMesh as PartMesh
    from .render.part_mesh import ellipbody_mesh as ellipbody_mesh
    from .render.renderers import RendererEllipsoids as RendererEllipsoids
    from .render.renderers import RendererMesh as RendererMesh
    from .results.body_file import load_body as load_body
    from .results.save import save_fit as save_fit
    from .solve.ellipsoids.energy import Energy as Energy
    from .solve.ellipsoids.energy import Weights as Weights
    from .solve.ellipsoids.fitting import fit_body as fit_body
    from .solve.ellipsoids.options import FitOptions as FitOptions
    from .solve.ellipsoids.refine import refine as refine
    from .solve.ellipsoids.result import FitResult as FitResult
    from .solve.ellipsoids.stages import Stage as Stage
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
