"""One text from the source of several modules: everything that some names need, and nothing else.

Starting from a few names, functions, classes and constants are collected from the modules that define them. Methods
that no collected code mentions, annotations and comments are left out. A name that two modules define differently gets
the name of its module appended.
"""

import ast
from collections.abc import Iterable, Set
from dataclasses import dataclass, field
from functools import cache
from importlib.util import find_spec
from pathlib import Path

PACKAGES = ("workbench", "robot_model")
_FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef)


@dataclass(frozen=True)
class Symbol:
    """A name at the top of a module."""

    module: str
    name: str


@dataclass
class _Module:
    """Definitions of a module by name: statements, names imported from our packages, other imports."""

    definitions: dict[str, ast.stmt] = field(default_factory=dict)
    imported: dict[str, Symbol] = field(default_factory=dict)
    modules: dict[str, str] = field(default_factory=dict)
    imports: dict[str, str] = field(default_factory=dict)


def bundle(roots: Iterable[Symbol], methods: Iterable[str] = ()) -> str:
    """Source text that defines the roots and all that they need.

    methods: names of methods that will be called, and so are kept with all that they need.
    Raises RuntimeError where a name cannot be made unique, which is a fault of the code that is bundled.
    """
    roots = [_resolved(root) for root in roots]
    symbols, mentioned = _needed(roots, set(methods))
    names = _unique_names(symbols)
    imports: set[str] = set()
    pieces = []
    for symbol in _ordered(roots, symbols, mentioned):
        node = _trimmed(symbol, mentioned)
        imports |= _imports_of(symbol.module, node)
        pieces.append(ast.unparse(_Renamed(symbol, names).visit(node)))
    head = "\n".join(sorted(imports))
    return "\n\n\n".join([head, *pieces]) + "\n"


@cache
def _module(name: str) -> _Module:
    spec = find_spec(name)
    tree = ast.parse(Path(spec.origin).read_text(encoding="utf-8"))
    source_module = _Module()
    for node in tree.body:
        _note(source_module, node)
    return source_module


def _note(source_module: _Module, node: ast.stmt) -> None:
    if isinstance(node, (*_FUNCTIONS, ast.ClassDef)):
        source_module.definitions[node.name] = node
    elif isinstance(node, ast.Assign):
        for name in _targets(node):
            source_module.definitions[name] = node
    elif isinstance(node, ast.AnnAssign) and node.value is not None:
        source_module.definitions[node.target.id] = ast.Assign([node.target], node.value, lineno=0)
    elif isinstance(node, ast.Import):
        for alias in node.names:
            line = f"import {alias.name}" + (f" as {alias.asname}" if alias.asname else "")
            source_module.imports[alias.asname or alias.name.partition(".")[0]] = line
    elif isinstance(node, ast.ImportFrom):
        for alias in node.names:
            _note_import(source_module, node.module, alias)


def _note_import(source_module: _Module, module: str, alias: ast.alias) -> None:
    name = alias.asname or alias.name
    if module.partition(".")[0] not in PACKAGES:
        renamed = f" as {alias.asname}" if alias.asname else ""
        source_module.imports[name] = f"from {module} import {alias.name}{renamed}"
    elif _is_module(f"{module}.{alias.name}"):
        source_module.modules[name] = f"{module}.{alias.name}"
    else:
        source_module.imported[name] = Symbol(module, alias.name)


def _is_module(name: str) -> bool:
    try:
        return find_spec(name) is not None
    except ModuleNotFoundError:
        return False


def _targets(node: ast.Assign) -> list[str]:
    return [
        part.id
        for target in node.targets
        for part in ast.walk(target)
        if isinstance(part, ast.Name)
    ]


def _resolved(symbol: Symbol) -> Symbol:
    """Module that defines a name, through the imports of other modules."""
    while symbol.name in _module(symbol.module).imported:
        symbol = _module(symbol.module).imported[symbol.name]
    return symbol


def _needed(roots: list[Symbol], methods: set[str]) -> tuple[set[Symbol], set[str]]:
    """All symbols that the roots need, and every attribute name that their code mentions."""
    symbols, mentioned = set(roots), methods
    while True:
        found, names = set(symbols), set(mentioned)
        for symbol in symbols:
            content = _content(symbol, mentioned)
            found |= content.needed
            names |= content.attributes
        if (found, names) == (symbols, mentioned):
            return symbols, mentioned
        symbols, mentioned = found, names


def _references(module: str, node: ast.AST) -> set[Symbol]:
    """Symbols of our packages that some code names."""
    source_module, found = _module(module), set()
    for part in ast.walk(node):
        if isinstance(part, ast.Name) and (
            part.id in source_module.definitions or part.id in source_module.imported
        ):
            found.add(_resolved(Symbol(module, part.id)))
        elif _is_of_module(source_module, part):
            found.add(_resolved(Symbol(source_module.modules[part.value.id], part.attr)))
    return found


def _is_of_module(source_module: _Module, part: ast.AST) -> bool:
    is_attribute = isinstance(part, ast.Attribute) and isinstance(part.value, ast.Name)
    return is_attribute and part.value.id in source_module.modules


def _imports_of(module: str, node: ast.AST) -> set[str]:
    known = _module(module).imports
    found = set()
    for p in ast.walk(node):
        if isinstance(p, ast.Name) and p.id in known:
            found.add(known[p.id])
    return found


@dataclass(frozen=True)
class _Content:
    """Names in a trimmed definition: symbols, those of them that it needs where it is defined, and attributes."""

    needed: frozenset[Symbol]
    needed_at_once: frozenset[Symbol]
    attributes: frozenset[str]


def _content(symbol: Symbol, mentioned: set[str]) -> _Content:
    """The content of a definition with the methods that some code mentions."""
    node = _module(symbol.module).definitions[symbol.name]
    body = node.body if isinstance(node, ast.ClassDef) else ()
    methods = {part.name for part in body if isinstance(part, _FUNCTIONS)}
    return _content_with(symbol, frozenset(methods & mentioned))


@cache
def _content_with(symbol: Symbol, methods: frozenset[str]) -> _Content:
    """The same, made once for each choice of methods."""
    node = _trimmed(symbol, methods)
    needed = frozenset(_references(symbol.module, node))
    attributes = frozenset(part.attr for part in ast.walk(node) if isinstance(part, ast.Attribute))
    at_once = frozenset(_references(symbol.module, _BodyRemover().visit(node)))
    return _Content(needed, at_once, attributes)


def _trimmed(symbol: Symbol, mentioned: Set[str]) -> ast.stmt:
    """A copy of a definition without annotations and without methods that no code mentions."""
    function = ast.parse(ast.unparse(_module(symbol.module).definitions[symbol.name])).body[0]
    if isinstance(function, ast.ClassDef):
        function.body = [part for part in function.body if _is_kept(part, mentioned)] or [
            ast.Pass()
        ]
    return ast.fix_missing_locations(_Bare().visit(function))


def _is_kept(part: ast.stmt, mentioned: Set[str]) -> bool:
    if not isinstance(part, _FUNCTIONS):
        return True
    return part.name in mentioned or (part.name.startswith("__") and part.name.endswith("__"))


class _Bare(ast.NodeTransformer):
    """Takes annotations out; those of dataclass fields become `object`."""

    def visit_FunctionDef(self, node):  # noqa: N802
        """A function without annotations."""
        self.generic_visit(node)
        node.returns = None
        arguments = (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)
        for argument in (*arguments, node.args.vararg, node.args.kwarg):
            if argument is not None:
                argument.annotation = None
        return node

    def visit_AnnAssign(self, node):  # noqa: N802
        """A field of a dataclass keeps that it is one."""
        node.annotation = ast.Name("object", ast.Load())
        return node


class _Renamed(ast.NodeTransformer):
    """Gives every name of our packages the one that it has in the bundle."""

    def __init__(self, symbol: Symbol, names: dict[Symbol, str]):
        self.module, self.names = symbol.module, names
        self.own = _module(symbol.module)

    def _new(self, name: str) -> str:
        if name not in self.own.definitions and name not in self.own.imported:
            return name
        return self.names.get(_resolved(Symbol(self.module, name)), name)

    def visit_Name(self, node):  # noqa: N802
        """A name that is read, or set at the top of the module."""
        node.id = self._new(node.id)
        return node

    def visit_Attribute(self, node):  # noqa: N802
        """`module.name` becomes the name alone."""
        if _is_of_module(self.own, node):
            symbol = _resolved(Symbol(self.own.modules[node.value.id], node.attr))
            return ast.copy_location(ast.Name(self.names[symbol], node.ctx), node)
        return self.generic_visit(node)

    def visit_FunctionDef(self, node):  # noqa: N802
        """A function and its body; its parameters must not hide a name that is changed."""
        arguments = (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)
        hidden = [a.arg for a in arguments if self._new(a.arg) != a.arg]
        if hidden:
            raise RuntimeError(
                f"{self.module}.{node.name}: the parameter {hidden[0]} hides a name that the bundle has to change"
            )
        if node.name in self.own.definitions and self.own.definitions[node.name] is not None:
            if _is_top(self.own, node):
                node.name = self._new(node.name)
        return self.generic_visit(node)

    def visit_ClassDef(self, node):  # noqa: N802
        """A class and its body."""
        node.name = self._new(node.name)
        return self.generic_visit(node)


def _is_top(source_module: _Module, node: ast.FunctionDef) -> bool:
    """Whether a function stands at the top of its module: methods may share a name with such a one."""
    top = source_module.definitions[node.name]
    return isinstance(top, _FUNCTIONS) and len(top.args.args) == len(node.args.args)


def _unique_names(symbols: set[Symbol]) -> dict[Symbol, str]:
    """A name for each symbol; those that modules share get the module's name appended."""
    by_name: dict[str, list[Symbol]] = {}
    for symbol in symbols:
        by_name.setdefault(symbol.name, []).append(symbol)
    names = {}
    for name, group in by_name.items():
        for symbol in group:
            last = symbol.module.rpartition(".")[2]
            if len(group) == 1:
                names[symbol] = name
            else:
                names[symbol] = f"{name}_{last}"
    if len(set(names.values())) < len(names):
        raise RuntimeError("two modules of one name define the same name")
    return names


def _ordered(roots, symbols: set[Symbol], mentioned: set[str]) -> list[Symbol]:
    """Every symbol after all that its definition needs at once: base classes, decorators, defaults, constants.

    What only a body names may come later. A constant may call functions, so that their bodies count, too.
    """
    done: list[Symbol] = []
    seen: set[Symbol] = set()

    def visit(symbol: Symbol, with_bodies: bool) -> None:
        if symbol in seen:
            return
        seen.add(symbol)
        content = _content(symbol, mentioned)
        is_constant = isinstance(_module(symbol.module).definitions[symbol.name], ast.Assign)
        with_bodies = with_bodies or is_constant
        first = content.needed if with_bodies else content.needed_at_once
        for other in _sorted(first):
            visit(other, with_bodies)
        done.append(symbol)
        for other in _sorted(content.needed - first):
            visit(other, False)

    for root in roots:
        visit(root, False)
    return _one_each(done)


def _sorted(symbols: set[Symbol]) -> list[Symbol]:
    return sorted(symbols, key=lambda symbol: (symbol.module, symbol.name))


class _BodyRemover(ast.NodeTransformer):
    """Takes the bodies of functions out, so that only what runs at their definition stays."""

    def visit_FunctionDef(self, node):  # noqa: N802
        """A function without its body."""
        node.body = [ast.Pass()]
        return node

    def visit_Lambda(self, node):  # noqa: N802
        """A lambda without its body."""
        node.body = ast.Constant(None)
        return node


def _one_each(symbols: list[Symbol]) -> list[Symbol]:
    """The symbols without further names of one statement, as of `A, B = 1, 2`."""
    retained, nodes = [], []
    for symbol in symbols:
        node = _module(symbol.module).definitions[symbol.name]
        if not any(node is other for other in nodes):
            nodes.append(node)
            retained.append(symbol)
    return retained
