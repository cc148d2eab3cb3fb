"""OpenCV's ``FileStorage`` files, YAML and JSON: mappings, lists, numbers, texts and matrices.

PyYAML's safe loader reads the YAML: it makes no objects, and a tag that is no matrix is refused. So are aliases, which
OpenCV never writes and which let 300 bytes stand for gigabytes, nesting that no such file has, and files that are so
large that reading them would take minutes.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from ..errors import InputError, cause, shown
from .disk import check_regular
from .json_files import parse_json

_MATRICES = ("opencv-matrix", "opencv-nd-matrix")
_HEADER = re.compile(r"\A%YAML:[\d.]+\s*\n")  # OpenCV's, which YAML itself writes without the colon
# Numbers in OpenCV's JSON that JSON has not: "1." of its third version, ".Nan" and "-.Inf".
_BARE_POINT = re.compile(r"(?<=\d)\.(?=[\s,\]}eE])")
_NO_NUMBER = re.compile(r"(?<=[\s:\[,])(-?)\.(?:(Nan)|Inf)(?=[\s,\]}])")
_EXPECTED = "a file of OpenCV's FileStorage"
_DEEPEST = 32  # levels of nesting; files of cameras have four
_TOO_DEEP = f"nested more than {_DEEPEST} levels deep"
_LARGEST = 1 << 22  # [bytes] of YAML; PyYAML reads about 100 kB a second


class _Loader(yaml.SafeLoader):
    """YAML with OpenCV's matrices as mappings."""

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self._depth = 0

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        """Node of the next event; an alias, or one that is nested too deeply, is refused."""
        if self.check_event(yaml.AliasEvent):
            raise yaml.composer.ComposerError(None, None, "an alias", self.peek_event().start_mark)
        if self._depth > _DEEPEST:
            raise yaml.composer.ComposerError(None, None, _TOO_DEEP, self.peek_event().start_mark)
        self._depth += 1
        node = super().compose_node(parent, index)
        self._depth -= 1
        return node

    def fetch_flow_collection_start(self, kind: type[yaml.Token]) -> None:
        """Read "[" or "{"; the time that this takes grows with the square of the depth, which is bounded here."""
        if self.flow_level > _DEEPEST:
            raise yaml.scanner.ScannerError(None, None, _TOO_DEEP, self.get_mark())
        super().fetch_flow_collection_start(kind)

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        """Mapping of a node; a key that comes twice is refused."""
        found: dict[Any, Any] = {}
        for key, value in super().construct_pairs(node, deep=True):
            if key in found:
                raise yaml.constructor.ConstructorError(None, None, f"key {key!r} twice", node.start_mark)
            found[key] = value
        return found

    def construct_decimal(self, node: yaml.ScalarNode) -> Any:
        """Number of a node; "1:30" stays a text, where YAML 1.1 means base 60 and takes very long for a long one."""
        if ":" in (text := str(self.construct_scalar(node))):
            return text
        return self.construct_yaml_int(node) if node.tag.endswith(":int") else self.construct_yaml_float(node)


for _number in ("int", "float"):
    _Loader.add_constructor(f"tag:yaml.org,2002:{_number}", _Loader.construct_decimal)
for _matrix in _MATRICES:
    _Loader.add_constructor(f"tag:yaml.org,2002:{_matrix}", _Loader.construct_mapping)


def read_opencv(path: str | Path, expected: str = _EXPECTED) -> dict[str, Any]:
    """Read the top of a ``FileStorage`` file (.yml, .yaml or .json), matrices still as mappings (``to_matrix``).

    Raises:
        InputError: If it can't be read, is of another form, or has a key twice.
    """
    try:
        check_regular(path)
        data = Path(path).read_bytes()
        text = data.decode("utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: {cause(error)}; expected {expected}") from error
    if text.lstrip().startswith("{"):
        text = _NO_NUMBER.sub(lambda found: "NaN" if found[2] else f"{found[1]}Infinity", text)
        found = parse_json(_BARE_POINT.sub(".0", text), str(path), expected)
    else:
        if len(data) > _LARGEST:
            raise InputError(f"{path}: {len(data):,} bytes of YAML; expected {expected}, of at most {_LARGEST:,}")
        try:
            found = yaml.load(_HEADER.sub("", text), _Loader)
        except yaml.MarkedYAMLError as error:
            line = "" if error.problem_mark is None else f"line {error.problem_mark.line + 1}: "
            raise InputError(f"{path}: {line}{error.problem}; expected {expected}") from error
        except (yaml.YAMLError, ValueError, RecursionError) as error:
            raise InputError(f"{path}: {cause(error)}; expected {expected}") from error
    if not isinstance(found, dict):
        raise InputError(f"{path}: {shown(found)}; expected {expected}")
    return found


def is_matrix(value: Mapping[str, Any]) -> bool:
    """True for a matrix as ``read_opencv`` gives it."""
    return {"rows", "cols", "data"} <= value.keys() or {"sizes", "data"} <= value.keys()


def to_matrix(value: object, where: str) -> np.ndarray:
    """Numbers of a ``FileStorage`` matrix or of nested lists, float64.

    Raises:
        InputError: If it is neither, or numbers are too few, too many or not finite.
    """
    rows: Any = value
    shape: tuple[int, ...] | None = None
    if isinstance(value, Mapping):
        if not is_matrix(value):
            raise InputError(f"{where}: keys {', '.join(map(str, value))}; expected rows, cols and data of a matrix")
        sides = value.get("sizes", [value.get("rows"), value.get("cols")])
        rows, shape = value["data"], tuple(sides) if isinstance(sides, list) else (sides,)
    try:
        found = np.array(rows, dtype=np.float64)
        truths = any(isinstance(each, bool) for each in np.array(rows, dtype=object).ravel())
    except (TypeError, ValueError) as error:
        raise InputError(f"{where}: {shown(rows)}; expected numbers") from error
    if truths:
        raise InputError(f"{where}: {shown(rows)}; expected numbers, not true and false")
    if shape is not None:
        if found.ndim != 1 or not all(isinstance(side, int) for side in shape) or math.prod(shape) != found.size:
            raise InputError(f"{where}: {found.size} numbers; expected as many as {' x '.join(map(str, shape))}")
        found = found.reshape(shape)
    if not found.size or not np.isfinite(found).all():
        raise InputError(f"{where}: {shown(rows)}; expected finite numbers")
    return found
