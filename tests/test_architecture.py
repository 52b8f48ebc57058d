"""The plan of the package, kept by reading the syntax trees of its files.

A new top-level module needs a place in ``LAYERS``; everything else finds new files by itself.
"""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).parent.parent
PACKAGE = ROOT / "circlecal"
FILES = sorted(PACKAGE.rglob("*.py"))

LAYERS: tuple[frozenset[str], ...] = (
    frozenset({"errors", "__init__"}),
    frozenset({"geometry", "files", "names", "refusals"}),
    frozenset({"yaml_text", "checks"}),
    frozenset({"field"}),
    frozenset({"observations"}),
    frozenset({"results"}),
    frozenset({"camera", "paint", "pictures"}),
    frozenset({"line_naming", "detection"}),
    frozenset({"placement", "estimation"}),
    frozenset({"stages"}),
    frozenset({"records"}),
    frozenset({"formats"}),
    frozenset({"solvers"}),
    frozenset({"config"}),
    frozenset({"pipeline"}),
    frozenset({"overlay"}),
    frozenset({"api", "synthetic"}),
    frozenset({"batch"}),
    frozenset({"rig"}),
    frozenset({"tracking"}),
    frozenset({"report", "workbench"}),
    frozenset({"evaluation"}),
    frozenset({"cli"}),
    frozenset({"__main__"}),
)
"""From the bottom to the top: a module may import what stands in a lower layer, and its own package."""

RANK = {name: rank for rank, names in enumerate(LAYERS) for name in names}
FACADE = PACKAGE / "__init__.py"
"""Names what users import from higher up, and loads it when it is first used."""
FORBIDDEN_NAMES = {
    "util",
    "helper",
    "manager",
    "process",
    "processor",
    "processing",
    "params",
    "misc",
    "common",
    "data",
}
MACHINE_PATHS = re.compile(r"(?<![\w.~-])/(?:work|home|root|opt|mnt|srv|Users)/\w|[A-Za-z]:\\{1,2}Users")
TEXT_SUFFIXES = {".py", ".md", ".yaml", ".yml", ".toml", ".json", ".txt", ".cfg", ".sh", ".css", ".html", ".js"}


@pytest.fixture(scope="module", autouse=True)
def _trees_are_dropped() -> Iterator[None]:
    """The million nodes that tests of this module share are not kept, nor searched for garbage, until all tests end."""
    yield
    for shared in (_tree, _nodes, _formulas, _modules):
        shared.cache_clear()


def _name(file: Path) -> str:
    return str(file.relative_to(ROOT))


@cache
def _tree(file: Path) -> ast.Module:
    return ast.parse(file.read_text(encoding="utf-8"), filename=str(file))


@cache
def _nodes(file: Path) -> list[ast.AST]:
    return list(ast.walk(_tree(file)))


@cache
def _formulas(file: Path) -> list[tuple[int, str]]:
    """Line and text of every operation and call."""
    return [(n.lineno, ast.unparse(n)) for n in _nodes(file) if isinstance(n, ast.BinOp | ast.Call)]


def _component(file: Path) -> str:
    """The top-level module or package that a file belongs to."""
    return file.relative_to(PACKAGE).parts[0].removesuffix(".py")


@cache
def _modules(file: Path) -> list[tuple[str, int]]:
    """Dotted name and line of everything that a file imports, also inside functions and for type checkers only."""
    found: list[tuple[str, int]] = []
    package = ["circlecal", *file.relative_to(PACKAGE).parts[:-1]]
    for node in _nodes(file):
        if isinstance(node, ast.Import):
            found += [(alias.name, node.lineno) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = ".".join(package[: len(package) - node.level + 1]) if node.level else ""
            module = ".".join(part for part in (base, node.module) if part)
            found += [(f"{module}.{alias.name}", node.lineno) for alias in node.names]
    return found


def _own(file: Path) -> list[tuple[str, str, int]]:
    """Top-level component, dotted name and line of what a file imports from the package itself."""
    found = []
    for name, line in _modules(file):
        parts = name.split(".")
        if parts[0] == "circlecal":
            known = len(parts) > 1 and ((PACKAGE / parts[1]).is_dir() or (PACKAGE / f"{parts[1]}.py").is_file())
            found.append((parts[1] if known else "__init__", name, line))
    return found


def _foreign(file: Path) -> set[str]:
    return {name.split(".")[0] for name, _ in _modules(file)} - {"circlecal"}


def _in(*components: str) -> list[Path]:
    return [file for file in FILES if _component(file) in components]


def test_there_is_something_to_check():
    assert len(FILES) > 10
    assert any(name == "numpy" for file in _in("geometry") for name in _foreign(file))


def test_every_module_has_a_place():
    unknown = {_component(file) for file in FILES} - set(RANK)
    assert not unknown, f"give these a place in LAYERS: {sorted(unknown)}"


def test_imports_point_down_only():
    wrong = [
        f"{_name(file)}:{line} imports {name}"
        for file in FILES
        if file != FACADE
        for target, name, line in _own(file)
        if target != _component(file) and RANK.get(target, 0) >= RANK.get(_component(file), 99)
    ]
    assert not wrong, "\n".join(wrong)


def test_the_table_of_packages_has_the_order_of_the_layers():
    rows = re.findall(r"^\| (.*?) \|", (PACKAGE / "README.md").read_text().partition("## Words")[0], flags=re.MULTILINE)
    names = [name for row in rows for name in re.findall(r"`(\w+)(?:\.py|/)`", row)]
    assert sorted(names) == sorted(RANK.keys() - {"__init__", "__main__"})
    assert [RANK[name] for name in names] == sorted(RANK[name] for name in names)


def _dotted(file: Path) -> str:
    return ".".join(("circlecal", *file.relative_to(PACKAGE).with_suffix("").parts)).removesuffix(".__init__")


def _circle(files: list[Path]) -> list[str]:
    """Dotted names of files that import each other in a circle; empty where there is none."""
    names = {_dotted(file) for file in files}
    imports = {}
    for file in files:
        found = {name if name in names else name.rpartition(".")[0] for _, name, _ in _own(file)}
        imports[_dotted(file)] = (found & names) - {_dotted(file)}
    while leaves := {name for name, wanted in imports.items() if not wanted & imports.keys()}:
        imports = {name: wanted for name, wanted in imports.items() if name not in leaves}
    while roots := imports.keys() - {target for wanted in imports.values() for target in wanted}:
        imports = {name: wanted for name, wanted in imports.items() if name not in roots}
    return sorted(imports)


@pytest.mark.parametrize("package", sorted({_component(file) for file in FILES if file.parent != PACKAGE}))
def test_files_of_a_package_import_each_other_in_one_direction(package):
    assert not _circle(_in(package))


def test_errors_imports_nothing():
    assert not _modules(PACKAGE / "errors.py")


def test_geometry_is_pure_numpy():
    allowed = {
        "numpy",
        "__future__",
        "abc",
        "collections",
        "dataclasses",
        "enum",
        "functools",
        "itertools",
        "math",
        "typing",
    }
    wrong = {_name(file): _foreign(file) - allowed for file in _in("geometry") if _foreign(file) - allowed}
    assert not wrong


def test_field_and_result_types_know_no_pictures():
    for file in _in("field", "observations", "results"):
        assert not _foreign(file) & {"cv2", "skimage", "scipy"}, _name(file)


def test_stages_see_no_paths():
    wrong = []
    for file in _in("geometry", "stages", "solvers", "camera", "line_naming", "paint", "observations", "results"):
        wrong += [f"{_name(file)} imports {m}" for m in _foreign(file) & {"pathlib", "os", "io", "shutil", "tempfile"}]
        wrong += [
            f"{_name(file)}:{node.lineno} opens a file"
            for node in _nodes(file)
            if isinstance(node, ast.Call)
            and ast.unparse(node.func) in {"open", "cv2.imread", "cv2.imwrite", "np.load", "np.save"}
        ]
    assert not wrong, "\n".join(wrong)


def test_a_stage_imports_no_other_stage_and_only_the_mask_detects():
    wrong = []
    for file in _in("stages"):
        for target, name, line in _own(file):
            if target == "stages" and file.name != "__init__.py":
                wrong.append(f"{_name(file)}:{line} imports {name}")
            if target == "detection" and file.name != "mask.py":
                wrong.append(f"{_name(file)}:{line} detects")
    allowed = ("circlecal.detection.keypoints.", "circlecal.detection.Detection")
    wrong += [
        f"{_name(file)} imports {name}"
        for file in FILES
        if _component(file) not in {"detection", "placement", "stages", "evaluation", "tracking"}
        for target, name, _ in _own(file)
        if target == "detection" and not name.startswith(allowed)
    ]
    assert not wrong, "\n".join(wrong)


def test_overlay_draws_and_never_estimates():
    for file in _in("overlay"):
        targets = {target for target, _, _ in _own(file)}
        assert not targets & {"stages", "detection", "solvers", "pipeline", "config"}, _name(file)


def test_command_line_computes_nothing():
    for file in _in("cli"):
        assert not _foreign(file) & {"numpy", "cv2", "skimage", "scipy"}, _name(file)
        assert not {t for t, _, _ in _own(file)} & {"geometry", "stages", "detection", "solvers"}, _name(file)


def test_only_the_command_line_prints_and_exits():
    wrong = [
        f"{_name(file)}:{node.lineno} {ast.unparse(node.func)}"
        for file in FILES
        if _component(file) != "cli"
        for node in _nodes(file)
        if isinstance(node, ast.Call) and ast.unparse(node.func) in {"print", "sys.exit", "exit", "quit"}
    ]
    wrong += [
        f"{_name(f)} imports {m}" for f in FILES if _component(f) != "cli" for m in _foreign(f) & {"typer", "rich"}
    ]
    assert not wrong, "\n".join(wrong)


def test_no_bare_except():
    wrong = [
        f"{_name(file)}:{node.lineno}"
        for file in FILES
        for node in _nodes(file)
        if isinstance(node, ast.ExceptHandler) and (node.type is None or ast.unparse(node.type) == "BaseException")
        if node.type is None or not any(isinstance(inner, ast.Raise) for inner in ast.walk(node))
    ]
    assert not wrong, "\n".join(wrong)


def test_no_random_numbers_without_a_generator():
    wrong = [
        f"{_name(file)}:{node.lineno} {ast.unparse(node.func)}"
        for file in FILES
        for node in _nodes(file)
        if isinstance(node, ast.Call)
        for called in [ast.unparse(node.func)]
        if (
            re.match(r"(np|numpy)\.random\.", called)
            and not called.endswith(("default_rng", "Generator", "PCG64", "SeedSequence"))
        )
        or (called.endswith("default_rng") and not node.args)
    ]
    assert not wrong, "\n".join(wrong)


def test_module_and_class_names_say_what_they_are():
    def weak(name: str) -> bool:
        words = re.findall(r"[A-Z]?[a-z]+", name)
        return any(word.lower() in FORBIDDEN_NAMES or word.lower().rstrip("s") in FORBIDDEN_NAMES for word in words)

    wrong = [
        _name(file) for file in FILES if any(weak(part) for part in file.relative_to(PACKAGE).with_suffix("").parts)
    ]
    wrong += [
        f"{_name(file)}:{node.lineno} {node.name}"
        for file in FILES
        for node in _nodes(file)
        if isinstance(node, ast.ClassDef) and weak(node.name)
    ]
    assert not wrong, "\n".join(wrong)


def _public(scope: ast.Module | ast.ClassDef) -> list[ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef]:
    found = []
    for node in scope.body:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef) and not node.name.startswith("_"):
            overload = isinstance(node, ast.FunctionDef) and any(
                "overload" in ast.unparse(d) for d in node.decorator_list
            )
            found += [] if overload else [node]
            found += _public(node) if isinstance(node, ast.ClassDef) else []
    return found


@pytest.mark.parametrize("file", FILES, ids=_name)
def test_everything_public_has_a_docstring(file):
    tree = _tree(file)
    missing = [] if ast.get_docstring(tree) or not tree.body else ["module"]
    missing += [node.name for node in _public(tree) if not ast.get_docstring(node)]
    assert not missing


PARTICIPLE = re.compile(
    r"(?!(bed|embed|exceed|feed|need|proceed|red|seed|shed|speed)$)\w+ed"
    r"|begun|bent|blown|broken|built|chosen|drawn|fallen|found|frozen|given|gone|grown|held|kept|laid|lost|made|met|mown"
    r"|seen|sent|shown|spoken|taken|thrown|told|torn|turned|woven|written"
)
TERMS = frozenset({"closed", "fixed", "imaged", "known", "shared"})
"""Adjectives of the field's own terms: closed form, fixed position, imaged centre, known point, shared parameter."""
VERBS = frozenset({"begin", "count", "draw", "find", "select", "skip", "solve"})
"""May be followed by what they are done to: ``skip_finished``."""
BOOLEAN = ("is_", "has_", "are_", "can_", "may_")


def _is_participle(word: str) -> bool:
    return word not in TERMS and PARTICIPLE.fullmatch(word) is not None


def _participles(tree: ast.AST) -> list[tuple[int, str]]:
    """Functions whose name begins or ends with a participle, other than properties and questions."""
    found = []
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            name = node.name.strip("_")
            is_property = any("property" in ast.unparse(decorator) for decorator in node.decorator_list)
            words = name.split("_")
            bare = _is_participle(words[0]) or (_is_participle(words[-1]) and words[0] not in VERBS)
            if bare and not is_property and not name.startswith(BOOLEAN):
                found.append((node.lineno, node.name))
    return found


def _leaning(tree: ast.AST) -> list[tuple[int, str]]:
    """Docstrings, of constants and attributes too, that say only how they differ from a neighbour."""
    texts = [
        node.value for node in ast.walk(tree) if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
    ]
    return [
        (text.lineno + number, line.strip())
        for text in texts
        if isinstance(text.value, str)
        for number, line in enumerate(text.value.splitlines())
        if re.match(r"\s*The same (with|without|as|along|in|of|by|for|from)\b", line)
        or (number == 0 and re.match(r"\s*(The same|Likewise|As (in )?:)", line))
    ]


def test_functions_are_verbs_or_nouns_and_texts_stand_by_themselves():
    wrong = [
        f"{_name(file)}:{line} {text}"
        for file in FILES
        for line, text in (*_participles(_tree(file)), *_leaning(_tree(file)))
    ]
    assert not wrong, "\n".join(wrong)


def test_participles_and_leaning_texts_are_recognised():
    tree = ast.parse(
        "def seen_edge(): 'The same on ice.'\n"
        "def first_accepted(): ...\n"
        "def skip_finished(): ...\n"
        "def is_drawn(): ...\n"
        "def imaged_center(): ...\n"
        "class Prior:\n"
        "    @property\n"
        "    def found(self): 'What the same camera saw.'\n"
        "    width = 1\n"
        "    'As :attr:`x`.'\n"
    )
    assert {name for _, name in _participles(tree)} == {"seen_edge", "first_accepted"}
    assert [line for line, _ in _leaning(tree)] == [1, 10]


ONE_DEFINITION = {
    "lens": (
        {"geometry/camera.py", "evaluation/soccernet_metric.py"},
        re.compile(r"\b[135](\.0)? [*+] .*(\bk1\b|\bk2\b|kappa|\.radial)"),
    ),
    "surface": ({"geometry/surface.py"}, re.compile(r"/ (\w+\.)*reference_m\b")),
    "projection": (
        {
            "geometry/camera.py",
            "geometry/camera_parameters.py",
            "camera/viewing_coordinates.py",
            "evaluation/reading.py",
            "evaluation/soccernet_metric.py",
            "rig/tripod.py",
            "synthetic/tripod.py",
            "tracking/search.py",
            "placement/camera_batch.py",
        },
        re.compile(r"\brotation_matrix\(|\brotations_by\(|\brotations\(|\.R @|@ (\w+\.)+(R|rotation)\b"),
    ),
}
"""Where a formula is written down, and what gives it away elsewhere.

``evaluation`` reads cameras as the official metric does, with OpenCV's full lens model, and must not depend on what it
judges; the viewing coordinates are other parameters of the same pose; tripods put their rotation together from head and
lean, and the search for one projects thousands of heads in single precision, as that for a field's placement does
thousands of cameras, to whole pixels.
"""


@pytest.mark.parametrize("formula", ONE_DEFINITION)
def test_lens_surface_and_projection_are_defined_once(formula):
    homes, telltale = ONE_DEFINITION[formula]
    found = {
        str(file.relative_to(PACKAGE)): f"{_name(file)}:{line} {text}"
        for file in FILES
        for line, text in _formulas(file)
        if telltale.search(text)
    }
    assert set(found) <= homes, "\n".join(found[file] for file in set(found) - homes)
    assert next(iter(sorted(homes))) in found, "the formula is no longer recognised where it belongs"


def test_no_machine_paths():
    folders = ("circlecal", "configs", "tests", "samples", ".ci")
    files = [f for name in folders for f in (ROOT / name).rglob("*") if f.is_file()]
    files += [ROOT / "README.md", ROOT / "pyproject.toml"]
    wrong = [
        f"{_name(file)}: {found.group()}"
        for file in files
        if (file.suffix in TEXT_SUFFIXES or file.parent.name == ".ci")
        and file.is_file()
        and "__pycache__" not in file.parts
        for found in MACHINE_PATHS.finditer(file.read_text(encoding="utf-8", errors="replace"))
    ]
    assert not wrong, "\n".join(wrong)


def test_package_imports_without_its_heavy_dependencies():
    code = "import sys, circlecal; print(sorted({'cv2', 'skimage', 'scipy', 'pydantic', 'numpy'} & set(sys.modules)))"
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, check=True)
    assert answer.stdout.strip() == "[]"


def _resolves(name: str, module: ModuleType) -> bool:
    """Whether a name in the texts of a module is one of that module, its classes or its package, or a whole path."""
    package = import_module(module.__name__.rpartition(".")[0] or module.__name__)
    homes = (module, package, *(value for value in vars(module).values() if isinstance(value, type)))
    return any(_has(home, name.split(".")) for home in homes) or _is_path(name.split("."))


def _has(home: object, parts: list[str]) -> bool:
    first, *rest = parts
    if not hasattr(home, first):
        return not rest and first in getattr(home, "__annotations__", {})
    return not rest or _has(getattr(home, first), rest)


def _is_path(parts: list[str]) -> bool:
    """Whether the parts lead from a module that can be imported to something in it."""
    for count in range(len(parts), 0, -1):
        try:
            module = import_module(".".join(parts[:count]))
        except ImportError:
            continue
        return count == len(parts) or _has(module, parts[count:])
    return False


def _can_be_imported(file: Path) -> bool:
    """Whether what a file imports is installed: some files need an extra."""
    return all(find_spec(name) is not None for name in _foreign(file) - {"__main__"})


@pytest.mark.parametrize("package", sorted({_component(file) for file in FILES} - {"__main__"}))
def test_what_docstrings_refer_to_exists(package):
    reference = re.compile(r":(?:mod|func|class|data|meth|attr|obj|exc):`~?([^`]+)`")
    wrong = []
    for file in _in(package):
        names = set(reference.findall(file.read_text(encoding="utf-8")))
        module = import_module(_dotted(file)) if names and _can_be_imported(file) else None
        wrong += [f"{_name(file)}: {n}" for n in sorted(names) if module and not _resolves(n, module)]
    assert not wrong, "\n".join(wrong)


def test_lengths_in_pictures_refer_to_one_width():
    """Pixels at 1920 px width; what is 1280 px wide elsewhere is a size, and divides nothing."""
    other = re.compile(r"PX1280|px1280|/ ?1280\b")
    assert [path.name for path in FILES if other.search(path.read_text(encoding="utf-8"))] == []
