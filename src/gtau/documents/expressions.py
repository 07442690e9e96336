"""Evaluate arithmetic in robot and experiment files: ``pi/2``, ``q - a``, ``J3 + J2``; nothing is executed."""

from __future__ import annotations

import ast
import math
import operator
import re
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.polynomial import Polynomial

from gtau.documents.validation import unknown

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
