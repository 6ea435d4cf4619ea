"""Analytic expressions in one variable, evaluated without running what they say as code."""

import ast
import operator
from collections.abc import Callable
from typing import cast

import numpy as np

from wrod.arguments import shown
from wrod.errors import PatternError

_OPERATORS: dict[type[ast.AST], Callable] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: operator.pow,
    ast.UAdd: operator.pos,
    ast.USub: operator.neg,
}
_FUNCTIONS = {
    name: getattr(np, name)
    for name in ("sin", "cos", "tan", "sinh", "cosh", "tanh", "exp", "log", "sqrt", "abs")
} | {"asin": np.arcsin, "acos": np.arccos, "atan": np.arctan}
_CONSTANTS = {"pi": np.pi, "e": np.e}


def compile_expression(text: str, variable: str) -> Callable[[np.ndarray], np.ndarray]:
    """Function of one variable from an arithmetic expression such as `0.05*sin(2*pi*x/0.2)`.

    Only numbers, the variable, `pi`, `e`, + - * / ** (or ^) and the elementary functions are
    understood; anything else is refused before it is evaluated.

    Raises:
        PatternError: the text is not such an expression.
    """
    try:
        tree = ast.parse(text.replace("^", "**").strip(), mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        raise PatternError(f"expression {shown(text)} cannot be read: {error}") from None

    def refuse(node: ast.AST) -> PatternError:
        part = ast.unparse(node)
        return PatternError(
            f"expression {shown(text)}: {shown(part)} is not understood; use numbers, {variable}, "
            f"pi, e, + - * / ** and {', '.join(sorted(_FUNCTIONS))}"
        )

    def build(node: ast.AST):
        if isinstance(node, ast.Constant) and type(node.value) in (int, float):
            value = float(cast(float, node.value))
            return lambda t: value
        if isinstance(node, ast.Name):
            if node.id == variable:
                return lambda t: t
            if node.id in _CONSTANTS:
                return lambda t: _CONSTANTS[node.id]
        if isinstance(node, ast.BinOp) and type(node.op) in _OPERATORS:
            apply, left, right = _OPERATORS[type(node.op)], build(node.left), build(node.right)
            return lambda t: apply(left(t), right(t))
        if isinstance(node, ast.UnaryOp) and type(node.op) in _OPERATORS:
            negate, operand = _OPERATORS[type(node.op)], build(node.operand)
            return lambda t: negate(operand(t))
        if (
            isinstance(node, ast.Call)
            and isinstance(node.func, ast.Name)
            and node.func.id in _FUNCTIONS
            and len(node.args) == 1
            and not node.keywords
        ):
            function, argument = _FUNCTIONS[node.func.id], build(node.args[0])
            return lambda t: function(argument(t))
        raise refuse(node)

    value = build(tree)

    def evaluate(t: np.ndarray) -> np.ndarray:
        t = np.asarray(t, dtype=float)
        try:
            with np.errstate(all="ignore"):
                result = value(t) + np.zeros_like(t)
        except (OverflowError, ZeroDivisionError, ValueError, TypeError) as error:
            raise PatternError(f"expression {shown(text)} cannot be evaluated: {error}") from None
        if np.iscomplexobj(result) or not np.all(np.isfinite(result)):
            bad = t[~np.isfinite(result)] if not np.iscomplexobj(result) else t
            raise PatternError(
                f"expression {shown(text)} has no finite value at {variable} = {bad[0]:g}; "
                "choose another range"
            )
        return result

    return evaluate


def value_of(function: Callable[[np.ndarray], np.ndarray], t: np.ndarray, name: str):
    """What a function that somebody gave says of an array."""
    try:
        return function(t.copy())
    except PatternError:
        raise
    except Exception as error:
        said = f"{type(error).__name__}: {error}"
        raise PatternError(f"{name}: its function stops with {said:.300}") from error
