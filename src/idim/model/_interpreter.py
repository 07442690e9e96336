"""The compiled loop behind :mod:`idim.model.program`."""

import numpy as np
from numba import njit

OPERATIONS = (
    *("CONST", "INPUT", "OUTPUT", "ADD", "SUB", "MUL", "DIV", "NEG", "SQ", "TWICE"),
    *("SIN", "COS", "SQRT", "SIGN", "FABS", "INV", "ASSIGN"),
)
"""CasADi's operations that the interpreter knows; the place in this tuple is the code."""

LANES = 64


@njit(cache=True, fastmath={"contract", "nsz", "arcp"}, error_model="numpy")
def interpret(code, constants, registers, inputs, outputs):  # type: ignore[no-untyped-def]  # pragma: no cover - compiled
    """Run ``code`` over all columns of ``inputs`` (inputs, N), filling ``outputs`` (outputs, N)."""
    # a row a little longer than the lanes: strides that are powers of two thrash the cache
    w = np.zeros((max(registers, 1), LANES + 8))
    samples = inputs.shape[1]
    for start in range(0, samples, LANES):
        lanes = min(LANES, samples - start)
        for k in range(code.shape[0]):
            op, out, i, j = code[k, 0], code[k, 1], code[k, 2], code[k, 3]
            if op == 2:
                for n in range(lanes):
                    outputs[out, start + n] = w[i, n]
                continue
            y = w[out]
            if op == 5:
                a, b = w[i], w[j]
                for n in range(LANES):
                    y[n] = a[n] * b[n]
            elif op == 3:
                a, b = w[i], w[j]
                for n in range(LANES):
                    y[n] = a[n] + b[n]
            elif op == 4:
                a, b = w[i], w[j]
                for n in range(LANES):
                    y[n] = a[n] - b[n]
            elif op == 1:
                for n in range(lanes):
                    y[n] = inputs[i, start + n]
            elif op == 0:
                y[:] = constants[i]
            elif op == 7:
                a = w[i]
                for n in range(LANES):
                    y[n] = -a[n]
            elif op == 8:
                a = w[i]
                for n in range(LANES):
                    y[n] = a[n] * a[n]
            elif op == 9:
                a = w[i]
                for n in range(LANES):
                    y[n] = a[n] + a[n]
            elif op == 10:
                a = w[i]
                for n in range(LANES):
                    y[n] = np.sin(a[n])
            elif op == 11:
                a = w[i]
                for n in range(LANES):
                    y[n] = np.cos(a[n])
            elif op == 6:
                a, b = w[i], w[j]
                for n in range(LANES):
                    y[n] = a[n] / b[n]
            elif op == 12:
                a = w[i]
                for n in range(LANES):
                    y[n] = np.sqrt(a[n])
            elif op == 13:
                a = w[i]
                for n in range(LANES):
                    y[n] = np.sign(a[n])
            elif op == 14:
                a = w[i]
                for n in range(LANES):
                    y[n] = np.abs(a[n])
            elif op == 15:
                a = w[i]
                for n in range(LANES):
                    y[n] = 1.0 / a[n]
            else:
                a = w[i]
                for n in range(LANES):
                    y[n] = a[n]
