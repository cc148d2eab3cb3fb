"""Command ``partdr dataset``: fits the bodies of all people in a data set of pictures, and writes them to Parquet."""

from __future__ import annotations

import time
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from enum import StrEnum
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Argument, Option

from .. import __version__
from ..body.skeletons import describe_skeleton
from ..errors import InputError, install_command, shown
from ..files.disk import file_sha256
from ..networks.detection import MIN_SCORE
from .loading import load_kernels, load_mesh_kernels
from .options import (
    CameraOptions,
    DeviceOption,
    LabelsOption,
    SettingOptions,
    check_score,
    count_people,
    people_at_a_time,
)
from .register import MODEL_HELP, read_model

if TYPE_CHECKING:
    from ..bulk.people import PeopleFitter
    from ..bulk.shards import Shards, Tally
    from ..bulk.sources import PictureSource
    from ..cameras import Perspective
    from ..models.model import DetailedModel
    from ..solve.ellipsoids.options import FitOptions

# The same names as in ``bulk.people.BulkQuality``, which is not loaded for --help.
BulkQualityName = StrEnum("BulkQualityName", ["network", "fast", "mesh"])

DATASET_HELP = """Fit all people in a data set of pictures, and write a row for each person to Parquet files.

Examples: `partdr dataset photos --out people`; `partdr dataset person_keypoints_val2017.json --images val2017`

PICTURES is one of these:

* a folder of photos, with all folders in it
* a .txt file with a path in each line
* tar files of WebDataset, as a folder or as "shards/{000..009}.tar"
* a film (install .[film]), whose frames are the pictures film.mp4#0, film.mp4#1, ...
* COCO's annotations (.json), whose keypoints and masks are then taken

Beside 7.jpg, also in tar files, there may be 7.keypoints.json and 7.parts.png (--labels gives the meaning of its ids).
People without keypoints are found as by `partdr fit photo.jpg`.

The names in COCO's categories give the order of keypoints. For files without names, use --format NAME, which also
overrides names. If pictures were resized after the annotation, or annotated before they were turned upright, their
annotations are scaled or turned, and the column warnings says so. A size that this can't explain is an error.

**Quality**, --quality: network (the body of `partdr predict`), fast (the ellipsoids are also refined), or mesh (the
detailed body of `partdr fit` is also fitted). `--set mirror=false` makes the network faster, `--set mesh.iterations=30`
the mesh stage. `--set landmarks=heavy` finds keypoints that are nearer to the truth, but takes longer. On a device that
multiplies bfloat16, the network uses it, except with --ray; `--set half=false` or `half=true` decides otherwise. The
metadata says which was used, and machines that share a data set must use the same. No person gets a search. If a body
ends far from its keypoints, the column warnings says so.

**Results** are part-00000-of-00010.parquet and so on. Each file (a shard) holds the people of as many pictures as
--shard says, and appears only when it is complete. So a run may be killed at any time: the same command again makes the
missing files. Other options are then refused. It also reads pictures again that could not be read from the disk
(missing, no permission, an outage). Machines that share a disk can share the work: `--share 0/4` to `--share 3/4`, or
`--ray ADDRESS` of a Ray cluster (install .[ray]), which gives each shard to one of its processes and restarts dead
processes. A picture that can't be read, or that shows nobody, also gets a row: see the columns error and people. If
more than half of the rows in a run's shards have an error, its exit code is 1. Files that are no pictures are counted
on stderr.

**To read the results** you don't need this package. Lists are flat, and the fields' metadata have shapes and names:

    table = pyarrow.parquet.read_table("people")            # or pandas.read_parquet("people")
    table = datasets.load_dataset("parquet", data_files="people/*.parquet")
    joints = numpy.stack(table["joints"].drop_null().to_numpy()).reshape(-1, 21, 3)

Columns: picture, person, people, error, height, width, annotation, score, box, keypoints, keypoint_error, confidence,
energy, warnings; global_orient, translation, rotations, lengths, thicknesses (metres), camera_perspective,
camera_scale, camera_translation as in body.npz, camera_guessed; joints (21, 3), joints_2d (21, 2), joint_spreads (20);
with mesh also mesh_shape, mesh_rotations, mesh_translation, stature, clothes. The schema's metadata has versions,
options and their SHA-256.
"""


@dataclass(frozen=True)
class BulkOptions(SettingOptions):
    """Options that rows depend on; settings are those of ``partdr fit``."""

    quality: Annotated[BulkQualityName, Option(help="Quality of each fit: network, fast or mesh.", metavar="NAME")] = (
        BulkQualityName.fast
    )
    model: Annotated[str, Option(help=f"Detailed model of --quality mesh: {MODEL_HELP}.", metavar="NAME")] = "anny"
    network: Annotated[
        Path | None,
        Option(help="Network that `partdr train` wrote; default: the packaged one.", metavar="FILE.safetensors"),
    ] = None
    min_score: Annotated[float, Option(help="Least confidence that there is a person, 0 to 1.", metavar="SHARE")] = (
        MIN_SCORE
    )

    def absolute(self) -> BulkOptions:
        """Return the options with full paths of the files."""
        model = str(Path(self.model).absolute()) if Path(self.model).is_file() else self.model
        files = {name: path and path.absolute() for name in ("network", "config") for path in [getattr(self, name)]}
        return replace(self, model=model, **files)

    def fit_options(self, *, half: bool) -> FitOptions:
        """Options of the fits: those of the quality, changed by the settings; ``half`` counts if they don't set it."""
        from ..bulk.people import BulkQuality, stages_of_quality
        from ..solve.ellipsoids.settings import MESH, change_options
        from ..solve.ellipsoids.stages import OUTLINE

        values = self.read()
        if "network" in values:
            raise InputError("network: a setting; expected the option --network")
        if MESH in values and self.quality != MESH:
            raise InputError(f"{MESH}: settings, with --quality {self.quality.value}; expected --quality {MESH}")
        if OUTLINE in values:
            raise InputError(f"{OUTLINE}: settings of a stage that no quality of a data set has; expected none")
        quality: BulkQuality = self.quality.value  # type: ignore[assignment]  # its names
        return change_options(replace(stages_of_quality(quality), half=half), values)

    def record(
        self, view: CameraOptions, source: PictureSource, keypoint_format: str | None, *, half: bool
    ) -> dict[str, Any]:
        """Record everything that rows depend on, except the pictures, for the metadata of shards."""
        check_score("--min-score", self.min_score)
        options = self.fit_options(half=half)
        settings = {name: value for name, value in self.read().items() if name != "half"}
        return {
            "version": __version__,
            "quality": self.quality.value,
            "people": source.digest or "found",
            "min_score": self.min_score if source.finds else None,
            "network": None if self.network is None else _sha256(self.network),
            "model": _name_or_sha256(self.model) if self.quality == "mesh" else None,
            "half": options.half,
            **({"settings": settings} if settings else {}),
            **({} if keypoint_format is None else {"format": _name_or_sha256(keypoint_format)}),
            **{name: getattr(view, name) for name in ("focal", "fov", "principal")},
        }


@dataclass(frozen=True)
class ShardOptions:
    """Options of the shards that are made."""

    shard: Annotated[int, Option(help="Number of pictures in a shard.", metavar="N", min=1)] = 1000
    share: Annotated[str, Option(help="Shards that this machine makes: every Nth, starting at I.", metavar="I/N")] = (
        "0/1"
    )

    def mine(self, count: int) -> range:
        """Indices of the shards, among ``count``, that this machine makes."""
        first, slash, step = self.share.partition("/")
        if not (slash and first.isdecimal() and step.isdecimal() and int(first) < int(step)):
            raise InputError(f"--share: {shown(self.share)}; expected I/N, such as 0/4 to 3/4")
        return range(int(first), count, int(step))


@dataclass(frozen=True)
class ClusterOptions:
    """Options of a Ray cluster."""

    ray: Annotated[str | None, Option(help="Use a Ray cluster: local, auto or HOST:PORT.", metavar="ADDRESS")] = None
    workers: Annotated[
        int | None,
        Option(help="Most processes on the cluster; default: as many as have room.", metavar="N", min=1),
    ] = None
    cores: Annotated[
        int | None, Option(help="CPU cores of each process; default: 1, with a GPU 8.", metavar="N", min=1)
    ] = None

    def check(self) -> None:
        """Raise an InputError unless the options go together, and Ray is installed if it is needed."""
        if self.ray is None and (self.workers, self.cores) != (None, None):
            raise InputError("--workers, --cores: without a cluster; expected --ray with it")
        if self.ray is not None and (find_spec("ray") is None or find_spec("pandas") is None):
            raise InputError(f"--ray: without Ray Data; expected it: {install_command('ray')}")


@dataclass(frozen=True)
class _Cameras:
    """Cameras of a source's pictures. It can be sent to another process."""

    view: CameraOptions
    source: PictureSource

    def __call__(self, name: str, size: tuple[int, int]) -> Perspective | None:
        return self.view.read(size, self.source.photo(name))


@dataclass(frozen=True)
class FitterSetup:
    """Options of a fitter, which may be made in another process."""

    options: BulkOptions
    view: CameraOptions
    batch: int | None
    device: str
    half: bool

    def model(self) -> DetailedModel | None:
        """Load the detailed model; None if the quality needs none."""
        return read_model(self.options.model, self.device) if self.options.quality == "mesh" else None

    def __call__(self, source: PictureSource, detailed: DetailedModel | None = None) -> PeopleFitter:
        """Make the fitter, and load its kernels."""
        from ..bulk.cutting import Cutter, no_camera, usual_camera
        from ..bulk.people import PeopleFitter, kept_label_size, stages_of_quality
        from ..networks.regression.checkpoint import load_label_network

        detailed = detailed or self.model()
        options = self.options.fit_options(half=self.half)
        network = load_label_network(self.options.network, device=self.device)
        assumed = usual_camera if options.guess_camera and not self.view.refused else no_camera
        fitter = PeopleFitter(
            options,
            network,
            detailed,
            self.device,
            self.batch or _people_at_a_time(self.device, meshes=detailed is not None),
            self.options.min_score,
            cutter=Cutter(
                _Cameras(self.view, source) if self.view.given else assumed,
                source.skeleton,
                kept_label_size(options, network, meshes=detailed is not None),
            ),
        )
        load_kernels(self.device, stages_of_quality("mesh"), with_labels=True)
        if detailed is not None:
            load_mesh_kernels(self.device)
        return fitter


def _people_at_a_time(device: str, *, meshes: bool) -> int:
    """Default of the option --batch. It is large on a GPU, whose launches take as long for a few people as for many."""
    return people_at_a_time(None, device) if device == "cpu" else 256 if meshes else 1000


@dataclass(frozen=True, kw_only=True)
class DatasetRequest:
    """Arguments and options of ``partdr dataset``.

    Raises:
        InputError: If one is wrong whatever the pictures show, or if a package is missing that it needs.
    """

    pictures: Annotated[
        Path, Argument(help="Folder, list (.txt), film, tar files, or COCO's annotations (.json).", metavar="PICTURES")
    ]
    out: Annotated[Path, Option(help="Folder for the shards.", metavar="FOLDER")] = Path("dataset")
    images: Annotated[
        Path | None,
        Option(help="Folder of COCO's pictures; default: the folder of the annotations.", metavar="FOLDER"),
    ] = None
    batch: Annotated[
        int | None,
        Option(help="Number of people at a time; default: 1000, with meshes 256, on a CPU 16.", metavar="N", min=1),
    ] = None
    device: DeviceOption = "auto"
    labels: LabelsOption = None
    keypoint_format: Annotated[
        str | None,
        Option("--format", help="Format of keypoints, if files do not name it; or its JSON file.", metavar="NAME"),
    ] = None
    options: BulkOptions
    parts: ShardOptions
    view: CameraOptions
    cluster: ClusterOptions

    def __post_init__(self) -> None:
        if find_spec("pyarrow") is None:
            raise InputError(f"partdr dataset: without pyarrow; expected it: {install_command('dataset')}")
        self.view.check()
        self.cluster.check()

    def absolute(self) -> DatasetRequest:
        """Return the request with full paths of files and folders."""
        return replace(
            self,
            pictures=self.pictures.absolute(),
            out=self.out.absolute(),
            images=self.images and self.images.absolute(),
            options=self.options.absolute(),
        )

    def record(self, source: PictureSource, *, half: bool) -> dict[str, Any]:
        """Record everything that rows depend on, except the pictures, for the metadata of shards."""
        return self.options.record(self.view, source, self.keypoint_format, half=half)

    def setup(self, device: str, *, half: bool) -> FitterSetup:
        """Collect the options of the fitter on a device."""
        return FitterSetup(self.options, self.view, self.batch, device, half)


def dataset(request: DatasetRequest) -> None:
    """Fit a data set; see ``DATASET_HELP``."""
    cluster = request.cluster
    if cluster.ray is not None:  # its processes have working folders of their own
        request = request.absolute()
    out = request.out

    from ..bulk.opening import open_source
    from ..bulk.shards import Shards
    from ..interop.devices import choose_device
    from ..interop.precision import multiplies_bfloat16
    from ..results.result_sets import check_folder

    source = open_source(request.pictures, request.images, request.labels, request.keypoint_format)
    for warning in source.warnings:
        typer.echo(f"partdr: warning: {warning}", err=True)
    where = choose_device(request.device) if cluster.ray is None else request.device
    half = cluster.ray is None and multiplies_bfloat16(where)  # machines of a cluster may differ, but rows must not
    check_folder(out)
    shards = Shards(out, source.names, request.parts.shard, request.record(source, half=half))
    done = {index for index, unread in shards.there().items() if not unread}
    todo = [index for index in request.parts.mine(shards.count) if index not in done]
    if source.left_out:
        typer.echo(f"partdr: {source.left_out}", err=True)
    if not todo:
        typer.echo(f"{out} has {len(done)} of {shards.count} shards; nothing to do")
        return
    with ExitStack() as stack:
        if cluster.ray is not None:
            from ..bulk.cluster import connected_cluster

            room = stack.enter_context(connected_cluster(cluster.ray))
            where = ("cuda" if room.get("GPU") else "cpu") if request.device == "auto" else request.device
        about = _versions(where) | {"skeleton": describe_skeleton(source.skeleton)}
        work = _Work(source, replace(shards, about=about), todo, len(done))
        work.run(request.setup(where, half=half), cluster)


@dataclass(frozen=True)
class _Work:
    """Shards that must be made."""

    source: PictureSource
    shards: Shards
    todo: Sequence[int]
    done: int

    def run(self, setup: FitterSetup, cluster: ClusterOptions) -> None:
        """Make the shards, here or on a cluster, and report progress."""
        from ..bulk.rows import columns
        from ..bulk.run import make_dataset, source_readers
        from ..kernels.launch import get_num_threads
        from .progress import PictureProgress

        source, shards = self.source, self.shards
        left = {index: len(shards.left(index)) for index in self.todo}
        total = sum(left.values())
        with PictureProgress(total) as progress:
            if self.done:
                progress.say(f"{self.done} of {shards.count} shards are there; going on")
            started = time.perf_counter()

            def written(index: int, tally: Tally) -> None:
                if cluster.ray is not None:
                    progress(shards.path(index).name, left[index])
                if not progress.console.is_terminal:  # there is no bar
                    speed = tally.pictures / (time.perf_counter() - started)
                    minutes = (total - tally.pictures) / speed / 60
                    progress.say(f"{shards.path(index).name}: {speed:.1f} pictures a second, {minutes:.0f} min to go")

            try:
                if cluster.ray is not None:
                    from ..bulk.cluster import Workers, make_on_cluster

                    on_gpu = setup.device != "cpu"
                    workers = Workers(cluster.workers, cluster.cores or (8 if on_gpu else 1), int(on_gpu))
                    form = columns(source.skeleton, replace(setup, device="cpu").model())
                    tally = make_on_cluster(
                        source, shards, setup, form, todo=self.todo, workers=workers, written=written
                    )
                else:
                    detailed = setup.model()
                    fitter = setup(source, detailed)
                    started = time.perf_counter()
                    readers = source_readers(source, fitter, get_num_threads())
                    tally = make_dataset(
                        source,
                        shards,
                        fitter,
                        columns(source.skeleton, detailed),
                        todo=self.todo,
                        threads=readers.threads,
                        processes=readers.processes,
                        told=progress,
                        written=written,
                    )
            except KeyboardInterrupt:
                finished = f"{len(shards.there())} of {shards.count} shards"
                progress.say(f"partdr: stopped; {shards.folder} has {finished}, the same command goes on")
                raise
            seconds = time.perf_counter() - started
        _summarise(tally, shards, seconds, setup.device)


def _summarise(tally: Tally, shards: Shards, seconds: float, device: str) -> None:
    speeds = f"{tally.people / seconds:.1f} people, {tally.pictures / seconds:.1f} pictures a second, {device}"
    typer.echo(f"{count_people(tally.people)} in {tally.pictures} pictures; {speeds}")
    typer.echo(f"{shards.folder} has {len(shards.there())} of {shards.count} shards")
    if tally.errors:
        rows = f"{tally.errors} row{'s' * (tally.errors > 1)}"
        typer.echo(f"partdr: warning: {rows} with an error, first {tally.first_error}", err=True)
    if tally.annotations:
        rows = f"{tally.annotations} row{'s' * (tally.annotations > 1)}"
        typer.echo(
            f"partdr: warning: {rows} with a warning about annotations, first {tally.first_annotation}", err=True
        )
    if tally.unread:
        pictures = f"{tally.unread} picture{'s' * (tally.unread > 1)}"
        typer.echo(f"partdr: warning: {pictures} could not be read; the same command tries again", err=True)
    if tally.failed:
        typer.echo(f"partdr: {tally.failures} of {tally.rows} rows have an error", err=True)
        raise typer.Exit(1)


def _name_or_sha256(given: str) -> str:
    """Return a name as it is, or the SHA-256 of a file."""
    return _sha256(Path(given)) if Path(given).is_file() else given


def _sha256(path: Path) -> str:
    try:
        return file_sha256(path)
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or error}; expected a file") from error


def _versions(device: str) -> dict[str, Any]:
    """Versions of the packages that make the rows, and the device."""
    import platform

    import pyarrow
    import torch
    import warp

    versions = {"warp-partdr": __version__, "warp": warp.config.version, "torch": torch.__version__}
    versions |= {"pyarrow": pyarrow.__version__, "python": platform.python_version(), "machine": platform.machine()}
    return {"versions": versions, "device": device}
