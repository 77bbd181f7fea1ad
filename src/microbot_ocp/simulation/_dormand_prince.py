"""The method of Dormand and Prince of order 8 with error control and dense output, DOP853.

Source: Hairer, Nørsett, Wanner, *Solving Ordinary Differential Equations I*, 2nd ed., sections II.4
to II.6, with the constants of their code. One step is one CasADi function, whose inputs hold all
that differs between runs of one loop, so that it is built and compiled once. A method of one step
begins anew where its input jumps, at no cost.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from microbot_ocp._base import deadline
from microbot_ocp._base.checks import FloatArray
from microbot_ocp._base.fast_calls import FastCall

TOO_MANY_STEPS = "it needed more steps than allowed"
SHRUNK = "its step shrank to nothing"
NOT_FINITE = "the accelerations are not finite"
NOT_FINITE_AT_START = "the accelerations are not finite at the start"
OVER = "stopped at the time limit"

SMALLEST = 1e-15  # step, as a share of the time: what rounding leaves of one
LAST_TERM = (4 / 7) ** 4 * (3 / 7) ** 3  # largest share of it anywhere inside a step
STAGES = 12  # then the rate at the new state, and three more for the dense output
# Weights of earlier rates in the state of each later one, row by row
_WEIGHTS = """
0.05260015195876773
0.0197250569845379 0.0591751709536137
0.02958758547680685 0 0.08876275643042054
0.2413651341592667 0 -0.8845494793282861 0.924834003261792
0.037037037037037035 0 0 0.17082860872947386 0.12546768756682242
0.037109375 0 0 0.17025221101954405 0.06021653898045596 -0.017578125
0.03709200011850479 0 0 0.17038392571223998 0.10726203044637328 -0.015319437748624402
0.008273789163814023
0.6241109587160757 0 0 -3.3608926294469414 -0.868219346841726 27.59209969944671 20.154067550477894
-43.48988418106996
0.47766253643826434 0 0 -2.4881146199716677 -0.590290826836843 21.230051448181193
15.279233632882423 -33.28821096898486 -0.020331201708508627
-0.9371424300859873 0 0 5.186372428844064 1.0914373489967295 -8.149787010746927 -18.52006565999696
22.739487099350505 2.4936055526796523 -3.0467644718982196
2.273310147516538 0 0 -10.53449546673725 -2.0008720582248625 -17.9589318631188 27.94888452941996
-2.8589982771350235 -8.87285693353063 12.360567175794303 0.6433927460157636
0.054293734116568765 0 0 0 0 4.450312892752409 1.8915178993145003 -5.801203960010585
0.3111643669578199 -0.1521609496625161 0.20136540080403034 0.04471061572777259
0.056167502283047954 0 0 0 0 0 0.25350021021662483 -0.2462390374708025 -0.12419142326381637
0.15329179827876568 0.00820105229563469 0.007567897660545699 -0.008298
0.03183464816350214 0 0 0 0 0.028300909672366776 0.053541988307438566 -0.05492374857139099 0 0
-0.00010834732869724932 0.0003825710908356584 -0.00034046500868740456 0.1413124436746325
-0.42889630158379194 0 0 0 0 -4.697621415361164 7.683421196062599 4.06898981839711
0.3567271874552811 0 0 0 -0.0013990241651590145 2.9475147891527724 -9.15095847217987
"""
# Error estimates of order 5 and, beside the method's own weights, of order 3
_ERRORS = """
0.01312004499419488 0 0 0 0 -1.2251564463762044 -0.4957589496572502 1.6643771824549864
-0.35032884874997366 0.3341791187130175 0.08192320648511571 -0.022355307863886294
-0.2440944881889764 0 0 0 0 0 0 0 -0.7338466882816118 0 0 -0.022058823529411766
"""
# Last four terms of the dense output from all rates
_DENSE = """
-8.428938276109013 0 0 0 0 0.5667149535193777 -3.0689499459498917 2.38466765651207
2.117034582445028 -0.871391583777973 2.2404374302607883 0.6315787787694688 -0.08899033645133331
18.148505520854727 -9.194632392478356 -4.436036387594894
10.427508642579134 0 0 0 0 242.28349177525817 165.20045171727028 -374.5467547226902
-22.113666853125306 7.733432668472264 -30.674084731089398 -9.332130526430229 15.697238121770845
-31.139403219565178 -9.35292435884448 35.81684148639408
19.985053242002433 0 0 0 0 -387.0373087493518 -189.17813819516758 527.8081592054236
-11.57390253995963 6.8812326946963 -1.0006050966910838 0.7777137798053443 -2.778205752353508
-60.19669523126412 84.32040550667716 11.99229113618279
-25.69393346270375 0 0 0 0 -154.18974869023643 -231.5293791760455 357.6391179106141
93.40532418362432 -37.45832313645163 104.0996495089623 29.8402934266605 -43.53345659001114
96.32455395918828 -39.17726167561544 -149.72683625798564
"""


def _numbers(text: str) -> FloatArray:
    return np.array(text.split(), dtype=float)


def step_function(rate: ca.Function) -> ca.Function:
    """Return one step of ``rate(t, x, u)`` with the choice of the next.

    Returns
    -------
    casadi.Function
        ``([t, width, x], u, [tolerance, end, longest]) -> [t, width, x], going, record``: the time,
        the width of the step that is tried next and the state; 0 at the end of the piece or where
        the step shrank to nothing; whether the step was taken, its start and width, then x and what
        its dense output consists of, 8 columns [states].
    """
    states = rate.size1_in("x")
    state, control = ca.MX.sym("state", 2 + states), ca.MX.sym("control", 3)
    u = ca.MX.sym("u", rate.size1_in("u"))
    t, wanted, x = ca.vertsplit(state, [0, 1, 2, 2 + states])
    tolerance, end, longest = ca.vertsplit(control)
    whole = end - t <= 1.01 * wanted
    width = ca.if_else(whole, end - t, wanted)

    weights = np.zeros((STAGES + 4, STAGES + 4))
    weights[np.tril_indices(STAGES + 4, -1)] = _numbers(_WEIGHTS)
    rates, at, after = ca.MX(states, 0), x, x
    for stage, row in enumerate(weights):
        if stage:
            at = x + width * ca.mtimes(rates, ca.DM(row[:stage]))
        if stage == STAGES:
            after = at
        rates = ca.horzcat(rates, rate(t + row.sum() * width, at, u))
    change, first, last = after - x, width * rates[:, 0], width * rates[:, STAGES]
    late = width * ca.mtimes(rates, ca.DM(_numbers(_DENSE).reshape(4, -1).T))

    scale = tolerance * (1 + ca.fmax(ca.fabs(x), ca.fabs(after)))
    order_5, order_3 = _numbers(_ERRORS).reshape(2, STAGES)
    fifth, third = (
        ca.sumsqr(ca.mtimes(rates[:, :STAGES], ca.DM(row)) / scale)
        for row in (order_5, order_3 + weights[STAGES, :STAGES])
    )
    error = width * fifth / ca.sqrt(states * (fifth + 0.01 * third) + 1e-300)
    # Between its ends a long step may be less accurate: the last term of the dense output tells
    between = LAST_TERM * ca.sqrt(ca.sumsqr(late[:, 3] / scale) / states)
    error = ca.fmax(error, between) + 0 * between  # fmax drops what is no number
    good = error <= 1
    factor = ca.fmin(6, ca.fmax(1 / 3, 0.9 * ca.fmax(error, 1e-9) ** -0.125))
    following = width * ca.if_else(error < np.inf, factor, 1 / 3)  # not so where it is no number
    # A step that the end has cut short says nothing against the width wanted before
    following = ca.if_else(ca.logic_and(good, whole), ca.fmax(wanted, following), following)
    following = ca.fmin(following, longest)
    time = ca.if_else(good, ca.if_else(whole, end, t + width), t)
    going = ca.logic_and(time < end, following >= SMALLEST * ca.fmax(ca.fabs(t), ca.fabs(end)))
    terms = ca.horzcat(x, change, first - change, 2 * change - last - first, late)
    record = ca.vertcat(good, t, width, ca.vec(terms))
    state_after = ca.vertcat(time, following, ca.if_else(good, after, x))
    return ca.Function("dop853", [state, u, control], [state_after, going, record])


def integrated(
    steps: FastCall,
    pieces: tuple[FloatArray, FloatArray],
    start: FloatArray,
    grid: FloatArray,
    tolerance: float,
    max_steps: int,
    longest: float,
) -> tuple[FloatArray, str]:
    """Integrate from piece to piece.

    Parameters
    ----------
    steps : callable
        What :func:`step_function` made, as a numpy function that keeps what each call returns.
    pieces : (edges [K+1], inputs [K,m])
        Times at which the right-hand side may jump, and ``u`` between.
    max_steps : int
        Most steps from one time of the grid to the next.
    longest : float
        Longest step, s.

    Returns
    -------
    states [N, states], message
        NaN from where the steps ended early, and why they did.
    """
    state, message = np.concatenate([grid[:1], [longest], start]), ""
    passed, tried = 1, 0  # times of the grid, and steps since the last of them
    records: list[FloatArray] = []
    for end, u in zip(pieces[0][1:], pieces[1], strict=True):
        control = np.array([tolerance, end, longest])
        while state[0] < end and not message:
            states, going, record = steps(state, u, control)
            state = states[-1]
            done = np.searchsorted(grid, states[:, 0], side="right")
            ahead = np.append(passed, done[:-1])
            since = np.arange(1, done.size + 1) - np.searchsorted(ahead, ahead)
            since[ahead == passed] += tried
            if (since > max_steps).any():
                message = TOO_MANY_STEPS
                record = record[: int((since > max_steps).argmax())]
            elif not going[-1] and state[0] < end:
                unknown = not np.isfinite(record[-1]).all()
                message = (NOT_FINITE if records else NOT_FINITE_AT_START) if unknown else SHRUNK
            elif deadline.over():
                message = OVER
            records.append(record[record[:, 0] > 0])
            tried, passed = int(since[-1]) * (done[-1] == ahead[-1]), done[-1]
    return _at(grid, start, np.concatenate(records)), message


def _at(grid: FloatArray, start: FloatArray, records: FloatArray) -> FloatArray:
    """Return states [N, states] at times [N] by the dense output of steps [K], then NaN."""
    begin, width = records[:, 1], records[:, 2]
    terms = records[:, 3:].reshape(len(records), 8, start.size)
    edges = np.searchsorted(grid, np.append(begin, (begin + width)[-1:]), side="right")
    states = np.full((grid.size, start.size), np.nan)
    states[0] = start
    count = np.diff(edges)
    share = (grid[1 : 1 + count.sum()] - np.repeat(begin, count)) / np.repeat(width, count)
    basis = np.ones((share.size, 8))
    for k in range(7):
        basis[:, k + 1] = basis[:, k] * (1 - share if k % 2 else share)
    for low, up, of_step in zip(edges[:-1].tolist(), edges[1:].tolist(), terms, strict=True):
        np.matmul(basis[low - 1 : up - 1], of_step, out=states[low:up])
    return states
