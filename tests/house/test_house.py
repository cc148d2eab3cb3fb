"""The layout holds: each wing imports from those below it alone, and a name is defined once.

``LEVELS`` is the order of the wings, lowest first.
"""

from __future__ import annotations

import ast
import importlib
import json
import re
import sys
from collections import defaultdict
from collections.abc import Iterator
from functools import cache
from importlib.util import resolve_name
from pathlib import Path

import pytest
from carriers import find_carriers

ROOT = Path(__file__).resolve().parents[2]
# Folder of the repository: its place in the package.
SOURCES = {"warp_partdr": "", "kernels": "kernels.", "body": "body.", "demos/viewer": "viewer."}
LEVELS = (
    "_lazy",
    "reference",
    "errors",
    "kernels",
    "interop",
    "files",
    "cameras",
    "body",
    "metrics",
    "inputs",
    "render",
    "models",
    "networks",
    "solve",
    "pipelines",
    "results",
    "plot",
    "bulk",
    "lab",
    "benchmark",
    "cli",
    "viewer",
)
BESIDE_THE_WINGS = {"__init__", "__main__", "_lazy", "benchmark", "cameras", "errors", "metrics", "plot"}
# Public modules: whatever users import comes from one of these, and each name from one alone.
FACES = ("warp_partdr", "warp_partdr.benchmark", "warp_partdr.metrics", "warp_partdr.plot")
# Public names that pages tell of in words, for no example that runs anywhere can be given.
TOLD_IN_WORDS = {
    "BoxNetwork": "needs a network that finds people",
    "GivenNetworks": "needs a network of another's",
    "KeypointNetwork": "needs a network of another's",
    "align_films": "needs films that start apart",
    "find_film_predictions": "needs a network of another's",
    "from_smplx": "needs a file that nobody may pass on",
    "load_keypoint_network": "needs a checkpoint",
    "load_part_network": "needs a checkpoint",
    "match_films": "needs films of several cameras",
    "place_cameras": "needs films of several cameras",
    "place_film_cameras": "needs films of several cameras",
    "read_cameras": "needs a calibration",
    "refine_meshes": "needs several people of one kind",
    "set_graph_memory": "would change the pages that run after it",
    "to_smplx": "needs a file that nobody may pass on",
}
# Inner modules that pages name for those who read the code.
INNER_MODULES_OF_PAGES = {
    "docs/explanation/exact_renderer.md: warp_partdr.reference": "the formula book",
    "docs/reference/formula_book.md: warp_partdr.body.posing.pose": "an example of the table's names",
}
# Where arguments are parsed: the command line, the harness of measurements, tutorials, and tools of the repository.
PARSERS = ("warp_partdr/cli/", "warp_partdr/lab/harness.py", "demos/", "scripts/", "benchmarks/")
OTHER_PARSERS = {
    "warp_partdr/lab/bench/kernels/first_call.py": "is started as a process of its own, to time the first call",
    "warp_partdr/lab/bench/kernels/start.py": "is started as a process of its own, to time the start",
    "warp_partdr/reference/__main__.py": "prints one equation, with NumPy alone",
}
# Tuples and dicts that carry arguments and are right as they are.
RIGHT_CARRIERS = {
    "__init__: Progress(*columns)": "columns of rich, which takes any number",
    "__init__: fuse_conv_bn_weights(*statistics)": "torch's own operator",
    "_read_union: kinds: tuple[Any, ...]": "types of a union, as typing gives them",
    "find_together: _Graph(*key)": "the cache's key is all that a graph depends on",
    "are_good: _Graph(*key)": "the cache's key is all that a graph depends on",
    "forward: torch.cudnn_convolution_add_relu(*summed)": "torch's own operator",
    "from_json: cls(**fields)": "fields of a JSON object, by their names in the file",
    "of_arrays: cls(**values)": "arrays of a file, by their names in it",
}
# Functions of autograd outside of ``interop``, whose ``Operation`` binds kernels.
OTHER_FUNCTIONS = {
    "warp_partdr/lab/bench/kernels/calls.py: _Nothing": "is autograd alone, whose own time it tells",
    "warp_partdr/lab/bench/kernels/peers.py: _MitsubaMaps": "binds another renderer, not a kernel",
    "warp_partdr/lab/training/joint_norm.py: _Normalise": "launches no kernel; its gradient is a sum over processes",
}
QUESTIONS = r"(What|Which|How|Whether|Where|Whose)\b"
# Openings that only a reader of the neighbour understands, or that leave the noun out; a letter alone is no noun. Tests
# may have them.
FRAGMENTS = (
    r"(The same|As|Of|For|With|By|From|In|To|At|On|So|When|While|If|Between|Around|Besides|After|Before|Such|Those"
    r"|Their|Its|Your|Whom|Who|Nothing|Nobody|Somebody|Anything|One's|Up|None|[A-Z](?= and |,)|[A-Z]\.$)(?!\w)|[(\[]"
)

pytestmark = pytest.mark.skipif(not (ROOT / "pyproject.toml").exists(), reason="needs the repository around the tests")


@cache
def modules() -> dict[str, Path]:
    """Files by their dotted name in the package; of a folder, that of its ``__init__.py``."""
    found = {}
    for folder, prefix in SOURCES.items():
        for path in (ROOT / folder).rglob("*.py"):
            name = prefix + path.relative_to(ROOT / folder).with_suffix("").as_posix().replace("/", ".")
            found[re.sub(r"\.?__init__$", "", name)] = path
    return found


@cache
def tree(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


@cache
def imports() -> dict[str, set[str]]:
    """Imports of each module from the package, also inside functions and for type checkers alone."""
    graph: dict[str, set[str]] = {}
    for name, path in modules().items():
        graph[name] = {target for node in ast.walk(tree(path)) for target in _targets(name, path, node)}
    return graph


def _targets(name: str, path: Path, node: ast.AST) -> Iterator[str]:
    if isinstance(node, ast.Import):
        yield from (alias.name.partition("warp_partdr.")[2] for alias in node.names if "warp_partdr." in alias.name)
    if isinstance(node, ast.ImportFrom):
        package = name if path.name == "__init__.py" else name.rpartition(".")[0]
        source = resolve_name("." * node.level + (node.module or ""), f"warp_partdr.{package}".rstrip("."))
        top, _, source = source.partition(".")
        inner = [f"{source}.{alias.name}".lstrip(".") for alias in node.names if top == "warp_partdr"]
        yield from (each if each in modules() else source for each in inner)


def level(name: str) -> int:
    return LEVELS.index(wing(name))


def product_files() -> list[Path]:
    folders = ("warp_partdr", "kernels", "body", "demos", "benchmarks", "scripts")
    return [path for folder in folders for path in sorted((ROOT / folder).rglob("*.py"))]


def short(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def test_few_modules_lie_beside_the_wings():
    assert {path.stem for path in (ROOT / "warp_partdr").glob("*.py")} == BESIDE_THE_WINGS


def test_every_wing_has_its_level_and_says_what_it_holds():
    wings = {wing(name) for name in modules()} - {"", "__main__"}
    assert wings == set(LEVELS)
    for name, path in modules().items():
        assert ast.get_docstring(tree(path)), f"{name}: no docstring"


def test_imports_go_down():
    top = {"", "__main__"}  # the table of public names, and the launcher
    upward = [
        f"{name} -> {target}"
        for name, targets in imports().items()
        for target in targets
        if name not in top and target and level(target) > level(name)
    ]
    assert sorted(upward) == []


def wing(name: str) -> str:
    return name.partition(".")[0]


def test_the_formula_book_is_read_by_tests_alone():
    readers = {name for name, targets in imports().items() if "reference" in map(wing, targets)}
    assert sorted(name for name in readers if wing(name) != "reference") == []
    tools = set(product_files()) - set(modules().values())
    assert {"benchmarks", "demos", "scripts"} <= {path.parent.name for path in tools}
    assert [short(path) for path in tools if "warp_partdr.reference" in path.read_text(encoding="utf-8")] == []


def test_the_product_imports_nothing_of_the_laboratory():
    """Commands, the demo's window and the public face of the laboratory show it to users."""
    readers = {name for name, targets in imports().items() if "lab" in map(wing, targets)}
    assert {wing(name) for name in readers} == {"lab", "benchmark", "cli", "viewer"}


def test_the_formula_book_needs_numpy_alone():
    foreign = set()
    for name, path in modules().items():
        for node in ast.walk(tree(path)) if wing(name) == "reference" else ():
            if isinstance(node, ast.Import):
                foreign |= {wing(alias.name) for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and not node.level:
                foreign.add(wing(node.module or ""))
    assert foreign - set(sys.stdlib_module_names) == {"numpy"}
    assert {wing(target) for name, targets in imports().items() if wing(name) == "reference" for target in targets} == {
        "reference"
    }


def test_modules_do_not_import_one_another_in_circles():
    graph = {name: targets - {""} for name, targets in imports().items() if name}  # "": a lazy table of names
    done: set[str] = set()
    path: list[str] = []

    def visit(name: str) -> None:
        assert name not in path, f"circle: {' -> '.join([*path[path.index(name) :], name])}"
        if name in done:
            return
        path.append(name)
        for target in sorted(graph.get(name, ())):
            visit(target)
        done.add(path.pop())

    for name in sorted(graph):
        visit(name)


def public_definitions() -> dict[str, set[str]]:
    """Modules that define each public top-level function and class, type aliases and constants aside."""
    where: dict[str, set[str]] = defaultdict(set)
    for name, path in modules().items():
        for node in tree(path).body:
            if isinstance(node, ast.FunctionDef | ast.ClassDef) and not node.name.startswith("_"):
                where[node.name].add(name)
    return where


def test_a_name_is_defined_once():
    twice = {name: sorted(where) for name, where in public_definitions().items() if len(where) > 1}
    assert twice == {}


def pages() -> list[Path]:
    return [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]


@cache
def page_code() -> dict[str, str]:
    """Code that users read, by the file: of pages, tutorial scripts and the notebook."""
    code = {short(path): path.read_text(encoding="utf-8") for path in sorted((ROOT / "demos").glob("*.py"))}
    for page in pages():
        code[short(page)] = "\n".join(re.findall(r"```python\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL))
    notebook = json.loads((ROOT / "demos" / "partdr.ipynb").read_text(encoding="utf-8"))
    cells = ["".join(cell["source"]) for cell in notebook["cells"] if cell["cell_type"] == "code"]
    code["demos/partdr.ipynb"] = re.sub(r"(?m)^%.*$", "", "\n".join(cells))
    return code


@cache
def public_names() -> dict[str, list[str]]:
    """Public names of each public module."""
    names = {face: importlib.import_module(face).__all__ for face in FACES}
    return {face: [name for name in listed if not name.startswith("_")] for face, listed in names.items()}


def test_each_public_name_is_there_and_has_one_path():
    faces: dict[str, list[str]] = defaultdict(list)
    for face, names in public_names().items():
        for name in names:
            assert getattr(importlib.import_module(face), name) is not None
            faces[name].append(face)
    assert {name: where for name, where in faces.items() if len(where) > 1} == {}


def test_each_public_name_is_shown_at_work():
    """A page, a tutorial script or the notebook shows it in code. A few names are told of in words."""
    code = "\n".join(page_code().values())
    words = "\n".join(page.read_text(encoding="utf-8") for page in pages())
    names = [name for listed in public_names().values() for name in listed]
    hidden = {name for name in names if not re.search(rf"\b{name}\b", code)}
    assert hidden == set(TOLD_IN_WORDS)
    assert [name for name in sorted(hidden) if not re.search(rf"`[^`\n]*\b{name}\b[^`\n]*`", words)] == []


def page_imports(code: str) -> Iterator[tuple[str, str]]:
    """Modules of the package that code imports from, and the names; "" for a module as a whole."""
    for node in ast.walk(ast.parse(code)):
        if isinstance(node, ast.Import):
            yield from ((alias.name, "") for alias in node.names if alias.name.startswith("warp_partdr"))
        elif isinstance(node, ast.ImportFrom) and (node.module or "").partition(".")[0] == "warp_partdr":
            yield from ((node.module or "", alias.name) for alias in node.names)


def test_pages_import_public_names_alone():
    assert sum(len(list(page_imports(code))) for code in page_code().values()) > 100
    private = [
        f"{file}: {module}.{name}".rstrip(".")
        for file, code in page_code().items()
        for module, name in page_imports(code)
        if not (module in FACES and name in ["", *public_names()[module]]) and f"{module}.{name}" not in FACES
    ]
    assert private == []


def test_pages_name_no_inner_module():
    """A path such as `warp_partdr.body.posing` in the words of a page would become wrong with the next move."""
    inner = []
    for page in pages():
        words = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
        for path in re.findall(r"(?<!python -m )\bwarp_partdr((?:\.[a-z_]\w*)+)", words):
            module = path.split(".")[1]
            if f"warp_partdr.{module}" not in FACES and module not in public_names()["warp_partdr"]:
                inner.append(f"{short(page)}: warp_partdr{path}")
    assert sorted(inner) == sorted(INNER_MODULES_OF_PAGES)


def test_arguments_are_parsed_by_the_command_line_alone():
    parsing = []
    for path in product_files():
        used = {alias.name for node in ast.walk(tree(path)) if isinstance(node, ast.Import) for alias in node.names}
        used |= {node.module for node in ast.walk(tree(path)) if isinstance(node, ast.ImportFrom) and node.module}
        used |= {ast.unparse(node) for node in ast.walk(tree(path)) if isinstance(node, ast.Attribute)} & {"sys.argv"}
        if used & {"argparse", "click", "optparse", "sys.argv", "typer"} and not short(path).startswith(PARSERS):
            parsing.append(short(path))
    assert sorted(parsing) == sorted(OTHER_PARSERS)


def test_arguments_do_not_travel_in_tuples_and_dicts():
    """A new one is to become a typed dataclass, or names."""
    found = {carrier for path in product_files() for carrier in find_carriers(tree(path))}
    assert sorted(found - set(RIGHT_CARRIERS)) == []
    assert sorted(set(RIGHT_CARRIERS) - found) == [], "gone: take them out of the list"


@pytest.mark.parametrize(
    ("code", "found"),
    [
        ("def f(a: tuple[Any, ...]): ...", ["f: a: tuple[Any, ...]"]),
        ("def f(a: tuple[int, str, float, Path] | None): ...", ["f: a: tuple[int, str, float, Path] | None"]),
        ("def f(a: tuple[int, int, int, int, int]): ...", []),
        ("def f():\n    a = 1, 2, 3, 4\n    g(*a)", ["f: g(*a)"]),
        ("def f():\n    a = 1, 2\n    g(*a)", []),
        ("def f():\n    how: dict[str, Any] = {}\n    g(**how)", ["f: g(**how)"]),
        ("def f():\n    how = {'a': 1}\n    g(**how)", ["f: g(**how)"]),
        ("def f():\n    how = dict(a=1)\n    g(**how)", ["f: g(**how)"]),
        ("def f(how: Mapping[str, object]):\n    g(**how)", ["f: g(**how)"]),
        ("def f(**how: Any):\n    g(**how)", []),
        ("def f():\n    a = {'x': 1}\n    np.savez(path, **a)", []),
        ("def f():\n    a = {'x': 1}\n    def g(a):\n        h(**a)", []),
    ],
)
def test_carriers_are_found(code: str, found: list[str]):
    assert list(find_carriers(ast.parse(code))) == found


def autograd_functions(module: ast.Module) -> Iterator[str]:
    """Names of classes that are functions of autograd."""
    for node in ast.walk(module):
        if isinstance(node, ast.ClassDef) and any(ast.unparse(base).endswith("Function") for base in node.bases):
            yield node.name


def test_kernels_are_bound_to_torch_by_operations():
    """A new binding is a subclass of ``Operation``, so that all have the same errors and second derivatives."""
    found = {
        f"{short(path)}: {name}"
        for path in product_files()
        if not short(path).startswith("warp_partdr/interop/")
        for name in autograd_functions(tree(path))
    }
    assert sorted(found - set(OTHER_FUNCTIONS)) == []
    assert sorted(set(OTHER_FUNCTIONS) - found) == [], "gone: take them out of the list"


@pytest.mark.parametrize(
    ("code", "found"),
    [
        ("class A(torch.autograd.Function): ...", ["A"]),
        ("def f():\n    class A(Function): ...", ["A"]),
        ("class A(Operation): ...", []),
    ],
)
def test_functions_of_autograd_are_found(code: str, found: list[str]):
    assert list(autograd_functions(ast.parse(code))) == found


PLAIN = re.compile(r"(bool|int|str|tuple\[(int|str), \.\.\.\]|np\.ndarray|_Coat)")  # not on a device


def freed_tables(code: ast.Module) -> Iterator[str]:
    """Functions of a device or a model whose values a cache of a limited size frees, though a graph may read them."""
    for node in ast.walk(code):
        if isinstance(node, ast.FunctionDef) and {"device", "model"} & {each.arg for each in node.args.args}:
            caches = [each for each in map(ast.unparse, node.decorator_list) if each.startswith("lru_cache")]
            if caches and not (node.returns and PLAIN.fullmatch(ast.unparse(node.returns))):
                yield node.name


def test_tables_on_devices_are_kept_while_graphs_read_them():
    package = [path for path in product_files() if not short(path).startswith("benchmarks/")]
    found = {f"{short(path)}: {name}" for path in package for name in freed_tables(tree(path))}
    assert sorted(found) == [], "expected device_cache"


@pytest.mark.parametrize(
    ("code", "found"),
    [
        ("@lru_cache(maxsize=8)\ndef order(device: str) -> wp.array: ...", ["order"]),
        ("@lru_cache\ndef order(names, model) -> tuple[Tensor, ...]: ...", ["order"]),
        ("@lru_cache(maxsize=8)\ndef fuses(device: str) -> bool: ...", []),
        ("@device_cache(8)\ndef order(device: str) -> wp.array: ...", []),
        ("@lru_cache(maxsize=8)\ndef order(names) -> ndarray: ...", []),
    ],
)
def test_caches_that_free_tables_are_found(code: str, found: list[str]):
    assert list(freed_tables(ast.parse(code))) == found


def test_contributing_says_where_each_wing_is():
    """All levels are there, from the highest to the lowest; ``reference`` is told of below the list."""
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    section = text.partition("## Where things are\n")[2].partition("\n## ")[0]
    lines = re.findall(r"(?m)^ {4}([a-z_]+(?: · [a-z_]+)*)(?: {2,}| \()", section)
    shown = [[LEVELS.index(name) for name in line.split(" · ")] for line in lines]
    wings = {LEVELS.index(name) for name in LEVELS if not name.startswith("_") and name != "reference"}
    assert {index for line in shown for index in line} == wings
    assert [lines[i] for i in range(1, len(lines)) if max(shown[i]) > min(shown[i - 1])] == []
    assert "`reference`" in section


def first_lines(path: Path) -> Iterator[str]:
    """First lines of a file's docstrings."""
    for node in ast.walk(tree(path)):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            text = ast.get_docstring(node)
            if text:
                yield text.splitlines()[0]


def test_docstrings_begin_with_a_noun_or_a_verb():
    """Docstrings outside of the tests also name the thing that they describe, instead of pointing to a neighbour."""
    ours = product_files()
    texts = [(path, line) for path in ours for line in first_lines(path)]
    tests = [(path, line) for path in sorted((ROOT / "tests").rglob("*.py")) for line in first_lines(path)]
    assert len(texts) > 1000
    assert [(short(path), line) for path, line in texts + tests if re.match(QUESTIONS, line)] == []
    assert [(short(path), line) for path, line in texts if re.match(FRAGMENTS, line)] == []


def entries(path: Path) -> Iterator[str]:
    """Descriptions of a file's arguments and attributes, as far as their first line goes."""
    for node in ast.walk(tree(path)):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            section = ""
            for line in (ast.get_docstring(node) or "").splitlines():
                if line and not line.startswith(" "):
                    section = line
                elif section in ("Args:", "Attributes:"):
                    yield from re.findall(r"^ {4}[*\w][*\w, ]*(?: \([^)]*\))?: (.*)", line)


def test_arguments_and_attributes_are_described_by_a_noun():
    """A reader who sees one entry alone learns from it what the thing is."""
    described = [(path, entry) for path in product_files() for entry in entries(path)]
    assert len(described) > 1500
    wrong = {path for path, entry in described if re.match(rf"{QUESTIONS}|{FRAGMENTS}|[^A-Z`]", entry)}
    assert [short(path) for path in sorted(wrong)] == []


def test_tests_are_named_by_sentences():
    """The name says what must hold, and two words are the shortest sentence."""
    for path in sorted((ROOT / "tests").rglob("test_*.py")):
        names = [node.name for node in ast.walk(tree(path)) if isinstance(node, ast.FunctionDef)]
        assert [name for name in names if re.fullmatch(r"test_[a-z0-9]+", name)] == [], short(path)


@pytest.mark.parametrize(
    ("line", "refused"),
    [
        ("The same for arrays.", True),
        ("Of the people.", True),
        ("As ``find_camera``, of a crop.", True),
        ("Those of one person.", True),
        ("N.", True),
        ("(H, W) [px].", True),
        ("The same people's vertices.", True),
        ("Areas of the people.", False),
        ("Offset from the first frame.", False),
        ("Format of the file.", False),
        ("The camera of the crop's own picture.", False),
    ],
)
def test_openings_without_a_noun_are_found(line: str, refused: bool):
    assert bool(re.match(FRAGMENTS, line)) == refused
