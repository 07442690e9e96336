"""Evaluate arithmetic in robot and experiment files: ``pi/2``, ``q - a``, ``J3 + J2``; nothing is executed.

Xacro files are expanded to URDF by the package xacrodoc. The package xacro evaluates ``${...}`` by ``eval``, whose
restrictions can be evaded, so :func:`evaluated` replaces it: it reads arithmetic, comparisons, texts, lists, entries of
YAML files, and the functions in ``XACRO_FUNCTIONS``.
"""

from __future__ import annotations

import ast
import math
import operator
import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.polynomial import Polynomial

from gtau.documents.validation import LARGEST, unknown
from gtau.errors import GtauError, needing, short

MAX_LENGTH = 200  # also bounds the depth of the expression
COORDINATE = "q"

_SAME = ("sqrt", "sin", "cos", "tan", "asin", "acos", "atan", "atan2")
FUNCTIONS: Mapping[str, Callable[..., float]] = {name: getattr(math, name) for name in _SAME} | {"deg": math.radians}
OPERATORS: Mapping[type[ast.operator], Callable[[Any, Any], Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
}
RESERVED = frozenset({COORDINATE, "pi", *FUNCTIONS})
"""Names that a constant cannot have."""

AffineInQ = tuple[float, float]
"""``(coefficient, constant)`` of ``coefficient * q + constant``, ``q`` being the joint coordinate."""
ALONE = "the joint coordinate q must stand alone, as in 'q - a'"


def evaluate(text: str, names: Mapping[str, float] | None = None) -> float:
    """Evaluate an expression to a finite number.

    It consists of numbers, ``pi``, constants by their ``names``, ``+ - * / **``, parentheses and ``FUNCTIONS``. Raises
    ValueError, with the correct form, for other texts or a value that is not finite.
    """
    coefficient, constant = linear(text, names)
    if coefficient != 0.0:
        raise ValueError("the joint coordinate q is allowed in theta or r of a joint only")
    return constant


def linear(text: str, names: Mapping[str, float] | None = None) -> AffineInQ:
    """Find coefficient and constant of ``coefficient * q + constant``, such as ``q - a``; see :func:`evaluate`."""
    known = {"pi": math.pi, **(names or {}), COORDINATE: Polynomial([0.0, 1.0])}
    try:
        value = _value(_parsed(text), known)
    except ZeroDivisionError:
        raise ValueError(f"'{text}' divides by zero") from None
    except OverflowError:
        value = math.inf
    factors = [*map(float, value.coef)] if isinstance(value, Polynomial) else [float(value)]
    if any(factors[2:]):
        raise ValueError(ALONE)
    constant, coefficient = [*factors, 0.0][:2]
    if not math.isfinite(coefficient + constant):
        raise ValueError(f"'{text}' has no finite value")
    return coefficient, constant


QUOTED = re.compile("`([^`]+)`")
_OF_COLUMNS = (ast.BinOp, ast.UnaryOp, ast.Name, ast.Constant, ast.expr_context, ast.unaryop, *OPERATORS)


def columns_in(text: str) -> tuple[str, ...]:
    """List the columns in sums and products of columns and numbers; one with another name stands between backticks.

    Raises ValueError for other texts, with the correct form.
    """
    tree = _parsed(text, powers="")
    if not all(isinstance(node, _OF_COLUMNS) for node in ast.walk(tree)):
        raise ValueError(f"in '{text}' only numbers, columns, + - * / and parentheses are read")
    columns = tuple(dict.fromkeys(node.id for node in ast.walk(tree) if isinstance(node, ast.Name)))
    if not columns:
        raise ValueError(f"'{text}' is a number and no column; a column whose name is one stands between backticks")
    combined(text, dict.fromkeys(columns, np.zeros(1)))
    return columns


def combined(text: str, columns: Mapping[str, np.ndarray]) -> np.ndarray:
    """Compute sums and products of ``columns`` (N,) and numbers, nan where they divide by zero."""
    try:
        with np.errstate(all="ignore"):
            values = np.asarray(_value(_parsed(text), columns))
    except (ZeroDivisionError, OverflowError):
        raise ValueError(f"'{text}' divides by zero") from None
    return np.where(np.isfinite(values), values, np.nan)


def _parsed(text: str, powers: str = "; write powers with **") -> ast.expr:
    if not isinstance(text, str):
        raise ValueError("write a single number or expression")
    if len(text) > MAX_LENGTH:
        raise ValueError(f"the expression is longer than {MAX_LENGTH} characters; use constants to shorten it")
    if unusual := re.search(r"[^\w.+\-*/(), \t]", QUOTED.sub("x", text), re.ASCII):
        hint = powers if unusual[0] == "^" else ""
        raise ValueError(f"'{text}' is not a number or expression, because of '{unusual[0]}'{hint}")
    quoted = {f"é{k}": name for k, name in enumerate(QUOTED.findall(text))}  # no name outside quotes has this letter
    names = iter(quoted)
    try:
        tree = ast.parse(QUOTED.sub(lambda _: f" {next(names)} ", text).strip(), mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        raise ValueError(f"'{text}' is not a number or expression; write one such as 0.31 or pi/2") from None
    for node in ast.walk(tree):
        if isinstance(node, ast.Name):
            node.id = quoted.get(node.id, node.id)
    return tree


def _value(node: ast.expr, names: Mapping[str, Any]) -> Any:
    """Evaluate to what ``names`` hold: numbers, a polynomial of the joint coordinate, or arrays."""
    match node:
        case ast.Constant(value=float() | int() as number) if not isinstance(number, bool):
            return float(number)
        case ast.Name(id=name) if name in names:
            return names[name]
        case ast.Name(id=name):
            raise ValueError(unknown(f"name '{name}'", name, {*FUNCTIONS, *names} - {COORDINATE}))
        case ast.UnaryOp(op=ast.USub() | ast.UAdd() as sign, operand=operand):
            value = _value(operand, names)
            return -value if isinstance(sign, ast.USub) else value
        case ast.BinOp(left=left, op=ast.Pow(), right=right):
            power = _number(_value(left, names)) ** _number(_value(right, names))  # of floats: never long
            if isinstance(power, complex):
                raise ValueError("a root of a negative number is not real")
            return power
        case ast.BinOp(left=left, op=sign, right=right):
            if type(sign) not in OPERATORS:
                raise ValueError("only the operators + - * / ** are read here")
            first, second = _value(left, names), _value(right, names)
            return OPERATORS[type(sign)](first, _number(second) if isinstance(sign, ast.Div) else second)
        case ast.Call(func=ast.Name(id=name), args=arguments, keywords=[]) if name in FUNCTIONS:
            values, count = [_number(_value(argument, names)) for argument in arguments], 2 if name == "atan2" else 1
            if len(values) != count:
                raise ValueError(f"{name} takes {count} value{'s' if count > 1 else ''}, not {len(values)}")
            try:
                return FUNCTIONS[name](*values)
            except ValueError:
                shown = ", ".join(f"{value:g}" for value in values)
                raise ValueError(f"{name}({shown}) is not defined") from None
        case ast.Call(func=ast.Name(id=name)):
            raise ValueError(unknown(f"function '{name}'", name, FUNCTIONS))
        case ast.Tuple():
            raise ValueError("the number contains a comma; write decimals with a point, such as 0.31")
        case _:
            raise ValueError(
                "only numbers, constants, + - * / **, parentheses and functions such as sqrt(2) are read here"
            )


def _number(value: Any) -> Any:
    """Return a number or array; refuse the joint coordinate unless it cancels out."""
    if not isinstance(value, Polynomial):
        return value
    if any(value.coef[1:]):
        raise ValueError(ALONE)
    return float(value.coef[0])


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


XACRO_OPERATORS: Mapping[type, Callable[..., Any]] = {
    **OPERATORS,
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
XACRO_FUNCTIONS = (*BUILTINS, *(function for function in vars(math).values() if callable(function)))
FROM_XACRO = ("load_yaml", "abs_filename", "dotify", "arg", "message", "warning", "error", "fatal", "tokenize")
FROM_EVAL = ("arg", "dirname", "env", "optenv", "find")  # in $(eval ...)
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
            case ast.UnaryOp(op=sign, operand=operand) if type(sign) in XACRO_OPERATORS:
                result = XACRO_OPERATORS[type(sign)](self.value(operand))
            case ast.BinOp(left=left, op=sign, right=right) if type(sign) in XACRO_OPERATORS:
                result = XACRO_OPERATORS[type(sign)](self.value(left), self.value(right))
            case ast.BoolOp(op=sign, values=[*first, last]):
                stop, values = isinstance(sign, ast.Or), (self.value(item) for item in first)
                result = next((value for value in values if bool(value) is stop), self)
                result = self.value(last) if result is self else result
            case ast.Compare(left=left, ops=signs, comparators=others):
                terms = [self.value(term) for term in (left, *others)]
                pairs = zip(signs, terms, terms[1:], strict=False)
                result = all(XACRO_OPERATORS[type(sign)](*pair) for sign, *pair in pairs)
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
    return _Expression(names, (*XACRO_FUNCTIONS, *functions)).value(ast.parse(text.strip(), mode="eval").body)


@contextmanager
def expanded(path: Path, arguments: Mapping[str, Any], folders: Sequence[str | Path]) -> Iterator[Path]:
    """Write the URDF of a xacro file for the context; its packages are above it, in ``folders`` or known to ROS."""
    from unittest.mock import patch

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
        functions = [names["xacro"][name] for name in FROM_XACRO]
        return evaluated(text, names, functions + [names[name] for name in ("load_yaml", "abs_filename", "dotify")])

    def read_in_eval(text: str, _: Any, names: Any) -> Any:
        return evaluated(text, names, [names[name] for name in FROM_EVAL])

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
