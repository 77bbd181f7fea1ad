"""Closed forms as text: plain, LaTeX, Python, C and MATLAB."""

from __future__ import annotations

import keyword
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import reduce
from itertools import combinations_with_replacement, product
from operator import getitem
from typing import Any

from microbot_ocp.robot._closed_form import ClosedForm, Series, Term

COEFFICIENT_DIGITS = 6  # digits of a coefficient in text for readers


def plain(series: Series) -> str:
    """Return a sum as plain text: ``3 cos(q1) cos(q2) + 4 cos(q1) cos(q2 + q3)``."""

    def factors(term: Term) -> list[str]:
        waves = [f"{wave}({_angle(term, run, 'q')})" for wave, run in _waves(series, term)]
        powers = ((f"q{j + 1}", term.powers[j]) for j in series.displacements)
        return [name if n == 1 else f"{name}^{n}" for name, n in powers if n] + waves

    parts = _parts(series, factors, " ", lambda value: f"{value:.{COEFFICIENT_DIGITS}g}")
    return " ".join(parts) or "0"


def _waves(series: Series, term: Term) -> list[tuple[str, tuple[int, ...]]]:
    return [(wave, run) for wave, run in zip(term.waves, series.runs, strict=True) if wave]


def _angle(term: Term, run: tuple[int, ...], name: str, times: str = " ") -> str:
    """Return an angle such as ``q2 + 2 q3``, whose first factor is positive."""
    text = ""
    for joint in run:
        if power := term.powers[joint]:
            size = "" if abs(power) == 1 else f"{abs(power)}{times}"
            text += (" - " if power < 0 else " + ") + f"{size}{name}{joint + 1}"
    return text.removeprefix(" + ")


def _parts(
    series: Series, factors: Callable[[Term], list[str]], times: str, number: Callable[[float], str]
) -> Iterator[str]:
    """Yield terms with their signs: ``-2 a``, and after it ``+ b``."""
    for at, (term, value) in enumerate(series.terms.items()):
        names = factors(term)
        size = number(abs(value))
        body = times.join(names if names and size in ("1", "1.0") else [size, *names])
        sign = "-" if value < 0 else "+"
        yield f"{sign} {body}" if at else body if value > 0 else f"-{body}"


def _broken(
    parts: Iterable[str], width: int, between: str, size: Callable[[str], int] = len
) -> str:
    """Return the terms in lines of at most this width, if the terms permit it."""
    lines: list[list[str]] = []
    room = 0
    for part in parts:
        if not lines or room + size(part) > width:
            lines.append([])
            room = 0
        lines[-1].append(part)
        room += size(part) + 1
    return between.join(" ".join(line) for line in lines)


# LaTeX --------------------------------------------------------------------------------------------


HEADINGS = {
    "T": (
        "Pose of the tool",
        "The transform $T$ from the tool frame to the base frame, lengths in m.",
    ),
    "M": ("Mass matrix", "In kg m$^2$, of prismatic joints in kg m or kg; $M_{ji} = M_{ij}$."),
    "c": (
        "Coriolis and centrifugal matrix",
        r"$C_{ij} = \sum_k c_{ijk}\,\dot q_k$ with the Christoffel symbols $c_{ikj} = c_{ijk}$.",
    ),
    "g": ("Gravity torque", "In N m, of a prismatic joint in N."),
}


def _entries(form: ClosedForm, symbol: str) -> Iterator[tuple[tuple[int, ...], Series]]:
    """Yield indices and value of each nonzero entry of a tensor; one half of a symmetric one."""
    every = range(form.robot.joint_count)
    pairs = list(combinations_with_replacement(every, 2))
    places, tensor = {
        "T": (product(range(4), range(4)), form.pose),
        "M": (pairs, form.mass),
        "c": (((i, j, k) for i in every for j, k in pairs), form.christoffel),
        "g": (zip(every), form.gravity),
    }[symbol]
    for place in places:
        entry: Any = reduce(getitem, place, tensor)
        if entry.terms:
            yield place, entry


def latex(form: ClosedForm) -> str:
    """Return a LaTeX document with every nonzero entry."""
    names = ["d" if kind == "prismatic" else r"\theta" for kind in form.robot.joint_types]
    variables = ", ".join(f"${name}_{i}$" for i, name in enumerate(names, start=1))
    title = re.sub(r"([&%$#_{}])", r"\\\1", re.sub(r"[\\~^]", " ", form.robot.name))
    digits = COEFFICIENT_DIGITS
    lines = [
        r"\documentclass{article}",
        r"\usepackage[margin=2cm]{geometry}",
        r"\usepackage{amsmath}",
        r"\allowdisplaybreaks",
        r"\begin{document}",
        rf"\section*{{{title}: equations of motion in closed form}}",
        r"\[ M(q)\,\ddot q + C(q, \dot q)\,\dot q + g(q) = \tau \]",
        rf"Joint positions $q$: {variables}. SI units, radians; coefficients have {digits} digits;",
        "friction is left out; entries that are not listed are zero.",
    ]
    for symbol in HEADINGS if form.mass else "T":
        heading, about = HEADINGS[symbol]
        lines += [rf"\subsection*{{{heading}}}", about]
        rows = [
            f"{symbol}_{{{''.join(str(i + 1) for i in place)}}} &= {_latex_sum(series, names)}"
            for place, series in _entries(form, symbol)
            if symbol != "T" or place[0] < 3
        ]
        if rows:
            lines += [r"\begin{align*}", " \\\\\n".join(rows), r"\end{align*}"]
    return "\n".join([*lines, r"\end{document}", ""])


LATEX_WIDTH = 73  # visible characters in a line of a formula


def _latex_sum(series: Series, names: Sequence[str]) -> str:
    def factors(term: Term) -> list[str]:
        words = []
        for joint in series.displacements:
            if power := term.powers[joint]:
                words.append(f"{names[joint]}_{joint + 1}" + (f"^{power}" if power > 1 else ""))
        for wave, run in _waves(series, term):
            angle = _angle(term, run, r"\theta_", "")
            single = sum(term.powers[joint] != 0 for joint in run) == 1
            words.append(rf"\{wave} {angle}" if single else rf"\{wave}({angle})")
        return words

    def size(part: str) -> int:  # a command is printed as a letter or as its name
        return len(re.sub(r"\\theta_|\\[,{}]|\\(?=[cs])|\{|\}|\^", "", part))

    parts = _parts(series, factors, r"\,", _latex_number)
    return _broken(parts, LATEX_WIDTH, " \\\\\n  &\\quad ", size)


def _latex_number(value: float) -> str:
    mantissa, _, exponent = f"{value:.{COEFFICIENT_DIGITS}g}".partition("e")
    return rf"{mantissa} \cdot 10^{{{int(exponent)}}}" if exponent else mantissa


# Programs -----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Syntax:
    """Syntax of one language for the functions of a closed form."""

    comment: str
    end: str
    continued: str
    let: str

    def at(self, language: str, name: str, place: Sequence[int]) -> str:
        """Return an entry of an array; ``place`` counts from 0."""
        if language == "matlab":
            return f"{name}({', '.join(str(i + 1) for i in place)})"
        return name + "".join(f"[{i}]" for i in place)


SYNTAX = {
    "python": Syntax("#", "", "\n        ", ""),
    "c": Syntax("//", ";", "\n        ", "const double "),
    "matlab": Syntax("%", ";", " ...\n        ", ""),
}
FUNCTIONS = {
    "T": (
        "forward_kinematics",
        "Pose of the tool frame in the base frame, a homogeneous transform; lengths in m.",
    ),
    "M": ("mass_matrix", "Mass matrix, kg m^2."),
    "C": (
        "coriolis_matrix",
        "Coriolis and centrifugal matrix from Christoffel symbols, friction left out.",
    ),
    "g": ("gravity_torque", "Torque that holds the arm still, N m (prismatic: N)."),
}


def program(form: ClosedForm, language: str) -> str:
    """Return source text with one function for each of T, M, C and g."""
    syntax = SYNTAX[language]
    count = form.robot.joint_count
    name = " ".join(form.robot.name.split())
    head = [
        f"{name}: its equations in closed form, M(q) qdd + C(q, qd) qd + g(q) = tau.",
        "SI units and radians; q and qd have one entry per joint. Here c23 is cos(q2 + q3), s22m3",
        "is sin(2 q2 - q3); h123 is the Christoffel symbol of C(1, 2) and the speed of joint 3.",
    ]
    lines = [f"{syntax.comment} {line}" for line in head]
    if language == "python":
        lines += ["from math import cos, sin", ""]
    if language == "c":
        lines += ["#include <math.h>", "#include <string.h>", ""]
    wanted = list(FUNCTIONS) if form.mass else ["T"]
    if language == "matlab":
        called = re.sub(r"\W", "_", form.robot.name, flags=re.ASCII)
        if not called[:1].isalpha() or keyword.iskeyword(called):
            called = f"robot_{called}"
        lines += [
            f"function [{', '.join(wanted)}] = {called}(q, qd)",
            f"    if nargin < 2, qd = zeros({count}, 1); end",
            *(f"    {m} = {FUNCTIONS[m][0]}({'q, qd' if m == 'C' else 'q'});" for m in wanted),
            "end",
            "",
        ]
    for matrix in wanted:
        lines += _function(form, language, matrix)
    return "\n".join(lines).rstrip() + "\n"


def _function(form: ClosedForm, language: str, matrix: str) -> list[str]:
    syntax, count = SYNTAX[language], form.robot.joint_count
    shape = {"T": (4, 4), "g": (count,)}.get(matrix, (count, count))
    body = _statements(form, language, matrix)
    text = "\n".join(body)
    arguments = ["q", "qd"] if matrix == "C" else ["q"]
    read = [
        f"{syntax.let}{name}{i + 1} = {syntax.at(language, name, [i])}{syntax.end}"
        for name in arguments
        for i in range(count)
        if re.search(rf"\b{name}{i + 1}\b", text)
    ]
    title, about = FUNCTIONS[matrix]
    signature = ", ".join(arguments)
    if language == "python":
        zeros = (
            f"[0.0] * {count}"
            if matrix == "g"
            else f"[[0.0] * {shape[1]} for _ in range({shape[0]})]"
        )
        head = ["", f"def {title}({signature}):"]
        inside = [f'"""{about}"""', *read, f"{matrix} = {zeros}", *body, f"return {matrix}"]
        tail = [""]
    elif language == "c":
        given = ", ".join(f"const double {name}[{count}]" for name in arguments)
        sizes = "".join(f"[{n}]" for n in shape)
        head = [f"// {about}", f"void {title}({given}, double {matrix}{sizes})", "{"]
        entries = " * ".join(map(str, shape))
        inside = [*read, f"memset({matrix}, 0, {entries} * sizeof(double));", *body]
        unused = [f"(void){name};" for name in arguments if f"{name}[" not in "\n".join(read)]
        inside = [*unused, *inside]
        tail = ["}", ""]
    else:
        sizes = f"{shape[0]}, {shape[1] if len(shape) == 2 else 1}"
        head = [f"function {matrix} = {title}({signature})", f"    % {about}"]
        inside = [*read, f"{matrix} = zeros({sizes});", *body]
        tail = ["end", ""]
    return [*head, *(f"    {line}" for line in inside), *tail]


PROGRAM_WIDTH = 96  # characters in a line of a program
MOST_TERMS = 200  # terms of one statement: parsers of programs nest a level for each


def _statements(form: ClosedForm, language: str, matrix: str) -> list[str]:
    """Return the definitions of the waves in use, and of every nonzero entry."""
    syntax, every = SYNTAX[language], range(form.robot.joint_count)
    waves: dict[str, str] = {}
    entries: list[str] = []

    def assign(target: str, parts: Iterable[str], let: str = "") -> None:
        every_part = list(parts)
        if len(every_part) > MOST_TERMS:
            let = let.removeprefix("const ")
        for first in range(0, len(every_part), MOST_TERMS):
            some = every_part[first : first + MOST_TERMS]
            text = _broken([target, *some] if first else some, PROGRAM_WIDTH, syntax.continued)
            if language == "python" and "\n" in text:
                text = f"(\n        {text}\n    )"
            entries.append(f"{'' if first else let}{target} = {text}{syntax.end}")

    def at(*place: int) -> str:
        return syntax.at(language, matrix, place)

    def sums(series: Series) -> Iterator[str]:
        return _parts(series, lambda term: _code_factors(series, term, waves), "*", repr)

    for place, series in _entries(form, matrix.replace("C", "c")):
        if matrix == "C":
            assign("h" + "".join(str(i + 1) for i in place), sums(series), syntax.let)
            continue
        assign(at(*place), sums(series))
        if matrix == "M" and place[0] != place[1]:
            assign(at(*place[::-1]), [at(*place)])
    for i, j in product(every, every) if matrix == "C" else ():
        speeds = [
            f"h{i + 1}{min(j, k) + 1}{max(j, k) + 1}*qd{k + 1}"
            for k in every
            if form.christoffel[i][j][k].terms
        ]
        if speeds:
            assign(at(i, j), [speeds[0], *(f"+ {speed}" for speed in speeds[1:])])
    first = [f"{syntax.let}{name} = {value}{syntax.end}" for name, value in sorted(waves.items())]
    return [*first, *entries]


def _code_factors(series: Series, term: Term, waves: dict[str, str]) -> list[str]:
    """Return names of the factors of a term, and add its waves to ``waves``."""
    factors = []
    for joint in series.displacements:
        factors += [f"q{joint + 1}"] * term.powers[joint]
    for wave, run in _waves(series, term):
        joints = ""
        for joint in run:
            power = term.powers[joint]
            joints += ("m" if power < 0 else "") + str(joint + 1) * abs(power)
        waves[wave[0] + joints] = f"{wave}({_angle(term, run, 'q', '*')})"
        factors.append(wave[0] + joints)
    return factors
