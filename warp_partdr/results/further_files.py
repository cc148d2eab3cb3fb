"""Further files of detailed bodies, which are written on demand: USD by ``usd-core``, FBX by Blender.

Blender is the command ``blender`` or, if there is none, the module ``bpy`` in this Python.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory

from ..errors import InputError, cause
from ..models.registration import Registered
from .skinned_files import Poses, glb
from .usd_files import check_usd, save_usd

_COMMAND, _MODULE = "blender", "bpy"
_LONGEST = 600  # [s], time limit for one body
# Key frames lie on whole frames of the scene, so that the rate is set before they are read.
_SCRIPT = """
import bpy, sys
source, target, rate = sys.argv[sys.argv.index("--") + 1:]
for item in list(bpy.data.objects):
    bpy.data.objects.remove(item)
scene = bpy.context.scene
scene.render.fps = max(round(float(rate)), 1)
scene.render.fps_base = scene.render.fps / float(rate)
bpy.ops.import_scene.gltf(filepath=source)
for item in list(bpy.data.objects):
    if item.type == "MESH" and not any(each.type == "ARMATURE" for each in item.modifiers):
        bpy.data.objects.remove(item)  # the sphere as which the importer draws bones
moves = bool(bpy.data.actions)
bpy.ops.export_scene.fbx(filepath=target, object_types={"ARMATURE", "MESH"}, add_leaf_bones=False, bake_anim=moves)
"""


def check_blender(name: str) -> list[str]:
    """Find Blender.

    Returns:
        The command line that runs ``_SCRIPT`` in it, up to the script's own arguments.

    Raises:
        InputError: If there is neither the command nor the module; the message begins with ``name``.
    """
    command = shutil.which(_COMMAND)
    if command is not None:
        return [command, "--background", "--factory-startup", "--python-exit-code", "1", "--python-expr", _SCRIPT, "--"]
    if find_spec(_MODULE) is not None:
        return [sys.executable, "-c", _SCRIPT, "--"]
    missing = f"no command {_COMMAND!r} and no module {_MODULE!r}, one of which makes FBX"
    raise InputError(f"{name}: {missing}; expected Blender on the PATH, or pip install {_MODULE}")


def save_fbx(registered: Registered, path: Path, poses: Poses | None = None) -> None:
    """Write the first body, in its pose or in several over time, as FBX.

    Raises:
        InputError: If Blender is missing, or fails. The message has Blender's last line.
    """
    command, poses = check_blender("fbx"), (poses or Poses.first(registered)).evenly()
    blender = _MODULE if command[0] == sys.executable else command[0]
    with TemporaryDirectory() as folder:
        source = Path(folder) / path.with_suffix(".glb").name
        source.write_bytes(glb(registered, poses, bare=True))
        files = [str(source), str(path.absolute()), f"{poses.rate:.6f}"]
        try:
            ran = subprocess.run(
                [*command, *files], capture_output=True, text=True, errors="replace", timeout=_LONGEST, check=False
            )
        except (OSError, subprocess.TimeoutExpired) as error:
            raise InputError(f"fbx: {blender}: {cause(error)}; expected Blender that writes FBX") from error
    if ran.returncode or not path.is_file():
        last_line = (ran.stderr.strip() or ran.stdout.strip() or f"exit code {ran.returncode}").splitlines()[-1]
        raise InputError(f"fbx: {blender}: {last_line}; expected Blender that writes FBX")


_Save = Callable[[Registered, Path, Poses | None], None]
# For each ending of files: the check, whose message begins with its argument, and the writer.
FURTHER: Mapping[str, tuple[Callable[[str], object], _Save]] = {
    "usda": (check_usd, save_usd),
    "usdz": (check_usd, save_usd),
    "fbx": (check_blender, save_fbx),
}
FURTHER_FILES = tuple(f"detailed.{ending}" for ending in FURTHER)


def check_formats(option: str, formats: Sequence[str]) -> None:
    """Raise an InputError, which begins with ``option``, if a format is unknown or its writer is not installed."""
    for name in formats:
        if name not in FURTHER:
            raise InputError(f"{option}: {name!r}; expected of {', '.join(FURTHER)}")
        FURTHER[name][0](f"{option}: {name}")


def save_further(registered: Registered, stem: Path, formats: Sequence[str], poses: Poses | None = None) -> list[str]:
    """Write the first body, or its motion, to ``stem`` with each ending; return the files' names."""
    paths = [stem.with_name(f"{stem.name}.{ending}") for ending in formats]
    for ending, path in zip(formats, paths, strict=True):
        FURTHER[ending][1](registered, path, poses)
    return [path.name for path in paths]
