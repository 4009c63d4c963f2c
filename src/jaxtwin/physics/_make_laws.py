"""Writes the laws of heat as C and as SPICE: `python -m jaxtwin.physics._make_laws [FOLDER]`.

JAX traces a law, a function of scalars, and its derivatives. The steps of the trace become
expressions: constants are folded, factors 0 and 1 go, and equal parts are found, so that a
derivative shares with the value what it can. C gives a name to what is needed more than once; SPICE
has no statements and repeats it.

The files in `laws/` are committed, because a trace takes a part of a second that a first run should
not need. The exported C (`c_export/`) and the native solver (`simulation/rodas5p.c`) include them,
and say what stands for `model_real`, `model_number` and `model_raised`; `spice/` copies them.
"""

import inspect
import operator
import sys
import textwrap
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
from jax.extend.core import ClosedJaxpr, Literal

from .._jax_settings import own_settings
from ._driver import share_of_duty
from ._heat_loss import LAW_FOLDER, lost_heat

# A number, the name of an argument, or an operation and the terms that it is applied to.
Term = float | str | tuple[Any, ...]

Law = Callable[..., Any]

# Of each law, its derivatives: what they are, and the directions in which its arguments change.
SLOPES: Mapping[Law, tuple[str, Mapping[str, Mapping[str, float]]]] = {
    lost_heat: (
        "The derivatives of model_lost_heat by the temperatures of the two ends, W/K.",
        {"by_near": {"rise": 1.0}, "by_far": {"rise": -1.0, "ambient": 1.0}},
    ),
    share_of_duty: (
        "The derivative of model_share_of_duty by the duty.",
        {"by_duty": {"duty": 1.0}},
    ),
}

MAX_LINE = 100


def law_files() -> dict[str, str]:
    """The names of the files in `laws/`, and their texts."""
    files: dict[str, str] = {}
    functions: list[str] = []
    for law, (comment, directions) in SLOPES.items():
        name, arguments = law.__name__, list(inspect.signature(law).parameters)
        about = (inspect.getdoc(law) or "").partition("\n")[0]
        [value] = traced(law)
        files[f"{name}.c"] = _c_function(law, name, about, {"": value})
        slopes = dict(zip(directions, traced(law, list(directions.values())), strict=True))
        files[f"{name}_slopes.c"] = _c_function(law, f"{name}_slopes", comment, slopes)
        formula = infix(value, SPICE, {})
        function = f".func {name}({', '.join(arguments)}) {{{formula}}}"
        functions += [f"* {about}", _wrapped(function, "+ ")]
    return files | {"laws.cir": "\n".join(functions) + "\n"}


# From a law to terms.


def traced(law: Law, directions: Sequence[Mapping[str, float]] = ()) -> list[Term]:
    """The value of a law as a term of its arguments; or its derivatives, if directions are given in
    which arguments change.

    **Raises:** `NotImplementedError` if the law has an operation that is not in `_RULES`.
    """
    names = list(inspect.signature(law).parameters)

    def slopes(*values: Any) -> list[Any]:
        tangents = [[along.get(name, 0.0) for name in names] for along in directions]
        return [jax.jvp(law, values, tuple(tangent))[1] for tangent in tangents]

    with own_settings():
        return _terms(jax.make_jaxpr(slopes if directions else law)(*(1.0 for _ in names)), names)


def _terms(trace: ClosedJaxpr, arguments: Sequence[str]) -> list[Term]:
    of: dict[Any, Term] = dict(zip(trace.jaxpr.invars, arguments, strict=True))

    def read(atom: Any) -> Term:
        return float(atom.val) if isinstance(atom, Literal) else of[atom]

    for step in trace.jaxpr.eqns:
        operation = step.primitive.name
        if operation not in _RULES:
            raise NotImplementedError(
                f"a law: expected operations of {', '.join(_RULES)}, got {operation}; give it a "
                f"rule in {__name__}"
            )
        [result] = step.outvars
        whole = [step.params["y"]] if operation == "integer_pow" else []
        of[result] = _RULES[operation](*map(read, step.invars), *whole)
    return [read(atom) for atom in trace.jaxpr.outvars]


_ARITHMETIC = {"+": operator.add, "-": operator.sub, "*": operator.mul, "/": operator.truediv}


def _term(operation: str, a: Term, b: Term) -> Term:
    """A sum, difference, product or quotient. Signs move outwards, so that terms that differ only
    in them share their parts."""
    match operation, a, b:
        case _, float(), float():
            return _ARITHMETIC[operation](a, b)
        case ("*", 0.0, _) | ("*", _, 0.0) | ("/", 0.0, _):
            return 0.0
        case ("*", 1.0, x) | ("*" | "/", x, 1.0) | ("+", 0.0, x) | ("+" | "-", x, 0.0):
            return x
        case ("*", -1.0, x) | ("*", x, -1.0) | ("-", 0.0, x):
            return _negative(x)
        case ("+", x, ("negative", y)) | ("+", ("negative", y), x):
            return _term("-", x, y)
        case "-", x, ("negative", y):
            return _term("+", x, y)
        case ("*" | "/", ("negative", x), y) | ("*" | "/", x, ("negative", y)):
            return _negative(_term(operation, x, y))
    return (operation, a, b)


def _negative(a: Term) -> Term:
    match a:
        case float():
            return -a
        case ("negative", x):
            return x
    return ("negative", a)


def _power(a: Term) -> Term:
    """The exponential, in which laws write a fractional power so that its derivative needs no
    second one."""
    match a:
        case ("*", exponent, ("log", base)):
            return ("power", base, exponent)
    raise NotImplementedError("a law: expected exp(exponent * log(base)), got another exponential")


def _whole_power(a: Term, exponent: int) -> Term:
    if exponent <= 0:
        return 1.0 if exponent == 0 else _term("/", 1.0, _whole_power(a, -exponent))
    return a if exponent == 1 else _term("*", _whole_power(a, exponent - 1), a)


_RULES: dict[str, Callable[..., Term]] = {
    "add": partial(_term, "+"),
    "add_any": partial(_term, "+"),
    "sub": partial(_term, "-"),
    "mul": partial(_term, "*"),
    "div": partial(_term, "/"),
    "neg": _negative,
    "square": partial(_whole_power, exponent=2),
    "integer_pow": _whole_power,
    "log": lambda a: ("log", a),
    "exp": _power,
}


# From terms to text.


class Syntax(NamedTuple):
    """How a language writes a number that is not whole, and a power."""

    number: str
    power: str


C = Syntax("model_number({!r})", "model_raised")
SPICE = Syntax("{!r}", "pow")


def infix(term: Term, syntax: Syntax, names: Mapping[Term, str], above: int = 0) -> str:
    """A term as text, evaluated in the order of the law.

    **Arguments:**

    - `names`: of the terms that have one.
    - `above`: how tightly what surrounds it binds: 1 for a sum, 2 for a product.
    """
    match names.get(term, term):
        case float(number):
            # Larger whole numbers are no integers of C.
            is_whole = number.is_integer() and abs(number) < 2**31
            return f"{number:.0f}" if is_whole else syntax.number.format(number)
        case str(name):
            return name
        case ("power", base, exponent):
            arguments = (infix(part, syntax, names) for part in (base, exponent))
            return f"{syntax.power}({', '.join(arguments)})"
        case ("negative", x):
            text, binds = f"-{infix(x, syntax, names, 2)}", 1
        case (operation, a, b):
            binds = 1 if operation in ("+", "-") else 2
            left, right = infix(a, syntax, names, binds), infix(b, syntax, names, binds + 1)
            text = f"{left} {operation} {right}"
        case other:
            raise NotImplementedError(f"a law: expected a term that has a text, got {other}")
    return f"({text})" if binds < above else text


def _shared(results: Sequence[Term]) -> list[tuple[Any, ...]]:
    """Powers, and what is needed more than once, each behind those that it needs."""
    uses: Counter[Term] = Counter()
    order: list[tuple[Any, ...]] = []

    def visit(term: Term) -> None:
        if isinstance(term, tuple):
            uses[term] += 1
            if uses[term] == 1:
                for part in term[1:]:
                    visit(part)
                order.append(term)

    for result in results:
        visit(result)
    return [term for term in order if uses[term] > 1 or term[0] == "power"]


def _c_function(law: Law, name: str, comment: str, results: Mapping[str, Term]) -> str:
    """A function that returns a result without a name, or sets those that have one."""
    names: dict[Term, str] = {}
    lines = []
    for number, term in enumerate(_shared(list(results.values()))):
        lines.append(f"const model_real v{number} = {infix(term, C, names)};")
        names[term] = f"v{number}"
    for result, term in results.items():
        to = f"*{result} =" if result else "return"
        lines.append(f"{to} {infix(term, C, names)};")
    arguments = [f"model_real\xa0{argument}" for argument in inspect.signature(law).parameters]
    arguments += [f"model_real\xa0*{result}" for result in results if result]
    kind = "model_real" if "" in results else "void"
    head = f"static inline {kind} model_{name}("
    source = f"{law.__name__} in {law.__module__.replace('.', '/')}.py"
    about = f"/* {comment} Written by physics/_make_laws.py from {source.partition('/')[2]}. */"
    return "\n".join(
        [
            _wrapped(about, "   "),
            _wrapped(f"{head}{', '.join(arguments)})", " " * len(head)),
            "{",
            *(_wrapped(f"    {line}", " " * 8) for line in lines),
            "}\n",
        ]
    )


def _wrapped(text: str, indent: str) -> str:
    """A text in lines, which end at no space that is `\\xa0`."""
    lines = textwrap.fill(
        text, MAX_LINE, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
    )
    return lines.replace("\xa0", " ")


if __name__ == "__main__":
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else LAW_FOLDER
    for file, text in law_files().items():
        (folder / file).write_text(text, encoding="ascii")
