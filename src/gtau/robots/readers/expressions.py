"""Evaluate arithmetic in the numbers of a robot file, such as ``pi/2`` or ``q - a``; nothing is executed."""

from __future__ import annotations

import ast
import math
import re
from collections.abc import Callable, Mapping

from gtau.documents.validation import unknown

MAX_LENGTH = 200  # also bounds the depth of the expression
COORDINATE = "q"

_SAME = ("sqrt", "sin", "cos", "tan", "asin", "acos", "atan", "atan2")
FUNCTIONS: Mapping[str, Callable[..., float]] = {name: getattr(math, name) for name in _SAME} | {"deg": math.radians}
RESERVED = frozenset({COORDINATE, "pi", *FUNCTIONS})
"""Names that a constant cannot have."""

AffineInQ = tuple[float, float]
"""``(coefficient, constant)`` of ``coefficient * q + constant``, ``q`` being the joint coordinate."""


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
    if not isinstance(text, str):
        raise ValueError("write a single number or expression")
    if len(text) > MAX_LENGTH:
        raise ValueError(f"the expression is longer than {MAX_LENGTH} characters; use constants to shorten it")
    if unusual := re.search(r"[^\w.+\-*/(), \t]", text, re.ASCII):
        hint = "; write powers with **" if unusual[0] == "^" else ""
        raise ValueError(f"'{text}' is not a number or expression, because of '{unusual[0]}'{hint}")
    try:
        tree = ast.parse(text.strip(), mode="eval")
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        raise ValueError(f"'{text}' is not a number or expression; write one such as 0.31 or pi/2") from None
    try:
        result = _value(tree.body, {"pi": math.pi, **(names or {})})
    except ZeroDivisionError:
        raise ValueError(f"'{text}' divides by zero") from None
    except OverflowError:
        result = (0.0, math.inf)
    if not all(map(math.isfinite, result)):
        raise ValueError(f"'{text}' has no finite value")
    return result


def _value(node: ast.expr, names: Mapping[str, float]) -> AffineInQ:
    match node:
        case ast.Constant(value=float() | int() as number) if not isinstance(number, bool):
            return 0.0, float(number)
        case ast.Name(id=name) if name == COORDINATE:
            return 1.0, 0.0
        case ast.Name(id=name) if name in names:
            return 0.0, names[name]
        case ast.Name(id=name):
            raise ValueError(unknown(f"name '{name}'", name, {*FUNCTIONS, *names}))
        case ast.UnaryOp(op=ast.USub() | ast.UAdd() as sign, operand=operand):
            coefficient, constant = _value(operand, names)
            return (-coefficient, -constant) if isinstance(sign, ast.USub) else (coefficient, constant)
        case ast.BinOp(left=left, op=operator, right=right):
            return _operation(operator, _value(left, names), _value(right, names))
        case ast.Call(func=ast.Name(id=name), args=arguments, keywords=[]) if name in FUNCTIONS:
            return 0.0, _call(name, [_value(argument, names) for argument in arguments])
        case ast.Call(func=ast.Name(id=name)):
            raise ValueError(unknown(f"function '{name}'", name, FUNCTIONS))
        case ast.Tuple():
            raise ValueError("the number contains a comma; write decimals with a point, such as 0.31")
        case _:
            raise ValueError(
                "only numbers, constants, + - * / **, parentheses and functions such as sqrt(2) are read here"
            )


def _operation(operator: ast.operator, first: AffineInQ, right: AffineInQ) -> AffineInQ:
    (p, a), (q, b) = first, right
    match operator:
        case ast.Add():
            return p + q, a + b
        case ast.Sub():
            return p - q, a - b
        case ast.Mult() if p == 0.0 or q == 0.0:
            return p * b + a * q, a * b
        case ast.Div() if q == 0.0:
            return p / b, a / b
        case ast.Pow() if p == 0.0 and q == 0.0:
            power = a**b  # of floats: never a long computation
            if isinstance(power, complex):
                raise ValueError("a root of a negative number is not real")
            return 0.0, power
        case ast.Mult() | ast.Div() | ast.Pow():
            raise ValueError("the joint coordinate q must stand alone, as in 'q - a'")
        case _:
            raise ValueError("only the operators + - * / ** are read here")


def _call(name: str, arguments: list[AffineInQ]) -> float:
    count = 2 if name == "atan2" else 1
    if len(arguments) != count:
        raise ValueError(f"{name} takes {count} value{'s' if count > 1 else ''}, not {len(arguments)}")
    if any(coefficient != 0.0 for coefficient, _ in arguments):
        raise ValueError("the joint coordinate q must stand alone, as in 'q - a'")
    values = [constant for _, constant in arguments]
    try:
        return FUNCTIONS[name](*values)
    except ValueError:
        raise ValueError(f"{name}({', '.join(f'{value:g}' for value in values)}) is not defined") from None
