"""Functions with finite derivatives where the argument of a root or norm is zero, as at rest."""

from __future__ import annotations

import casadi as ca

SMALLEST = 1e-20  # smallest argument of a root


def with_finite_slopes(function: ca.Function) -> ca.Function:
    """Return the function with ``sqrt(x)`` replaced by ``sqrt(max(x, 1e-20))``.

    The derivative of a root is infinite at zero, that of a norm 0/0: at rest the tool speed has no
    derivative. With the maximum the derivative is zero there, and the value has an error of 1e-10.
    """
    kinds = [function.instruction_id(k) for k in range(function.n_instructions())]
    if ca.OP_SQRT not in kinds:
        return function
    inputs = [
        ca.SX.sym(function.name_in(i), function.sparsity_in(i)) for i in range(function.n_in())
    ]
    outputs = [[ca.SX(0)] * function.nnz_out(i) for i in range(function.n_out())]
    work = [ca.SX(0)] * function.sz_w()
    for k, kind in enumerate(kinds):
        out, given = function.instruction_output(k), function.instruction_input(k)
        if kind == ca.OP_CONST:
            work[out[0]] = ca.SX(function.instruction_constant(k))
        elif kind == ca.OP_INPUT:
            work[out[0]] = inputs[given[0]].nz[given[1]]
        elif kind == ca.OP_OUTPUT:
            outputs[out[0]][out[1]] = work[given[0]]
        elif kind == ca.OP_SQRT:
            work[out[0]] = ca.sqrt(ca.fmax(work[given[0]], SMALLEST))
        elif len(given) == 2:
            work[out[0]] = ca.SX.binary(kind, work[given[0]], work[given[1]])
        else:
            work[out[0]] = ca.SX.unary(kind, work[given[0]])
    results = [
        ca.SX(function.sparsity_out(i), ca.vertcat(*entries)) for i, entries in enumerate(outputs)
    ]
    return ca.Function(function.name(), inputs, results, function.name_in(), function.name_out())
