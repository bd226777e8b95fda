"""Examples in Python on the pages of the documentation: found, run, or at least read closely."""

from __future__ import annotations

import ast
import builtins
import dataclasses
import importlib
import inspect
import re
import typing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

NOT_RUN = "<!-- not run by the tests"
"""Begins the line before an example that takes too long; what follows there says why."""

_BLOCK = re.compile(r"(?P<before>[^\n]*)\n```py(?:thon)?\n(?P<code>.*?)\n```", flags=re.S)


@dataclass(frozen=True)
class Example:
    """One block of Python on a page.

    Attributes:
        page: its name under the project's root.
        line: of the block's first line on the page, from 1.
        code: its text.
        runs: whether the tests run it.
    """

    page: str
    line: int
    code: str
    runs: bool

    def __str__(self) -> str:
        return f"{self.page}:{self.line}"

    def compiled(self) -> Any:
        """Its code; errors name page and line."""
        return compile("\n" * (self.line - 1) + self.code, self.page, "exec")


def examples_of(root: Path, page: str) -> list[Example]:
    """All examples on a page."""
    text = (root / page).read_text(encoding="utf-8")
    return [
        Example(
            page, text[: found.start("code")].count("\n") + 1, found["code"],
            not found["before"].startswith(NOT_RUN),
        )
        for found in _BLOCK.finditer(text)
    ]  # fmt: skip


def read_closely(example: Example, known: dict[str, type]) -> None:
    """Hold an example that is not run against what it names: imports, names, arguments, attributes.

    Args:
        example: not run.
        known: classes of names that are given, such as fixtures.

    Raises:
        AssertionError: something does not exist, or does not take such arguments.
    """
    tree = ast.parse(example.code)
    given: dict[str, Any] = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom):
            module = importlib.import_module(node.module or "")
            given |= {alias.asname or alias.name: getattr(module, alias.name) for alias in node.names}
        elif isinstance(node, ast.Import):
            given |= {alias.asname or alias.name: importlib.import_module(alias.name) for alias in node.names}
    types = dict(known)
    for node in ast.walk(tree):
        if isinstance(node, ast.Assign) and isinstance(node.value, ast.Call):
            returned = _returned(_callee(node.value.func, given, types))
            types |= {name.id: returned for name in node.targets if isinstance(name, ast.Name) and returned}
    bound = {node.id for node in ast.walk(tree) if isinstance(node, ast.Name) and _is_set(node)}
    bound |= {node.arg for node in ast.walk(tree) if isinstance(node, ast.arg)}
    bound |= {node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)}
    for node in ast.walk(tree):
        if isinstance(node, ast.Name) and not _is_set(node):
            there = {*given, *bound, *known, *dir(builtins)}
            assert node.id in there, f"{example}: {node.id} is not defined"
        elif isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            kind = types.get(node.value.id)
            assert kind is None or _has(kind, node.attr), f"{example}: {kind} has no {node.attr}"
        elif isinstance(node, ast.Call) and (callee := _callee(node.func, given, types)) is not None:
            words = {word.arg: None for word in node.keywords if word.arg is not None}
            is_method = isinstance(node.func, ast.Attribute) and node.func.value.id in types  # type: ignore[attr-defined]
            try:
                inspect.signature(callee).bind(*[None] * (len(node.args) + is_method), **words)
            except TypeError as error:
                raise AssertionError(f"{example}: {ast.unparse(node)}: {error}") from error


def _is_set(name: ast.Name) -> bool:
    return isinstance(name.ctx, ast.Store)


def _callee(function: ast.expr, given: dict[str, Any], types: dict[str, type]) -> Any:
    """What is called, where that is told by imports and known classes."""
    if isinstance(function, ast.Name):
        return given.get(function.id)
    if isinstance(function, ast.Attribute) and isinstance(function.value, ast.Name):
        owner = types.get(function.value.id) or given.get(function.value.id)
        return None if owner is None else getattr(owner, function.attr, None)
    return None


def _returned(callee: Any) -> type | None:
    kind = typing.get_type_hints(callee).get("return") if inspect.isroutine(callee) else None
    return kind if inspect.isclass(kind) else None


def _has(kind: type, name: str) -> bool:
    fields = {field.name for field in dataclasses.fields(kind)} if dataclasses.is_dataclass(kind) else set()
    return hasattr(kind, name) or name in fields or f"self.{name}" in inspect.getsource(kind)
