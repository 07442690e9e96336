"""CasADi functions evaluated for many samples: a small batched interpreter.

A symbolic function is turned into a list of instructions on registers; each instruction is carried
out for a whole lane of samples before the next, so the interpreter's own cost is shared by the lane
and the registers stay in the cache. One compiled loop (Numba, cached on disk) serves all robots.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from idim.model._interpreter import OPERATIONS, interpret

_BY_CASADI_ID = {getattr(ca, f"OP_{name}"): code for code, name in enumerate(OPERATIONS)}


@dataclass(frozen=True)
class Program:
    """Instructions of a function from a vector to a vector.

    ``code`` is (instructions, 4): operation, output, first and second argument, which are register
    numbers, or the number of an input, output or constant.
    """

    code: np.ndarray
    constants: np.ndarray
    registers: int
    inputs: int
    outputs: int

    def __call__(self, inputs: np.ndarray) -> np.ndarray:
        """Evaluate for samples along the last axis: (inputs, N) to (outputs, N)."""
        inputs = np.ascontiguousarray(inputs, dtype=float)
        if inputs.ndim != 2 or inputs.shape[0] != self.inputs:
            raise ValueError(f"expected inputs of shape ({self.inputs}, N), got {inputs.shape}")
        outputs = np.empty((self.outputs, inputs.shape[1]))
        interpret(self.code, self.constants, self.registers, inputs, outputs)
        return outputs


def compile_program(inputs: list[ca.SX], outputs: list[ca.SX]) -> Program:
    """Instructions that compute the stacked dense ``outputs`` from the stacked ``inputs``.

    Parameters
    ----------
    inputs : list of SX
        Symbols, stacked column by column into one input vector.
    outputs : list of SX
        Expressions; their entries, structural zeros included, are stacked column by column.
    """
    x = ca.veccat(*inputs)
    y = ca.densify(ca.veccat(*outputs))
    function = ca.Function("program", [x], [y])
    code = np.zeros((function.n_instructions(), 4), dtype=np.int32)
    constants: list[float] = []
    for k in range(function.n_instructions()):
        identity = function.instruction_id(k)
        try:
            operation = _BY_CASADI_ID[identity]
        except KeyError:
            raise NotImplementedError(f"the interpreter lacks CasADi's operation {identity}") from None
        arguments, results = function.instruction_input(k), function.instruction_output(k)
        if identity == ca.OP_CONST:
            code[k] = operation, results[0], len(constants), 0
            constants.append(function.instruction_constant(k))
        elif identity == ca.OP_INPUT:
            code[k] = operation, results[0], arguments[1], 0
        elif identity == ca.OP_OUTPUT:
            code[k] = operation, results[1], arguments[0], 0
        else:
            code[k] = operation, results[0], arguments[0], arguments[-1]
    return Program(code, np.array(constants), function.sz_w(), x.numel(), y.numel())
