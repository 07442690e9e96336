"""Expand xacro files to URDF by the package xacrodoc; their expressions are read here, and nothing is executed.

The package xacro evaluates ``${...}`` by ``eval``, whose restrictions can be evaded. In its place stands
:func:`evaluated`: arithmetic, comparisons, texts, lists, entries of YAML files, and the functions in ``FUNCTIONS``.
"""

from __future__ import annotations

import ast
import math
import operator
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from unittest.mock import patch

from gtau.documents.expressions import OPERATORS as ARITHMETIC
from gtau.errors import GtauError, needing, short

LARGEST = 1e30  # of a product: larger ones of whole numbers may take for ever


def _of_numbers(operation: Callable[..., Any]) -> Callable[..., Any]:
    """Restrict an operation to numbers of a size; of texts and lists it could fill the memory."""

    def restricted(*numbers: Any) -> Any:
        if not all(isinstance(number, int | float) for number in numbers):
            raise ValueError("a text or list cannot be multiplied")
        try:
            result = operation(*numbers)
        except OverflowError:
            result = math.inf
        if isinstance(result, complex) or abs(result) > LARGEST:
            raise ValueError(f"the result of {' and '.join(map(str, numbers))} is out of range")
        return result

    return restricted


OPERATORS: Mapping[type, Callable[..., Any]] = {
    **ARITHMETIC,
    **{ast.FloorDiv: operator.floordiv, ast.UAdd: operator.pos, ast.USub: operator.neg, ast.Not: operator.not_},
    **{ast.Lt: operator.lt, ast.LtE: operator.le, ast.Gt: operator.gt, ast.GtE: operator.ge},
    **{ast.Eq: operator.eq, ast.NotEq: operator.ne, ast.Is: operator.is_, ast.IsNot: operator.is_not},
    ast.Mult: _of_numbers(operator.mul),
    ast.Mod: _of_numbers(operator.mod),
    ast.Pow: _of_numbers(lambda base, power: float(base) ** float(power)),
    ast.In: lambda item, items: item in items,
    ast.NotIn: lambda item, items: item not in items,
}
BUILTINS = (list, dict, tuple, len, str, float, int, bool, min, max, round, abs, sum, any, all, sorted)
FUNCTIONS = (*BUILTINS, *(function for function in vars(math).values() if callable(function)))
OF_XACRO = ("load_yaml", "abs_filename", "dotify", "arg", "message", "warning", "error", "fatal", "tokenize")
OF_EVAL = ("arg", "dirname", "env", "optenv", "find")  # in $(eval ...)
METHODS: Mapping[type, tuple[str, ...]] = {
    str: ("split", "strip", "replace", "lower", "upper", "startswith", "endswith"),
    dict: ("get", "keys", "values", "items"),
    list: ("index", "count"),
}


@dataclass(frozen=True)
class _Expression:
    """What an expression may use: values of ``names``, no function but the ``known``."""

    names: Mapping[str, Any]
    known: Sequence[Any]

    def value(self, node: ast.expr) -> Any:
        """Evaluate a part of an expression; raises ValueError for what is not read."""
        result: Any
        match node:
            case ast.Constant(value=constant):
                result = constant
            case ast.Name(id=name):
                try:
                    result = self.names[name]
                except KeyError:
                    raise ValueError(f"unknown name '{name}'") from None
            case ast.UnaryOp(op=sign, operand=operand) if type(sign) in OPERATORS:
                result = OPERATORS[type(sign)](self.value(operand))
            case ast.BinOp(left=left, op=sign, right=right) if type(sign) in OPERATORS:
                result = OPERATORS[type(sign)](self.value(left), self.value(right))
            case ast.BoolOp(op=sign, values=[*first, last]):
                stop, values = isinstance(sign, ast.Or), (self.value(item) for item in first)
                result = next((value for value in values if bool(value) is stop), self)
                result = self.value(last) if result is self else result
            case ast.Compare(left=left, ops=signs, comparators=others):
                terms = [self.value(term) for term in (left, *others)]
                result = all(OPERATORS[type(sign)](*pair) for sign, *pair in zip(signs, terms, terms[1:], strict=False))
            case ast.IfExp(test=test, body=body, orelse=orelse):
                result = self.value(body if self.value(test) else orelse)
            case ast.List(elts=items) | ast.Tuple(elts=items):
                result = [self.value(item) for item in items]
            case ast.Subscript(value=items, slice=ast.Slice(lower=lower, upper=upper, step=None)):
                result = self.value(items)[slice(*(part and self.value(part) for part in (lower, upper)))]
            case ast.Subscript(value=items, slice=key):
                result = self.value(items)[self.value(key)]
            case ast.Call(func=function, args=arguments, keywords=[]):
                result = self._called(function)(*map(self.value, arguments))
            case ast.Attribute(value=owner, attr=name) if isinstance(self.value(owner), dict):
                result = self.value(owner)[name]
            case _:
                raise ValueError(f"'{ast.unparse(node)}' is not read in xacro files")
        if callable(result) and not any(result is function for function in self.known):
            raise ValueError(f"'{ast.unparse(node)}' is not read in xacro files")
        return result

    def _called(self, function: ast.expr) -> Any:
        if isinstance(function, ast.Attribute):
            owner = self.value(function.value)
            if any(isinstance(owner, kind) and function.attr in methods for kind, methods in METHODS.items()):
                return getattr(owner, function.attr)
        return self.value(function)


def evaluated(text: str, names: Mapping[str, Any], functions: Sequence[Any] = ()) -> Any:
    """Evaluate an expression of a xacro file with the values of ``names``; raises ValueError for any other text."""
    return _Expression(names, (*FUNCTIONS, *functions)).value(ast.parse(text.strip(), mode="eval").body)


@contextmanager
def expanded(path: Path, arguments: Mapping[str, Any], folders: Sequence[str | Path]) -> Iterator[Path]:
    """Write the URDF of a xacro file for the context; its packages are above it, in ``folders`` or known to ROS."""
    with needing(f"reading {path} (a xacro file)", "xacrodoc", "xacro"):
        import xacro
        from xacrodoc import packages

    def find(package: str) -> str:
        try:
            return str(packages.get_path(package))
        except Exception:  # of rospkg or ament
            raise GtauError(
                f"{path}: the package '{package}' is not found; name the folder that holds it (packages: [FOLDER] "
                "beside the robot's 'file'), or set ROS_PACKAGE_PATH or AMENT_PREFIX_PATH."
            ) from None

    def attributes(tag: Any, required: Any, optional: Any, of: Any = xacro.check_attrs) -> Any:
        if tag.tagName == "xacro:arg":
            declared[tag.getAttribute("name")] = None
        return of(tag, required, optional)

    def read(text: str, names: Mapping[str, Any], _: Any = None) -> Any:
        functions = [names["xacro"][name] for name in OF_XACRO]
        return evaluated(text, names, functions + [names[name] for name in ("load_yaml", "abs_filename", "dotify")])

    def read_in_eval(text: str, _: Any, names: Any) -> Any:
        return evaluated(text, names, [names[name] for name in OF_EVAL])

    declared: dict[str, None] = {}
    shares = [f"{prefix}/share" for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if prefix]
    packages.reset()
    packages.look_in([*map(str, folders), *shares])
    packages.walk_up_from(path)
    with ExitStack() as stack, TemporaryDirectory(prefix="gtau-") as folder:
        stack.enter_context(patch.object(xacro, "safe_eval", read))
        stack.enter_context(patch.object(xacro, "check_attrs", attributes))
        stack.enter_context(patch.object(xacro.substitution_args, "_eval_find", find))
        stack.enter_context(patch.object(xacro.substitution_args, "eval", read_in_eval, create=True))
        texts = {name: str(value) for name, value in arguments.items()}
        texts |= {name: str(value).lower() for name, value in arguments.items() if isinstance(value, bool)}
        try:
            document = xacro.process_file(str(path), mappings=texts)
        except Exception as error:
            raise _refusal(path, error) from None
        if unknown := [name for name in arguments if name not in declared]:
            has = f"it has {', '.join(declared)}" if declared else "it declares none"
            raise GtauError(f"{path} declares no argument '{unknown[0]}' (xacro:arg); {has}.")
        urdf = Path(folder) / f"{path.stem.removesuffix('.urdf')}.urdf"
        urdf.write_text(document.toxml(), encoding="utf-8")
        try:
            yield urdf
        except GtauError as error:
            raise GtauError(str(error).replace(str(urdf), str(path))) from None


def _refusal(path: Path, error: Exception) -> GtauError:
    """Say why a file cannot be expanded; xacro wraps what it likes."""
    while isinstance(cause := getattr(error, "exc", None), Exception):
        error = cause
    if isinstance(error, GtauError):
        return error
    reason = short(str(error) or type(error).__name__, 200).rstrip(".")
    return GtauError(f"{path} cannot be expanded ({reason}); correct it, or its arguments (xacro: ...).")
