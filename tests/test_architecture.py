"""The floors of the package: who may import whom, and how light the root stays."""

from __future__ import annotations

import ast
import importlib.util
import subprocess
import sys
from pathlib import Path

import pytest

import graspmap

ROOT = Path(graspmap.__file__).parent
FLOOR = {
    "errors": 0,
    "lazy": 0,
    "files": 1,
    "config": 2,
    "geometry": 2,
    "gripper": 3,
    "data": 4,
    "maps": 4,
    "simulation": 4,
    "networks": 5,
    "losses": 5,
    "generation": 5,
    "metrics": 5,
    "pictures": 5,
    "inference": 6,
    "training": 7,
    "evaluation": 7,
    "doctor": 7,
    "robot": 7,
    "reproduction": 8,
    "cli": 9,
    "web": 9,
}
NO_TORCH = ("geometry", "gripper", "data", "maps", "simulation", "metrics", "pictures")


def sources():
    return [p for p in sorted(ROOT.rglob("*.py")) if p != ROOT / "__init__.py"]


def place(path: Path) -> str:
    return path.relative_to(ROOT).parts[0].removesuffix(".py")


def imports(tree: ast.AST, *, top_only: bool = False):
    """Dotted names that a module imports; with top_only, not those inside functions."""
    nodes = [tree]
    while nodes:
        node = nodes.pop()
        if isinstance(node, ast.Import):
            yield from ((alias.name, node.lineno) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            for alias in node.names:
                yield f"{node.module}.{alias.name}", node.lineno
        for child in ast.iter_child_nodes(node):
            function = isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef)
            if not (top_only and (function or _type_checking(child))):
                nodes.append(child)


def _type_checking(node: ast.AST) -> bool:
    return isinstance(node, ast.If) and getattr(node.test, "id", "") == "TYPE_CHECKING"


def test_every_module_has_a_floor():
    assert {place(p) for p in sources()} <= FLOOR.keys()


def test_imports_go_down():
    wrong = []
    for path in sources():
        here = place(path)
        for name, line in imports(ast.parse(path.read_text())):
            parts = name.split(".")
            if parts[0] != "graspmap" or len(parts) < 2 or parts[1].startswith("__"):
                continue
            there = parts[1]
            if there != here and FLOOR[there] >= FLOOR[here]:
                wrong.append(f"{path.relative_to(ROOT)}:{line} imports {name}")
    assert not wrong, "\n".join(wrong)


def test_no_import_circles_inside_a_folder():
    graph: dict[str, set[str]] = {}
    for path in sources():
        module = ".".join(("graspmap", *path.relative_to(ROOT).with_suffix("").parts))
        module = module.removesuffix(".__init__")
        graph[module] = {n for n, _ in imports(ast.parse(path.read_text()), top_only=True)}
    known = graph.keys()
    edges = {
        m: {t for n in names for t in (n, n.rpartition(".")[0]) if t in known and t != m}
        for m, names in graph.items()
    }
    packages = {m for m in known if any(o.startswith(m + ".") for o in known)}
    done: set[str] = set()

    def visit(module: str, trail: tuple[str, ...]) -> None:
        assert module not in trail, " -> ".join((*trail[trail.index(module) :], module))
        if module in done:
            return
        for target in sorted(edges[module] - packages):
            visit(target, (*trail, module))
        done.add(module)

    for module in sorted(known):
        visit(module, ())


def test_lower_floors_do_not_need_torch():
    wrong = [
        f"{p.relative_to(ROOT)}:{line} imports {name}"
        for p in sources()
        if place(p) in NO_TORCH and not p.stem.startswith("torch_")
        for name, line in imports(ast.parse(p.read_text()), top_only=True)
        if name.split(".")[0] in ("torch", "lightning")
    ]
    assert not wrong, "\n".join(wrong)


def test_root_import_is_light():
    code = (
        "import sys, time; import numpy; t = time.perf_counter(); import graspmap;"
        "print(time.perf_counter() - t);"
        "print([m for m in ('torch', 'numba', 'cv2', 'scipy', 'pydantic', 'lightning', 'rich',"
        " 'tyro', 'yaml') if m in sys.modules])"
    )
    seconds, heavy = (
        subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
        .stdout.strip()
        .splitlines()
    )
    assert heavy == "[]"
    assert float(seconds) < 0.3


def test_public_names_are_these():
    assert sorted(graspmap.__all__) == sorted(graspmap._HOME)
    for name in graspmap.__all__:
        assert getattr(graspmap, name).__name__ == name


@pytest.mark.parametrize("folder", ["benchmarks", "studies"])
def test_what_stands_beside_the_package_finds_what_it_takes_from_it(folder):
    """Nothing else runs these: a name that has moved would be seen by their users first."""
    beside = ROOT.parents[1] / folder
    for path in sorted(beside.rglob("*.py")):
        for name, line in imports(ast.parse(path.read_text())):
            if name.startswith("graspmap."):
                module, _, part = name.rpartition(".")
                found = hasattr(importlib.import_module(module), part)
                assert found or importlib.util.find_spec(name), f"{path}:{line}: {name}"
