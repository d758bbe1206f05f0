"""CasADi functions as plain C99: one local constant an instruction, no heap, libm alone.

CasADi's own generator writes the same instructions into a work array that its callers provide.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import casadi as ca

from ident.errors import IdentError

BINARY = {
    ca.OP_ADD: "{} + {}", ca.OP_SUB: "{} - {}", ca.OP_MUL: "{} * {}", ca.OP_DIV: "{} / {}",
    ca.OP_POW: "POW({}, {})", ca.OP_CONSTPOW: "POW({}, {})", ca.OP_FMIN: "FMIN({}, {})",
    ca.OP_FMAX: "FMAX({}, {})", ca.OP_ATAN2: "ATAN2({}, {})", ca.OP_LT: "(REAL)({} < {})",
    ca.OP_LE: "(REAL)({} <= {})", ca.OP_IF_ELSE_ZERO: "(({}) > ZERO || ({}) < ZERO) ? {} : ZERO",
    ca.OP_HYPOT: "HYPOT({}, {})",
}  # fmt: skip
UNARY = {
    ca.OP_ASSIGN: "{}", ca.OP_NEG: "-{}", ca.OP_EXP: "EXP({})", ca.OP_LOG: "LOG({})",
    ca.OP_SQRT: "SQRT({})", ca.OP_SQ: "{0} * {0}", ca.OP_TWICE: "TWO * {}", ca.OP_SIN: "SIN({})",
    ca.OP_COS: "COS({})", ca.OP_TAN: "TAN({})", ca.OP_ASIN: "ASIN({})", ca.OP_ACOS: "ACOS({})",
    ca.OP_ATAN: "ATAN({})", ca.OP_TANH: "TANH({})", ca.OP_FABS: "FABS({})",
    ca.OP_INV: "ONE / {}", ca.OP_SIGN: "(REAL)(({0} > ZERO) - ({0} < ZERO))",
}  # fmt: skip


def constant(x: float, real: str) -> str:
    """Return a number as C has it, with all of its digits."""
    text = repr(float(x)) if real == "double" else f"{x:.9g}"
    if "." not in text and "e" not in text and "n" not in text:
        text += ".0"
    return text + ("F" if real == "float" else "")


def body(f: ca.Function, inputs: Sequence[str], outputs: Sequence[str], real: str) -> str:
    """Return the statements of a function of dense inputs and outputs, arrays of these names.

    Raises:
        IdentError: for an operation that has no C here.
    """
    names: dict[int, str] = {}
    lines: list[str] = []
    written = 0
    for k in range(f.n_instructions()):
        operation, out, args = f.instruction_id(k), f.instruction_output(k), f.instruction_input(k)
        if operation == ca.OP_OUTPUT:
            lines.append(f"    {outputs[out[0]]}[{out[1]}] = {names[args[0]]};")
            continue
        if operation == ca.OP_CONST:
            names[out[0]] = constant(f.instruction_constant(k), real)
            if names[out[0]].startswith("-"):
                names[out[0]] = f"({names[out[0]]})"
            continue
        if operation == ca.OP_INPUT:
            names[out[0]] = f"{inputs[args[0]]}[{args[1]}]"
            continue
        given = [names[i] for i in args]
        if operation == ca.OP_IF_ELSE_ZERO:
            text = BINARY[operation].format(given[0], given[0], given[1])
        elif operation in UNARY:
            text = UNARY[operation].format(given[0])
        elif operation in BINARY:
            text = BINARY[operation].format(*given)
        else:
            raise IdentError(f"CasADi's operation {operation} has no C here")
        for word in FUNCTIONS:
            text = text.replace(f"{word.upper()}(", f"{word}{'f' if real == 'float' else ''}(")
        text = text.replace("REAL", real)
        for word, x in (("ZERO", 0.0), ("ONE", 1.0), ("TWO", 2.0)):
            text = text.replace(word, constant(x, real))
        names[out[0]] = f"w{written}"
        written += 1
        lines.append(f"    const {real} {names[out[0]]} = {text};")
    return "\n".join(lines)


FUNCTIONS = (
    "atan2", "fmin", "fmax", "hypot", "sqrt", "fabs", "tanh", "asin", "acos", "atan", "sin", "cos",
    "tan", "exp", "log", "pow",
)  # fmt: skip


def used(f: ca.Function) -> list[bool]:
    """Return which inputs a function depends on."""
    inputs = {
        f.instruction_input(k)[0]
        for k in range(f.n_instructions())
        if f.instruction_id(k) == ca.OP_INPUT
    }
    return [i in inputs for i in range(f.n_in())]


Statement = Callable[[str], str]
