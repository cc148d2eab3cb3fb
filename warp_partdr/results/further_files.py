"""Files of detailed bodies that are written only when asked for: USD by ``usd-core``, FBX by Blender."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from ..clothing.registration import Registered
from ..errors import InputError
from .skinned_files import Poses, glb
from .usd_files import check_usd, save_usd

_COMMAND = "blender"
_LONGEST = 600  # [s] for one body
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
moves = bool(bpy.data.actions)
bpy.ops.export_scene.fbx(filepath=target, object_types={"ARMATURE", "MESH"}, add_leaf_bones=False, bake_anim=moves)
"""


def check_blender(name: str) -> str:
    """The command of Blender; an InputError, which begins with ``name``, if there is none."""
    found = shutil.which(_COMMAND)
    if found is None:
        raise InputError(f"{name}: no command {_COMMAND!r}, which makes FBX; expected Blender on the PATH")
    return found


def save_fbx(registered: Registered, path: Path, poses: Poses | None = None) -> None:
    """Write the first body, in its pose or in several over time, as FBX.

    Raises:
        InputError: If Blender is missing, or fails; with the last line that it said.
    """
    command, poses = check_blender("fbx"), poses or Poses.first(registered)
    with TemporaryDirectory() as folder:
        source = Path(folder) / path.with_suffix(".glb").name
        source.write_bytes(glb(registered, poses))
        flags = ["--background", "--factory-startup", "--python-exit-code", "1", "--python-expr", _SCRIPT]
        files = [str(source), str(path.absolute()), f"{poses.rate:.6f}"]
        try:
            ran = subprocess.run(
                [command, *flags, "--", *files], capture_output=True, text=True, errors="replace", timeout=_LONGEST
            )
        except (OSError, subprocess.TimeoutExpired) as error:
            raise InputError(f"fbx: {command}: {error}; expected Blender that writes FBX") from error
    if ran.returncode or not path.is_file():
        said = (ran.stderr.strip() or ran.stdout.strip() or f"exit code {ran.returncode}").splitlines()[-1]
        raise InputError(f"fbx: {command}: {said}; expected Blender that writes FBX")


_Save = Callable[[Registered, Path, Poses | None], None]
# By the files' endings: the check, whose message begins with its argument, and the writer.
FURTHER: Mapping[str, tuple[Callable[[str], object], _Save]] = {
    "usda": (check_usd, save_usd),
    "usdz": (check_usd, save_usd),
    "fbx": (check_blender, save_fbx),
}
FURTHER_FILES = tuple(f"detailed.{kind}" for kind in FURTHER)


def check_formats(option: str, formats: Sequence[str]) -> None:
    """Raise an InputError, which begins with ``option``, if one is unknown or what writes it is missing."""
    for name in formats:
        if name not in FURTHER:
            raise InputError(f"{option}: {name!r}; expected of {', '.join(FURTHER)}")
        FURTHER[name][0](f"{option}: {name}")


def save_further(registered: Registered, stem: Path, formats: Sequence[str], poses: Poses | None = None) -> list[str]:
    """Write the first body, or its motion, as ``stem`` with each ending; returns the files' names."""
    paths = [stem.with_name(f"{stem.name}.{kind}") for kind in formats]
    for kind, path in zip(formats, paths, strict=True):
        FURTHER[kind][1](registered, path, poses)
    return [path.name for path in paths]
