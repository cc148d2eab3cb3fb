"""The sources of pictures that a path may name."""

from __future__ import annotations

import codecs
import os
import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from ..errors import InputError, cause, printable
from ..files.disk import check_regular
from ..inputs.films import FILM_SUFFIXES
from ..inputs.keypoint_files import given_format
from ..inputs.photo_files import ARCHIVES, PHOTO_SUFFIXES, LeftOut, is_hidden_name, photos_among
from .coco import CocoPictures, open_coco
from .containers import TAR_SUFFIX, check_webdataset
from .picture_files import PictureFiles, open_files

_MANY = (*FILM_SUFFIXES, TAR_SUFFIX)  # of files that hold many pictures


def open_source(
    path: Path, images: Path | None = None, labels: str | None = None, keypoint_format: str | Path | None = None
) -> PictureFiles | CocoPictures:
    """Open what a user names: photos, films, tar files, or a COCO file of annotations.

    Args:
        path: A folder, searched with all folders in it; a list (.txt), a path a line, from its folder on; one film or
            tar file; tar files as "shards/{000..009}.tar"; or COCO's annotations (.json).
        images: Folder of a COCO file's pictures; default: the file's own.
        labels: Name or JSON file of the label set of part labels beside photos; default: ``labels.json``.
        keypoint_format: Name or JSON file of the format of all keypoints, if the files do not tell it.

    Raises:
        InputError: If there is no such thing, or no picture in it.

    Examples:
        >>> from pathlib import Path
        >>> from warp_partdr import open_source
        >>> source = open_source(Path("pictures"))
        >>> source.names
        ('photo.png',)
        >>> source.read("photo.png").size
        (512, 384)
    """
    form = None if keypoint_format is None else given_format(keypoint_format)
    ending = path.suffix.lower()
    if images is not None and (path.is_dir() or ending != ".json"):
        raise InputError(f"--images: {images}, with {path}; expected a COCO file of annotations with it")
    source: PictureFiles | CocoPictures
    if path.is_dir():
        left_out = LeftOut()
        source = open_files(path, _search(path, left_out), labels, form, left_out)
        expected = f"some: {', '.join((*PHOTO_SUFFIXES, *_MANY))}"
    elif ending == ".json":
        if labels is not None:
            raise InputError(f"--labels: {labels}, with {path}; expected part labels beside photos")
        source, expected = open_coco(path, images or path.parent, form), "some in the list images"
    elif ending == ".txt":
        source, expected = open_files(path.parent, _read_list(path), labels, form), "the path of one a line"
    elif "{" in str(path) and not path.exists():
        files = _expand(path)
        folder = Path(os.path.commonpath([file.parent for file in files]))
        source = open_files(folder, [file.relative_to(folder).as_posix() for file in files], labels, form)
        expected = "some in the tar files"
    elif ending in _MANY and path.is_file():
        source, expected = open_files(path.parent, [path.name], labels, form), "some"
    elif ending in ARCHIVES and path.is_file():
        raise InputError(f"{path}: an archive; expected it unpacked, or a .tar without compression")
    else:
        expected = "a folder of photos, a list of them (.txt), a film, tar files, or COCO's annotations (.json)"
        raise InputError(f"{path}: {'a file' if path.exists() else 'No such file or folder'}; expected {expected}")
    _check_names(source.names, source.left_out, path, expected)
    return source


def _search(folder: Path, left_out: LeftOut) -> list[str]:
    """Photos, films and tar files in a folder and all folders in it, in alphabetical order; hidden ones left out.

    Links to folders are followed last, and no folder is searched twice.

    Raises:
        InputError: If the disk does not list a folder.
    """
    found: list[str] = []
    searched: set[str] = set()
    folders, links = [folder], list[Path]()
    while folders or links:
        here = folders.pop() if folders else links.pop()
        names: list[str] = []
        try:
            path = os.path.realpath(here)
            if path in searched:
                continue
            searched.add(path)
            with os.scandir(here) as entries:
                for entry in sorted(entries, key=lambda each: each.name, reverse=True):
                    if is_hidden_name(entry.name):
                        continue
                    if entry.is_dir():
                        (links if entry.is_symlink() else folders).append(here / entry.name)
                    else:
                        names.append(entry.name)
        except PermissionError as error:
            left_out.count("whole folder", cause(error))
            continue
        except OSError as error:
            raise InputError(f"{here}: {cause(error)}; expected a folder that can be read") from error
        parent = here.relative_to(folder)
        found += ((parent / name).as_posix() for name in photos_among(names, left_out, _MANY))
    return sorted(found)


def _expand(path: Path) -> list[Path]:
    """The files of a pattern such as "{000..009}.tar", as the webdataset library writes them."""
    check_webdataset(path)
    from webdataset.shardlists import expand_urls

    files = [Path(each) for each in expand_urls(str(path))]
    for file in files:
        if file.suffix.lower() not in _MANY or not file.is_file():
            raise InputError(f"{path}: {file}: no such tar file; expected those of the pattern")
    return files


def _read_list(path: Path) -> tuple[str, ...]:
    """Paths of a text file, one a line; a name that is not UTF-8 is as the system has it."""
    try:
        check_regular(path)
        data = path.read_bytes()
        encoding = "utf-16" if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)) else "utf-8-sig"
        text = data.decode(encoding, errors="surrogateescape" if encoding == "utf-8-sig" else "strict")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: {cause(error)}; expected a list of files, one a line") from error
    lines = re.split(r"\r\n|\r|\n", text)  # splitlines would cut names at other characters, too
    return tuple(line.strip() for line in lines if line.strip())


def _check_names(names: Sequence[str], left_out: str, path: Path, expected: str) -> None:
    """Raise an InputError unless there are pictures, and rows tell them apart."""
    if not names:
        raise InputError(f"{path}: no pictures in it{f' ({left_out})' if left_out else ''}; expected {expected}")
    name, count = Counter(map(printable, names)).most_common(1)[0]
    if count > 1:
        raise InputError(f"{path}: {name} twice; expected each picture once")
