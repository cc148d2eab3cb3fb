"""Finder of arguments that travel in untyped tuples and dicts, where neither a reader nor mypy sees their names.

* A tuple carries arguments if it is a parameter or a local variable of ``tuple[Any, ...]``, or of four or more things
  of three or more types, or if four or more things are splatted: ``rest = a, b, c, d`` and ``f(*rest)``.
* A dict carries arguments if it is a local variable or a parameter of strings and ``Any``, or is written out with
  names, and is splatted into a call: ``how = {"size": 3}`` and ``f(**how)``.

A typed dataclass is what should carry them. ``np.savez`` is left out, which takes a file's arrays by their names.
"""

from __future__ import annotations

import ast
from collections.abc import Iterable, Iterator

_WRITERS = ("np.savez", "np.savez_compressed")
_ANY = ("Any", "object")
_MANY = 4  # things that nobody tells apart by their order


def find_carriers(module: ast.Module) -> Iterator[str]:
    """Carriers of a module as ``function: carrier``, such as ``fit_everyone: fit_photo(**how)``."""
    for function in _functions(module):
        annotated = dict(_annotations(function))
        written = {}
        for node in _own_nodes(function):
            if isinstance(node, ast.Assign) and len(node.targets) == 1 and isinstance(node.targets[0], ast.Name):
                written[node.targets[0].id] = node.value
            elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name) and node.value is not None:
                written[node.target.id] = node.value
        for name, annotation in annotated.items():
            if _is_loose_tuple(annotation):
                yield f"{function.name}: {name}: {ast.unparse(annotation)}"
        for node in _own_nodes(function):
            if not isinstance(node, ast.Call) or ast.unparse(node.func) in _WRITERS:
                continue
            for argument in node.args:
                if isinstance(argument, ast.Starred) and _has_many(written.get(_name(argument.value))):
                    yield f"{function.name}: {ast.unparse(node.func)}(*{_name(argument.value)})"
            for keyword in node.keywords:
                name = _name(keyword.value)
                if keyword.arg is None and (
                    _is_loose_dict(annotated.get(name)) or _has_written_names(written.get(name))
                ):
                    yield f"{function.name}: {ast.unparse(node.func)}(**{name})"


def _functions(module: ast.Module) -> Iterator[ast.FunctionDef | ast.AsyncFunctionDef]:
    for node in ast.walk(module):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            yield node


def _own_nodes(function: ast.AST) -> Iterator[ast.AST]:
    """Nodes of a function's body, without those of functions in it."""
    for child in ast.iter_child_nodes(function):
        if not isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            yield child
            yield from _own_nodes(child)


def _annotations(function: ast.FunctionDef | ast.AsyncFunctionDef) -> Iterator[tuple[str, ast.expr]]:
    """Annotated parameters and local variables."""
    for node in _own_nodes(function.args):
        if isinstance(node, ast.arg) and node.annotation is not None:
            yield node.arg, node.annotation
    for node in _own_nodes(function):
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            yield node.target.id, node.annotation


def _name(node: ast.expr) -> str:
    return node.id if isinstance(node, ast.Name) else ""


def _subscripts(annotation: ast.expr, names: Iterable[str]) -> Iterator[list[str]]:
    """Types in the brackets of types of some names, such as ``["int", "str"]`` of ``tuple[int, str] | None``."""
    parts = [annotation]
    while parts:
        part = parts.pop()
        if isinstance(part, ast.BinOp):
            parts += [part.left, part.right]
        elif isinstance(part, ast.Subscript) and _name(part.value) in names:
            inner = part.slice.elts if isinstance(part.slice, ast.Tuple) else [part.slice]
            yield [ast.unparse(each) for each in inner]


def _is_loose_tuple(annotation: ast.expr) -> bool:
    for inner in _subscripts(annotation, ["tuple"]):
        if inner in ([name, "..."] for name in _ANY) or (len(inner) >= _MANY and len(set(inner)) >= 3):
            return True
    return False


def _is_loose_dict(annotation: ast.expr | None) -> bool:
    if annotation is None:
        return False
    return any(inner[0] == "str" and inner[-1] in _ANY for inner in _subscripts(annotation, ["dict", "Mapping"]))


def _has_many(value: ast.expr | None) -> bool:
    return isinstance(value, ast.Tuple) and len(value.elts) >= _MANY


def _has_written_names(value: ast.expr | None) -> bool:
    if isinstance(value, ast.Dict):
        return any(isinstance(key, ast.Constant) for key in value.keys)
    return isinstance(value, ast.Call) and _name(value.func) == "dict" and any(word.arg for word in value.keywords)
