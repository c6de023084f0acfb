"""The structure of the package, checked: names, sizes, and where files stand.

`python -m tests.structure` prints every violation and exits with 1 if there is one. Exceptions
stand in `ALLOWED`, each with its reason; an exception that nothing needs is a violation too.
Import directions are checked by import-linter, style by ruff.
"""

import ast
import gc
import re
import sys
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

from tests.structure_allowed import ALLOWED

PACKAGE = Path(__file__).resolve().parents[1] / "pipeline" / "usdface"
SMALLEST_LINES = 60
"""A file shorter than this that serves one neighbour alone belongs into that neighbour."""
LONGEST_FUNCTION_LINES = 60
MOST_PARAMETERS = 8
MOST_PARAMETERS_NUMERICS = 10
DEEPEST_NESTING = 4
VAGUE_WORDS = set(
    "told said asked own apart there beneath beside held heard kept found lacking".split()
)
"""Participles and adverbs that name no quantity: never a whole name, nor how one begins."""
NESTING = (ast.For, ast.While, ast.If, ast.With, ast.Try, ast.AsyncFor, ast.AsyncWith, ast.Match)
Function = ast.FunctionDef | ast.AsyncFunctionDef


@dataclass(frozen=True)
class Violation:
    """A place that breaks a rule; `key` names it in `ALLOWED`."""

    rule: str
    key: str
    reason: str


@dataclass(frozen=True)
class Module:
    """A file of the package, parsed."""

    name: str
    """Below the package, with slashes and without an ending: ``numerics/solve/box``."""
    tree: ast.Module
    nodes: tuple[ast.AST, ...]
    """All nodes of the tree, which rules search again and again."""
    line_count: int

    @property
    def folder(self) -> str:
        return self.name.rpartition("/")[0]


def read_modules() -> dict[str, Module]:
    """Parse every file of the package, by name."""
    modules = {}
    for path in sorted(PACKAGE.rglob("*.py")):
        text = path.read_text(encoding="utf-8")
        name = path.relative_to(PACKAGE).with_suffix("").as_posix()
        tree = ast.parse(text)
        modules[name] = Module(name, tree, tuple(ast.walk(tree)), text.count("\n"))
    return modules


def unknown_step_modules(modules: dict[str, Module]) -> Iterator[Violation]:
    """A module under a workflow of steps/ is a step, a command, or listed as a helper."""
    from usdface.specs.job import COMMAND_SPECS

    steps = {spec.module for spec in COMMAND_SPECS}
    workflows = {step.partition(".")[0] for step in steps}
    for workflow in sorted(workflows):
        package = import_module(f"usdface.steps.{workflow}")
        listed = {*getattr(package, "_helpers", ()), *getattr(package, "_commands", ())}
        files = {
            name.rpartition("/")[2]
            for name, module in modules.items()
            if module.folder == f"steps/{workflow}" and not name.endswith("__init__")
        }
        expected = {step.partition(".")[2] for step in steps if step.startswith(f"{workflow}.")}
        for name in sorted(files - expected - listed):
            yield Violation("step or helper", f"steps/{workflow}/{name}", "is neither")
        for name in sorted((expected | listed) - files):
            yield Violation("step or helper", f"steps/{workflow}/{name}", "is not there")


def small_files(modules: dict[str, Module]) -> Iterator[Violation]:
    """A short file with a single importer, in its own folder, is a part of that importer."""
    importers: dict[str, set[str]] = defaultdict(set)
    for name, module in modules.items():
        for imported in _imports_of(module):
            importers[imported].add(name)
    for name, module in modules.items():
        users = importers[name] - {name}
        if name.endswith("__init__") or module.line_count >= SMALLEST_LINES or len(users) != 1:
            continue
        (user,) = users
        if modules[user].folder == module.folder:
            yield Violation("small file", name, f"{module.line_count} lines, only for {user}")


def _imports_of(module: Module) -> Iterator[str]:
    for node in module.nodes:
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("usdface"):
            base = (node.module or "").replace(".", "/").removeprefix("usdface").lstrip("/")
            yield base
            yield from (f"{base}/{alias.name}".lstrip("/") for alias in node.names)
        elif isinstance(node, ast.Import):
            yield from (
                each.name.replace(".", "/").removeprefix("usdface").lstrip("/")
                for each in node.names
            )


def vague_names(modules: dict[str, Module]) -> Iterator[Violation]:
    """A definition is named for what it is or does, a constant for its quantity."""
    for name, module in modules.items():
        for defined in _definitions(module):
            words = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", defined.strip("_")).lower().split("_")
            if words[0] in VAGUE_WORDS:
                yield Violation("vague name", f"{name}:{defined}", f"begins with {words[0]!r}")
        for constant in _numbers_of_one_word(module.tree):
            yield Violation("constant of one word", f"{name}:{constant}", "add quantity or unit")


def _definitions(module: Module) -> Iterator[str]:
    for node in module.nodes:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            yield node.name
    yield from _constants(module.tree)


def _constants(tree: ast.Module) -> Iterator[str]:
    for node in tree.body:
        targets = node.targets if isinstance(node, ast.Assign) else []
        if isinstance(node, ast.AnnAssign):
            targets = [node.target]
        yield from (target.id for target in targets if isinstance(target, ast.Name))


def _numbers_of_one_word(tree: ast.Module) -> Iterator[str]:
    """A number called REACH or BELOW leaves open what is measured, and in what unit."""
    for node in tree.body:
        if isinstance(node, ast.Assign) and _is_number(node.value):
            for target in node.targets:
                if isinstance(target, ast.Name) and "_" not in target.id.strip("_"):
                    yield target.id


def _is_number(node: ast.expr) -> bool:
    if isinstance(node, ast.UnaryOp):
        return _is_number(node.operand)
    if isinstance(node, ast.BinOp):
        return _is_number(node.left) and _is_number(node.right)
    return isinstance(node, ast.Constant) and isinstance(node.value, int | float)


def repeated_names(modules: dict[str, Module]) -> Iterator[Violation]:
    """A public name stands for one thing in the whole package."""
    places: dict[str, list[str]] = defaultdict(list)
    for name, module in modules.items():
        if name in ("api", "cli/commands"):  # they hand on
            continue
        for node in module.tree.body:
            if isinstance(node, ast.FunctionDef | ast.ClassDef) and _is_public(node.name):
                places[node.name].append(name)
        for constant in _constants(module.tree):
            if _is_public(constant):
                places[constant].append(name)
    for defined, files in places.items():
        if len(files) > 1:
            yield Violation("defined twice", defined, f"in {', '.join(files)}")


def _is_public(name: str) -> bool:
    """Leave out what every module of a kind defines: a step's `run`, a regression's `METHOD`."""
    return not name.startswith("_") and name not in ("log", "run", "main", "METHOD")


def empty_entries(modules: dict[str, Module]) -> Iterator[Violation]:
    """An entry of a docstring says more than its type, or is not there."""
    for name, module in modules.items():
        for node in module.nodes:
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
                for entry in _entries_without_text(ast.get_docstring(node) or ""):
                    yield Violation("empty entry", f"{name}:{node.name}:{entry}", "only a type")


def _entries_without_text(doc: str) -> Iterator[str]:
    lines = doc.splitlines()
    section = ""
    for number, line in enumerate(lines):
        following = lines[number + 1] if number + 1 < len(lines) else ""
        if following and set(following) == {"-"}:
            section = line
        elif following.startswith("    ") or re.search(r"[(\[{'\"]", line):
            continue  # a shape is worth an entry by itself; a bare type is not
        elif section in ("Parameters", "Attributes") and re.match(r"\*{0,2}\w[\w, *]* : ", line):
            yield line.partition(" : ")[0]
        elif section == "Returns" and re.fullmatch(r"[\w.]+", line):
            yield section


def long_functions(modules: dict[str, Module]) -> Iterator[Violation]:
    """A function is read at one sight, and takes no more than it can be read with."""
    for name, module in modules.items():
        most = MOST_PARAMETERS_NUMERICS if name.startswith("numerics/") else MOST_PARAMETERS
        for node in module.nodes:
            if not isinstance(node, Function):
                continue
            key = f"{name}:{node.name}"
            lines = _line_count(node)
            if lines > LONGEST_FUNCTION_LINES and not (
                name.startswith("steps/") and node.name == "run"
            ):
                yield Violation("long function", key, f"{lines} lines")
            count = _parameter_count(node)
            if count > most:
                yield Violation("many parameters", key, f"{count}")
            depth = _depth(node.body)
            if depth > DEEPEST_NESTING:
                yield Violation("deep nesting", key, f"{depth} levels")


def _line_count(node: Function) -> int:
    count = (node.end_lineno or node.lineno) - node.lineno + 1
    if ast.get_docstring(node) is not None:
        first = node.body[0]
        count -= (first.end_lineno or first.lineno) - first.lineno + 1
    return count


def _parameter_count(node: Function) -> int:
    given = node.args
    names = [each.arg for each in (*given.posonlyargs, *given.args, *given.kwonlyargs)]
    return len([each for each in names if each not in ("self", "cls")])


def _depth(body: list[ast.stmt]) -> int:
    deepest = 0
    for node in body:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            continue
        inner: list[list[ast.stmt]] = []
        for field in ("body", "orelse", "finalbody"):
            block = getattr(node, field, None)
            if block:
                inner.append(block)
        inner += [each.body for each in getattr(node, "handlers", ())]
        inner += [each.body for each in getattr(node, "cases", ())]
        for block in inner:
            elif_chain = (
                isinstance(node, ast.If)
                and block is node.orelse
                and len(block) == 1
                and isinstance(block[0], ast.If)
            )
            step = 0 if elif_chain or not isinstance(node, NESTING) else 1
            deepest = max(deepest, step + _depth(block))
    return deepest


RULES = (
    unknown_step_modules,
    small_files,
    vague_names,
    repeated_names,
    empty_entries,
    long_functions,
)


def violations() -> list[Violation]:
    """Return what breaks a rule and is not allowed, and what is allowed and breaks none."""
    modules = read_modules()
    broken = [each for rule in RULES for each in rule(modules)]
    open_ones = [each for each in broken if each.key not in ALLOWED.get(each.rule, {})]
    keys = {(each.rule, each.key) for each in broken}
    stale = [
        Violation("allowed for nothing", f"{rule}: {key}", "take it out of ALLOWED")
        for rule, allowed in ALLOWED.items()
        for key in allowed
        if (rule, key) not in keys
    ]
    return open_ones + stale


def main() -> int:
    """Print what breaks a rule."""
    wanted = sys.argv[1] if len(sys.argv) > 1 else ""
    found = [each for each in violations() if wanted in each.key]
    for each in found:
        print(f"{each.key}: {each.rule}: {each.reason}")  # noqa: T201
    print(f"{len(found)} violations of the structure's rules")  # noqa: T201
    return 1 if found else 0


if __name__ == "__main__":
    gc.disable()  # the trees stay to the end, and each collection would visit them all
    sys.exit(main())
