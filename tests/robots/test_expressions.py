"""Arithmetic in robot files: what it computes, and what it refuses."""

from __future__ import annotations

import contextlib
import math
from typing import Any

import pytest
from hypothesis import given, settings, strategies as st

from gtau.documents import expressions
from gtau.documents.expressions import MAX_LENGTH, evaluate, linear

CONSTANTS = {"a": 0.34, "d4": 0.31, "l_1": 2.0}


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("0.31", 0.31),
        ("-1e-3", -1e-3),
        ("+.5", 0.5),
        (" pi/2 ", math.pi / 2),
        ("-(a + d4)/2", -(0.34 + 0.31) / 2),
        ("2**3**2", 512.0),
        ("-2**2", -4.0),
        ("l_1**-1", 0.5),
        ("deg(90)", math.pi / 2),
        ("sqrt(2)*sin(pi/4)", 1.0),
        ("acos(0) + asin(1) - 2*atan(1)", math.pi / 2),
        ("atan2(-1, -1)", math.atan2(-1, -1)),
        ("cos(0) - tan(0)", 1.0),
    ],
)
def test_value(text: str, value: float) -> None:
    assert evaluate(text, CONSTANTS) == pytest.approx(value, rel=1e-15)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("q", (1.0, 0.0)),
        ("q - a", (1.0, -0.34)),
        ("a - q", (-1.0, 0.34)),
        ("2*(q + 1)/4", (0.5, 0.5)),
        ("q - q + 1", (0.0, 1.0)),
    ],
)
def test_linear_in_the_joint_coordinate(text: str, expected: tuple[float, float]) -> None:
    assert linear(text, CONSTANTS) == pytest.approx(expected)


@settings(deadline=None)  # on a machine that others use
@given(st.floats(allow_nan=False, allow_infinity=False))
def test_every_float_is_read_as_written(number: float) -> None:
    assert evaluate(repr(number)) == number


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("d5", "unknown name 'd5'; did you mean 'd4'?"),
        ("zz", "unknown name 'zz'; choose from a, acos,"),
        ("exp(1)", "unknown function 'exp'; choose from acos, asin"),
        ("sqr(2)", "unknown function 'sqr'; did you mean 'sqrt'?"),
        ("0,31", "write decimals with a point"),
        ("2^3", "because of '^'; write powers with **"),
        ("1 2", "'1 2' is not a number or expression"),
        ("", "'' is not a number or expression"),
        ("7 // 2", "only the operators + - * / ** are read"),
        ("1/0", "'1/0' divides by zero"),
        ("0**-1", "divides by zero"),
        ("9**9**9", "has no finite value"),
        ("1e999", "has no finite value"),
        ("1e308*10", "has no finite value"),
        ("nan", "unknown name 'nan'"),
        ("(-8)**(1/3)", "a root of a negative number is not real"),
        ("sqrt(-1)", "sqrt(-1) is not defined"),
        ("acos(1.5)", "acos(1.5) is not defined"),
        ("atan2(1)", "atan2 takes 2 values, not 1"),
        ("q*q", "q must stand alone"),
        ("1/q", "q must stand alone"),
        ("sin(q)", "q must stand alone"),
        ("1j", "only numbers, constants"),
        ("True", "only numbers, constants"),
        ("(1).real", "only numbers, constants"),
        ("1 if a else 2", "only numbers, constants"),
        ("__import__('os')", "because of '''"),
        ("a.__class__", "only numbers, constants"),
        ("sqrt(*a)", "only numbers, constants"),
        ("[1]", "because of '['"),
        ("1 +\n1", "because of"),
        ("π", "because of 'π'"),
        ("1+" * MAX_LENGTH + "1", f"longer than {MAX_LENGTH} characters"),
    ],
)
def test_refusals(text: str, sentence: str) -> None:
    with pytest.raises(ValueError) as refused:  # noqa: PT011
        linear(text, CONSTANTS)
    assert sentence in str(refused.value)


def test_coordinate_only_where_a_joint_moves() -> None:
    with pytest.raises(ValueError, match="q is allowed in theta or r of a joint only"):
        evaluate("q")


@pytest.mark.parametrize("text", ["(" * 99 + "1" + ")" * 99, "-" * 199 + "1", "+".join("1" * 100), "2**" * 66 + "2"])
def test_the_longest_expressions_take_a_step_a_character_at_most(text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each of numbers of a fixed size: powers of whole numbers would fill the memory."""
    step, steps = expressions._value, []

    def counted(*arguments: Any) -> float:
        steps.append(step(*arguments))
        assert type(steps[-1]) is float
        return steps[-1]

    monkeypatch.setattr(expressions, "_value", counted)
    with contextlib.suppress(ValueError):
        evaluate(text)
    assert 1 <= len(steps) <= MAX_LENGTH
