"""The command ``partdr dataset``: bodies of everyone in a whole data set of pictures, to Parquet."""

from __future__ import annotations

import os
import time
from dataclasses import dataclass
from enum import StrEnum
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Argument, Option

from .. import __version__
from ..detection import MIN_SCORE
from ..errors import InputError, shown
from ..files.disk import file_sha256
from .loading import load_kernels, load_mesh_kernels
from .options import CameraOptions, DeviceOption, LabelsOption, check_score, people_at_a_time, say_people
from .register import MODEL_HELP, read_model

if TYPE_CHECKING:
    from ..bulk.run import Tally
    from ..bulk.shards import Shards
    from ..bulk.sources import PictureSource

# As ``bulk.people.BulkQuality``, which is not loaded for --help.
BulkQualityName = StrEnum("BulkQualityName", ["network", "fast", "mesh"])

DATASET_HELP = """Fit everyone in a whole data set of pictures, to Parquet, a row a person. Killed, it goes on.

Examples: `partdr dataset photos --out people`; `partdr dataset person_keypoints_val2017.json --images val2017`

PICTURES is a folder of photos, with all folders in it; a .txt file, a path a line; or COCO's annotations (.json), whose
keypoints and polygons are taken then. Else people are found in each photo, as by `partdr fit photo.jpg`.

**How far**, --quality: network (what `partdr predict` says), fast (ellipsoids refined), or mesh (the detailed body of
`partdr fit`, too). Nobody gets a search: where the body ends far from what was seen, the column warnings says so.

**Results**: part-00000-of-00010.parquet, ..., each with the people of so many pictures (--shard), whole or not there.
The same command again makes those that are missing, so a run may be killed at any time; options that differ are
refused. Machines that share a disk share the work: `--share 0/4` to `--share 3/4`. A picture that can't be read, or
shows nobody, is a row, too: columns error and people.

**To read them**, nothing of this package is needed; lists are flat, and the fields' metadata have shapes and names:

    table = pyarrow.parquet.read_table("people")            # or pandas.read_parquet("people")
    table = datasets.load_dataset("parquet", data_files="people/*.parquet")
    joints = numpy.stack(table["joints"].drop_null().to_numpy()).reshape(-1, 21, 3)

Columns: picture, person, people, error, height, width, annotation, score, box, keypoints, keypoint_error, energy,
warnings; global_orient, translation, rotations, lengths, thicknesses (metres), camera_perspective, camera_scale,
camera_translation as in body.npz; joints (21, 3), joints_2d (21, 2), joint_spreads (20); with mesh also mesh_shape,
mesh_rotations, mesh_translation, stature, clothes. The schema's metadata has versions, options and their SHA-256.
"""


@dataclass(frozen=True)
class BulkOptions:
    """Options that rows depend on."""

    quality: Annotated[BulkQualityName, Option(help="How far each fit goes.", metavar="NAME")] = BulkQualityName.fast
    model: Annotated[str, Option(help=f"Detailed model of --quality mesh: {MODEL_HELP}.", metavar="NAME")] = "anny"
    network: Annotated[
        Path | None,
        Option(help="A network of `partdr train`; by default the packaged one.", metavar="FILE.safetensors"),
    ] = None
    min_score: Annotated[float, Option(help="Least confidence that there is a person, 0 to 1.", metavar="SHARE")] = (
        MIN_SCORE
    )

    def record(self, view: CameraOptions, source: PictureSource) -> dict[str, Any]:
        """All that rows depend on but the pictures, as shards state it."""
        check_score("--min-score", self.min_score)
        model = _sha256(Path(self.model)) if Path(self.model).is_file() else self.model
        return {
            "version": __version__,
            "quality": self.quality.value,
            "people": source.digest or "found",
            "min_score": self.min_score if source.finds else None,
            "network": None if self.network is None else _sha256(self.network),
            "model": model if self.quality == "mesh" else None,
            **{name: getattr(view, name) for name in ("focal", "fov", "principal")},
        }


@dataclass(frozen=True)
class ShardOptions:
    """Options of the shards that are made."""

    shard: Annotated[int, Option(help="Pictures of a shard.", metavar="N", min=1)] = 1000
    share: Annotated[str, Option(help="Shards of this machine: each Nth from I on.", metavar="I/N")] = "0/1"

    def mine(self, count: int) -> range:
        """The shards, of so many, that this machine is to make."""
        first, slash, step = self.share.partition("/")
        if not (slash and first.isdecimal() and step.isdecimal() and int(first) < int(step)):
            raise InputError(f"--share: {shown(self.share)}; expected I/N, such as 0/4 to 3/4")
        return range(int(first), count, int(step))


def dataset(
    pictures: Annotated[Path, Argument(help="Folder, list (.txt) or COCO's annotations (.json).", metavar="PICTURES")],
    out: Annotated[Path, Option(help="Folder for the shards.", metavar="FOLDER")] = Path("dataset"),
    images: Annotated[Path | None, Option(help="Folder of COCO's pictures, else its own.", metavar="FOLDER")] = None,
    batch: Annotated[
        int | None, Option(help="People at a time; default: 256, on a CPU 16.", metavar="N", min=1)
    ] = None,
    device: DeviceOption = "auto",
    labels: LabelsOption = None,
    *,
    how: BulkOptions,
    parts: ShardOptions,
    view: CameraOptions,
) -> None:
    """Fit a data set; see ``DATASET_HELP``."""
    if find_spec("pyarrow") is None:
        raise InputError("partdr dataset: without pyarrow; expected it: pip install 'warp-partdr[dataset]'")
    view.check()

    from ..bulk.opening import open_source
    from ..bulk.people import BulkQuality, PeopleFitter, stages_of_quality
    from ..bulk.rows import columns
    from ..bulk.run import make_dataset
    from ..bulk.shards import Shards
    from ..interop.devices import choose_device
    from ..network.checkpoint import load_label_network
    from ..results.result_sets import check_folder
    from .progress import PictureProgress

    source = open_source(pictures, images, labels)
    where = choose_device(device)
    check_folder(out)
    about = _versions(where) | {"skeleton": source.skeleton}
    shards = Shards(out, source.names, parts.shard, how.record(view, source), about)
    done = shards.done()
    todo = [index for index in parts.mine(shards.count) if index not in done]
    if not todo:
        typer.echo(f"{out} has {len(done)} of {shards.count} shards; nothing to do")
        return
    detailed = read_model(how.model, where) if how.quality == "mesh" else None
    form = columns(source.skeleton, detailed)
    camera: dict[str, Any] = {}
    if view.given:
        camera["camera"] = lambda name, size: view.read(size, source.photo(name))
    total = sum(len(shards.pictures(index)) for index in todo)
    with PictureProgress(total) as progress:
        at_a_time = people_at_a_time(batch, where) if where == "cpu" else batch or 256
        label_network = load_label_network(how.network, device=where)
        quality: BulkQuality = how.quality.value  # type: ignore[assignment]  # its names
        own = {**camera, "skeleton": source.skeleton}
        fitter = PeopleFitter(quality, label_network, detailed, where, at_a_time, how.min_score, **own)
        load_kernels(where, stages_of_quality("mesh"), with_labels=True)
        if detailed is not None:
            load_mesh_kernels(where)
        if done:
            progress.say(f"{len(done)} of {shards.count} shards are there; going on")
        started = time.perf_counter()

        def written(index: int, tally: Tally) -> None:
            if not progress.console.is_terminal:  # where no bar is seen
                speed = tally.pictures / (time.perf_counter() - started)
                left = (total - tally.pictures) / speed
                progress.say(f"{shards.path(index).name}: {speed:.1f} pictures a second, {left / 60:.0f} min to go")

        try:
            tally = make_dataset(
                source, shards, fitter, form, todo=todo, threads=os.cpu_count() or 2, told=progress, written=written
            )
        except KeyboardInterrupt:
            there = f"{len(shards.done())} of {shards.count} shards"
            progress.say(f"partdr: stopped; {out} has {there}, the same command goes on")
            raise
        seconds = time.perf_counter() - started
    _tell(tally, shards, seconds, where)


def _tell(tally: Tally, shards: Shards, seconds: float, where: str) -> None:
    speeds = f"{tally.people / seconds:.1f} people, {tally.pictures / seconds:.1f} pictures a second, {where}"
    typer.echo(f"{say_people(tally.people)} in {tally.pictures} pictures; {speeds}")
    typer.echo(f"{shards.folder} has {len(shards.done())} of {shards.count} shards")
    if tally.errors:
        rows = f"{tally.errors} row{'s' * (tally.errors > 1)}"
        typer.echo(f"partdr: warning: {rows} with an error, first {tally.first_error}", err=True)


def _sha256(path: Path) -> str:
    try:
        return file_sha256(path)
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or error}; expected a file") from error


def _versions(device: str) -> dict[str, Any]:
    """Versions of what makes the rows, and the device."""
    import platform

    import pyarrow
    import torch
    import warp

    versions = {"warp-partdr": __version__, "warp": warp.config.version, "torch": torch.__version__}
    versions |= {"pyarrow": pyarrow.__version__, "python": platform.python_version(), "machine": platform.machine()}
    return {"versions": versions, "device": device}
