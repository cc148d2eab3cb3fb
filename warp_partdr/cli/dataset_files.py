"""Commands ``partdr report`` and ``partdr export``: a page about a data set, and files of single people from it."""

from __future__ import annotations

from enum import StrEnum
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from typer import Argument, Option

from ..errors import InputError, cause, install_command, printable
from ..files.disk import file_sha256
from .options import BareOption, BodyFormat, check_further, count_people
from .register import MODEL_HELP, read_model

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy as np

    from ..bulk.reading import PeopleFiles
    from ..models.model import DetailedModel

# The same names as in ``bulk.survey.RANKED`` and ``bulk.export.WRITERS``, which are not loaded for --help.
ByName = StrEnum("ByName", ["keypoint_error", "confidence", "energy", "score", "depth", "size"])
FormatName = StrEnum("FormatName", ["glb", "obj", "npz", "json", "usda", "usdz", "fbx"])

_MOST_DRAWN = 1000

REPORT_HELP = """Check a data set before you trust it: this writes one HTML page, which holds all its pictures.

Examples: `partdr report people --pictures photos`; `partdr report people --by depth --out depth.html`

The page shows the numbers of rows, people and errors; how often each warning occurs; distributions of scores; versions
and options, and if they are the same in all shards; shards that are missing; and the worst hundred people, the least
confident body first. If --pictures has their photos, people are drawn over them. Each has the address of the row, such
as 3/17: row 17 of shard 3, both counted from 0.
"""

EXPORT_HELP = """Write files of single people of a data set, a folder for each row, as `partdr fit` writes them.

Examples: `partdr export people --rows 3/17,3/20 --to glb`; `partdr export people --worst 20 --to npz --to json`

--rows takes addresses shard/row, both counted from 0, as `partdr report` shows them; or a range such as 0:100, counted
through all shards. Write commas between them.

--to takes glb (ellipbody.glb), npz (body.npz, which `load_body` and `partdr register` read) and json (body.json). If
rows have a detailed body (--quality mesh), glb and npz also write detailed.glb and detailed.npz, obj writes
detailed.obj, and usda, usdz (extra `usd`) and fbx (written by Blender) write detailed.usda and so on.
"""

DatasetArgument = Annotated[Path, Argument(help="Folder that `partdr dataset` wrote.", metavar="DATASET")]
ByOption = Annotated[
    ByName | None,
    Option(
        "--by",
        help=f"Quantity that decides who is worst: {', '.join(ByName)}; default: confidence, if rows have it.",
        metavar="NAME",
    ),
]


def report(
    dataset: DatasetArgument,
    out: Annotated[Path, Option(help="File for the page.", metavar="FILE.html")] = Path("report.html"),
    pictures: Annotated[
        Path | None, Option(help="Pictures, as they were given to `partdr dataset`.", metavar="PICTURES")
    ] = None,
    images: Annotated[
        Path | None,
        Option(help="Folder of COCO's pictures; default: the folder of the annotations.", metavar="FOLDER"),
    ] = None,
    worst: Annotated[
        int, Option(help="Number of the worst people who are drawn.", metavar="N", min=0, max=_MOST_DRAWN)
    ] = 100,
    by: ByOption = None,
    bare: BareOption = False,
) -> None:
    """Write the page of a data set; see ``REPORT_HELP``."""
    files = _open(dataset, "report")
    _check_outside(out, dataset)

    from ..bulk.drawn_people import draw_worst
    from ..bulk.page import write_page
    from ..bulk.survey import survey_people
    from ..results.result_sets import check_folder, scratch_folder
    from .progress import PictureProgress

    check_folder(out.parent)
    read, note = _reader(pictures, images)
    with PictureProgress(len(files.paths), "shards") as progress:
        survey = survey_people(files, by and by.value, worst, progress)
    detailed = (
        read_model("anny", "cpu") if _made_with(files) == "anny" else None
    )  # with other models, ellipsoids are drawn
    people = {}
    with PictureProgress(len(survey.worst.values), "pictures") as progress:
        for drawn in draw_worst(files, survey.worst, read, detailed, bare=bare):
            people[drawn.address] = drawn
            progress(drawn.picture)
    if pictures is not None:
        readable = sum(each.on_photo for each in people.values())
        note = f"Left the photo and keypoints, right the body; {readable} of {len(people)} photos could be read."
    if detailed is not None:
        note += " A line around the body is the outline of its clothes and hair."
    page = write_page(files, survey, [people[address] for address in survey.worst.addresses], note=note)
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        with scratch_folder(out.parent) as scratch:
            (scratch / out.name).write_text(page, encoding="utf-8")
            (scratch / out.name).replace(out)
    except OSError as error:
        raise InputError(f"{out}: {cause(error)}; expected a file that can be written") from error
    said = f"{survey.rows:,} rows, {survey.bodies:,} bodies, {survey.rows_at_fault:,} errors, {survey.warned:,} warned"
    typer.echo(f"{out}: {said}; the worst {len(people)} are drawn")


def export(
    dataset: DatasetArgument,
    rows: Annotated[str | None, Option(help="Whom, such as 3/17 or 0:100.", metavar="ROWS")] = None,
    worst: Annotated[int | None, Option(help="Or so many of the worst.", metavar="N", min=1)] = None,
    by: ByOption = None,
    to: Annotated[
        list[FormatName] | None,
        Option(help="glb, obj, npz, json, usda, usdz, fbx; may be given again.", metavar="NAME"),
    ] = None,
    model: Annotated[
        str | None, Option(help=f"Of detailed bodies: {MODEL_HELP}; by default theirs.", metavar="NAME")
    ] = None,
    out: Annotated[Path, Option(help="Folder for the people's folders.", metavar="FOLDER")] = Path("out/people"),
    bare: BareOption = False,
) -> None:
    """Write people of a data set; see ``EXPORT_HELP``."""
    files = _open(dataset, "export")
    formats = [each.value for each in to or [FormatName.glb]]
    check_further([name for name in formats if name in list(BodyFormat)])  # before shards are read, which takes long
    if (rows is None) == (worst is None):
        raise InputError(f"{'--rows: missing' if rows is None else '--worst: with --rows'}; expected one of both")
    _check_outside(out, dataset)

    from ..bulk.export import save_person
    from ..bulk.reading import PersonRow, by_shard
    from ..bulk.survey import worst_people
    from ..results.result_sets import check_folder
    from .progress import PictureProgress

    check_folder(out)
    if rows is not None:
        chosen = files.select(rows)
    else:
        with PictureProgress(len(files.paths), "shards") as progress:
            chosen = by_shard(worst_people(files, by and by.value, worst or 0, progress).addresses)
    detailed = _model(files, model)
    written = 0
    empty: list[str] = []
    with PictureProgress(sum(map(len, chosen.values())), "people") as progress:
        for shard, places in chosen.items():
            about = files.about(shard)
            for address, row in files.rows(shard, places):
                person = PersonRow.of(address, row, str(files.path(shard)))
                if person is None:
                    empty.append(f"{address} ({row['error'] or 'nobody in it'})")
                else:
                    save_person(person, formats, detailed, out, about, bare=bare)
                    written += 1
                progress(str(address))
    if not written:
        raise InputError(f"{dataset}: no body in rows such as {empty[0]}; expected rows with one")
    typer.echo(f"{count_people(written)} written to {out}")
    if empty:
        typer.echo(f"partdr: warning: {len(empty)} without a body, first {empty[0]}", err=True)


def _open(folder: Path, command: str) -> PeopleFiles:
    """Open the data set of a command, which needs pyarrow."""
    if find_spec("pyarrow") is None:
        raise InputError(f"partdr {command}: without pyarrow; expected it: {install_command('dataset')}")

    from ..bulk.reading import PeopleFiles
    from ..interop.devices import choose_device

    choose_device("cpu")  # keeps Warp from printing what it loads
    return PeopleFiles.open(folder)


def _check_outside(out: Path, dataset: Path) -> None:
    """Raise InputError if results would be in a data set's folder, where readers take every file for Parquet."""
    if out.resolve().is_relative_to(dataset.resolve()):
        raise InputError(f"--out: {out}, in the data set, of which readers take all files; expected another folder")


def _reader(pictures: Path | None, images: Path | None) -> tuple[Callable[[str], np.ndarray] | None, str]:
    """Reader of a picture by its name, and a note; without pictures, None and a note that says so."""
    if pictures is None:
        if images is not None:
            raise InputError(f"--images: {images}, without --pictures; expected COCO's annotations with it")
        return None, "Without --pictures, bodies and keypoints alone."

    from ..bulk.opening import open_source

    source = open_source(pictures, images)
    names = {printable(name): name for name in source.names}  # rows hold printable names
    return lambda name: source.read(names.get(name, name)).pixels, ""


def _made_with(files: PeopleFiles) -> str | None:
    """Model of the detailed bodies, as the first shard states it: a name, or the SHA-256 of its file."""
    made = files.about(next(iter(files.paths))).get("options", {}).get("model")
    return None if made is None else str(made)


def _model(files: PeopleFiles, given: str | None) -> DetailedModel | None:
    """Load the detailed model of the data set's bodies; None if they have none."""
    made = _made_with(files)
    if made is None:
        if given is not None:
            raise InputError(f"--model: {given}; expected none: rows hold no detailed body")
        return None
    same = given is None or given == made or (Path(given).is_file() and file_sha256(Path(given)) == made)
    if not same or (given is None and made != "anny"):
        found = "missing" if given is None else given
        raise InputError(f"--model: {found}; expected that of the data set: {'anny' if made == 'anny' else made[:16]}")
    return read_model(given or made, "cpu")
