"""Translate CasADi functions to instructions of the interpreter: fused, and with few registers."""

from __future__ import annotations

from collections.abc import Collection

import casadi as ca
import numpy as np

LANES = 64
WIDE = 8  # doubles in a cache line
ROW = LANES + 8  # doubles from a row to the next: strides that are powers of two thrash the cache
TILE = 8  # samples of a path that are put into the results together: a cache line of each row

OPERATIONS = (
    *("MUL", "ADD", "SUB", "MULTIPLY_ADD", "MULTIPLY_SUBTRACT", "SUBTRACT_PRODUCT"),
    *("MUL last", "ADD last", "SUB last", "SUB from last", "MULTIPLY_ADD last", "MULTIPLY_SUBTRACT last"),
    *("SUBTRACT_PRODUCT last", "MULTIPLY_ADD by last", "MULTIPLY_SUBTRACT by last", "SUBTRACT_PRODUCT by last"),
    *("NEG", "DIV", "SQRT", "ASSIGN", "SIGN", "FABS", "FMAX", "SINE_COSINE"),
)
"""Operations of the interpreter; the index in this tuple is the operation code."""

NOWHERE = 2**32 - 1
"""Row of a result that only the next instruction needs."""

_ADDRESSES = (
    *("machine", "step", "step_count", "step_rows", "fast_step", "fast_step_count", "fast_step_rows"),
    *("gap", "gap_count", "gap_rows", "trial", "made", "scale", "actuated", "n_c", "n"),
    *("now", "guess", "past", "tile", "target", "begin"),
)
FOLLOWER = np.dtype(
    [(name, np.int64) for name in _ADDRESSES]
    + [(name, np.float64) for name in ("shortest", "residual", "contraction", "reach")]
)
"""What the loops are followed with: addresses, sizes, and the parameters of the continuation.

The programs read ``trial`` (n_c, ROW) and write ``made``: n_c rows, then size, condition and gap. ``actuated`` (n,) are
rows of the configuration, and ``scale`` (n_c,) is what its entries are multiplied by to become rad or lengths over the
characteristic length, zero for the actuated. The compiled loops work with ``now`` and ``guess`` (n_c, LANES), ``past``
(2, n_c, LANES), ``tile`` (n_c, LANES, TILE), ``target`` and ``begin`` (n, LANES).
"""


CODE = {name: code for code, name in enumerate(OPERATIONS)}
_SAME = {getattr(ca, f"OP_{name}"): name for name in OPERATIONS if hasattr(ca, f"OP_{name}")}
_SINE_OR_COSINE = (ca.OP_SIN, ca.OP_COS)
# a product used once is made together with the sum it goes into: by sum and place of the product in it
_FUSED = {("ADD", 0): "MULTIPLY_ADD", ("ADD", 1): "MULTIPLY_ADD", ("SUB", 0): "MULTIPLY_SUBTRACT",
          ("SUB", 1): "SUBTRACT_PRODUCT"}  # fmt: skip

# the form of an operation whose operand in a place is the result before
_LAST = {("MUL", 0): "MUL last", ("MUL", 1): "MUL last", ("ADD", 0): "ADD last", ("ADD", 1): "ADD last",
         ("SUB", 0): "SUB from last", ("SUB", 1): "SUB last"}  # fmt: skip
for _name in ("MULTIPLY_ADD", "MULTIPLY_SUBTRACT", "SUBTRACT_PRODUCT"):
    _LAST |= {(_name, 0): f"{_name} by last", (_name, 1): f"{_name} by last", (_name, 2): f"{_name} last"}


class Instruction:
    """An operation on values, which are numbered: the inputs, then the results of the instructions."""

    __slots__ = ("operands", "operation", "results")

    def __init__(self, operation: str, results: list[int], operands: list[int]):
        self.operation, self.results, self.operands = operation, results, operands


def instructions(
    function: ca.Function, parameters: int
) -> tuple[np.ndarray, np.ndarray, int, tuple[np.ndarray, np.ndarray]]:
    """Return ``code``, ``constants``, ``registers`` and ``fixed`` of :class:`gtau.model.interpreter.program.Program`.

    The last ``parameters`` entries of the function's input are the same for all samples.
    """
    inputs = function.numel_in() - parameters
    listing, constants, outputs = _read(function)
    listing = _fused(_multiplied(listing, constants), outputs)
    fixed = [k for k, value in enumerate(outputs) if value in constants]
    used = {value for instruction in listing for value in instruction.operands} & constants.keys()
    place = {value: k for k, value in enumerate(sorted(used))}
    made = {value for instruction in listing for value in instruction.results}
    # A value that is an output is in the output's row from the first; other outputs are copies.
    home: dict[int, int] = {}
    for k, value in enumerate(outputs):
        if value in made and value not in home:
            home[value] = k
        elif value not in constants:
            listing.append(Instruction("ASSIGN", [_copy(k)], [value]))
            home[_copy(k)] = k
    unstored = _chained(listing, home.keys())
    registers, stands = _allocated(listing, made - home.keys() - unstored)
    row = place | {inputs + k: len(place) + k for k in range(parameters)}
    first = len(place) + parameters
    row |= {value: first + register for value, register in stands.items()}
    row |= {value: first + registers + value for value in range(inputs)}
    row |= {value: first + registers + inputs + k for value, k in home.items()}
    code = np.zeros((len(listing), 5), dtype=np.uint32)
    for line, instruction in zip(code, listing, strict=True):
        # the second result of SINE_COSINE takes the place of a second operand
        rows = [
            row.get(value, NOWHERE)
            for value in (instruction.results[0], *instruction.operands, *instruction.results[1:])
        ]
        line[: len(rows) + 1] = CODE[instruction.operation], *rows
    values = np.array([constants[value] for value in sorted(used)])
    constant_outputs = np.array(fixed, dtype=int), np.array([constants[outputs[k]] for k in fixed])
    return code, values, registers, constant_outputs


def _copy(output: int) -> int:
    """Return the number of the value that is the copy for an output."""
    return -1 - output


def _read(function: ca.Function) -> tuple[list[Instruction], dict[int, float], list[int]]:
    """Read a function: instructions in single-assignment form, constants, and the values that are outputs."""
    listing: list[Instruction] = []
    constants: dict[int, float] = {}
    number: dict[float, int] = {}
    outputs = [0] * function.numel_out()
    held: dict[int, int] = {}  # value in each of CasADi's registers
    turned: dict[int, Instruction] = {}  # sines and cosines by angle
    fresh = iter(range(function.numel_in(), 2**31))

    def constant(x: float) -> int:
        if x not in number:
            number[x] = next(fresh)
            constants[number[x]] = x
        return number[x]

    for k in range(function.n_instructions()):
        identity = function.instruction_id(k)
        arguments, results = function.instruction_input(k), function.instruction_output(k)
        if identity == ca.OP_CONST:
            held[results[0]] = constant(function.instruction_constant(k))
        elif identity == ca.OP_INPUT:
            held[results[0]] = arguments[1]
        elif identity == ca.OP_OUTPUT:
            outputs[results[1]] = held[arguments[0]]
        elif identity in _SINE_OR_COSINE:
            angle = held[arguments[0]]
            if angle not in turned:
                turned[angle] = Instruction("SINE_COSINE", [next(fresh), next(fresh)], [angle])
                listing.append(turned[angle])
            held[results[0]] = turned[angle].results[_SINE_OR_COSINE.index(identity)]
        else:
            operands = [held[argument] for argument in arguments]
            if identity == ca.OP_SQ:
                operation, operands = "MUL", operands * 2
            elif identity == ca.OP_TWICE:
                operation, operands = "ADD", operands * 2
            elif identity == ca.OP_INV:
                operation, operands = "DIV", [constant(1.0), *operands]
            elif identity in _SAME:
                operation = _SAME[identity]
            else:
                raise ValueError(
                    f"an expression has CasADi's operation {identity}, which the interpreter does not support"
                )
            held[results[0]] = next(fresh)
            listing.append(Instruction(operation, [held[results[0]]], operands))
    return listing, constants, outputs


def _multiplied(listing: list[Instruction], constants: dict[int, float]) -> list[Instruction]:
    """Replace division by constants, and by values that divide more than once, by far cheaper multiplication."""
    divides: dict[int, int] = {}
    for instruction in listing:
        if instruction.operation == "DIV":
            divides[instruction.operands[1]] = divides.get(instruction.operands[1], 0) + 1
    named = [*constants, *(value for instruction in listing for value in instruction.results)]
    fresh = iter(range(1 + max(named, default=0), 2**31))
    reciprocal: dict[int, int] = {}
    one = next((value for value, x in constants.items() if x == 1.0), None)
    multiplied = []
    for instruction in listing:
        if instruction.operation == "DIV":
            by = instruction.operands[1]
            if by in constants and by not in reciprocal:
                reciprocal[by] = next(fresh)
                constants[reciprocal[by]] = 1.0 / constants[by]
            elif divides[by] > 1 and by not in reciprocal:
                if one is None:
                    one = next(fresh)
                    constants[one] = 1.0
                reciprocal[by] = next(fresh)
                multiplied.append(Instruction("DIV", [reciprocal[by]], [one, by]))
            if by in reciprocal:
                instruction = Instruction("MUL", instruction.results, [instruction.operands[0], reciprocal[by]])
        multiplied.append(instruction)
    return multiplied


def _fused(listing: list[Instruction], outputs: list[int]) -> list[Instruction]:
    """Fuse products and negations used only once, in a sum, with that sum."""
    uses: dict[int, int] = {}
    for value in outputs + [operand for instruction in listing for operand in instruction.operands]:
        uses[value] = uses.get(value, 0) + 1
    maker = {value: instruction for instruction in listing for value in instruction.results}
    gone: set[int] = set()

    def once(value: int, operation: str) -> Instruction | None:
        made = maker.get(value)
        return made if made and made.operation == operation and uses[value] == 1 else None

    for instruction in listing:
        if instruction.operation not in ("ADD", "SUB"):
            continue
        for place in (1, 0):
            negated = once(instruction.operands[place], "NEG")
            if negated and (instruction.operation == "ADD" or place == 1):
                # x + (-y) = x - y,  (-x) + y = y - x,  x - (-y) = x + y
                instruction.operands = [instruction.operands[1 - place], negated.operands[0]]
                instruction.operation = "SUB" if instruction.operation == "ADD" else "ADD"
                gone.add(negated.results[0])
        for place in (1, 0):
            product = once(instruction.operands[place], "MUL")
            if product:
                gone.add(product.results[0])
                instruction.operation = _FUSED[instruction.operation, place]
                instruction.operands = [*product.operands, instruction.operands[1 - place]]
                break
    return [instruction for instruction in listing if instruction.results[0] not in gone]


def _chained(listing: list[Instruction], kept: Collection[int]) -> set[int]:
    """Let instructions take the previous result from the processor's registers; return values that then need no row.

    The values ``kept`` need one in any case.
    """
    made: set[int] = set()
    read = set(kept)
    before: int | None = None
    for instruction in listing:
        places = [place for place, value in enumerate(instruction.operands) if value == before]
        if len(places) == 1 and (instruction.operation, places[0]) in _LAST:
            instruction.operation = _LAST[instruction.operation, places[0]]
            del instruction.operands[places[0]]
        read.update(instruction.operands)
        before = None
        if instruction.operation != "SINE_COSINE":
            before = instruction.results[0]
            made.add(before)
    return made - read


def _allocated(listing: list[Instruction], values: set[int]) -> tuple[int, dict[int, int]]:
    """Allocate registers: their number, and the register of each of ``values``, the one that became free last."""
    last: dict[int, int] = {}
    for k, instruction in enumerate(listing):
        last.update(dict.fromkeys(instruction.operands + instruction.results, k))
    free: list[int] = []
    stands: dict[int, int] = {}
    registers = 0
    for k, instruction in enumerate(listing):
        ended = [value for value in dict.fromkeys(instruction.operands) if last[value] == k and value in values]
        if instruction.operation != "SINE_COSINE":  # which must not write where it reads
            free += [stands[value] for value in ended]
        for value in instruction.results:
            if value in values:
                if not free:
                    free.append(registers)
                    registers += 1
                stands[value] = free.pop()
        if instruction.operation == "SINE_COSINE":
            free += [stands[value] for value in ended]
        free += [stands[value] for value in instruction.results if last[value] == k and value in values]
    return registers, stands
