"""The model as a LaTeX document: equations, and all values with their intervals."""

from __future__ import annotations

import re
from collections.abc import Mapping

from twin.export.script.content import Content
from twin.export.variables import of_law
from twin.model.causes.catalogue import BY_NAME
from twin.model.parameters import Parameter

_SYMBOLS = {"->": r"\to ", "<=": r"\le ", "...": r"\dots "}
_GREEK = frozenset(["tau", "pi"])
_FUNCTIONS = {"exp": r"\exp", "ln": r"\ln", "max": r"\max", "min": r"\min", "sin": r"\sin", "sqrt": r"\sqrt"}
_TOKEN = re.compile(r"->|<=|\.\.\.|\^\([^()]*\)|[A-Za-z]+(?:_[A-Za-z0-9]+)?'*|\d+(?:\.\d+)?|.", re.DOTALL)
_ESCAPED = {character: rf"\{character}" for character in "_%&#${}"} | {
    "\\": r"\textbackslash{}",
    "^": r"\textasciicircum{}",
    "~": r"\textasciitilde{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    "|": r"\textbar{}",
}

_DOCUMENT = r"""\documentclass{article}
\usepackage{amsmath}
\title{%(title)s}
\date{}
\begin{document}
\maketitle

Amplifier, ball and coil. The numbers of the equations are those of T.~Tkacik, A.~Jadlovska, J.~Jadlovsky,
\emph{Modeling, Identification and Validation of the Modified Magnetic Levitation Model}.
\begin{align}
T_A \frac{\mathrm{d}i_c}{\mathrm{d}t} + i_c &= K_A u_c \tag{1}\\
m_g \ddot x + b \dot x &= \frac{K_c\, i_c^2}{(x - x_{\max})^2} - m_g g, \qquad 0 \le x \le l \tag{6}
\end{align}

\begin{center}
\begin{tabular}{llllll}
\hline
& value & 95\,\%% interval & unit & verdict \\
\hline
%(parameters)s
\hline
\end{tabular}
\end{center}
%(causes)s
\section*{Controller}
%(law)s
\end{document}
"""
_PLANT = (
    ("m_g", "mass_kg", "kg"),
    ("l", "travel_m", "m"),
    (r"x_{\max}", "x_max_m", "m"),
    ("g", "gravity_m_s2", "m/s^2"),
)


def latex(parts: Content) -> Mapping[str, str]:
    """Return the texts of the files, by name."""
    model = parts.model
    rows = [_row(symbol, parameter) for symbol, parameter in model.parameters.items()]
    rows += [
        f"${symbol}$ & {_number(getattr(model.plant, key))} & & {_unit(unit)} & stated \\\\"
        for symbol, key, unit in _PLANT
    ]
    text = _DOCUMENT % {
        "title": _escaped(parts.title),
        "parameters": "\n".join(rows),
        "causes": _causes(parts),
        "law": _law(parts),
    }
    return {"model.tex": text}


def _row(symbol: str, parameter: Parameter) -> str:
    interval = ""
    if parameter.ci95 is not None:
        interval = f"{_number(parameter.ci95[0])} to {_number(parameter.ci95[1])}"
    return (
        f"${_math(symbol)}$ & {_number(parameter.value)} & {interval} & {_unit(parameter.unit)} &"
        f" {_escaped(parameter.verdict)} \\\\"
    )


def _causes(parts: Content) -> str:
    if not parts.model.causes:
        return ""
    texts = [r"\section*{Causes}", "What changes in (1) and (6), each with its own parameters."]
    for cause in parts.model.causes:
        known = BY_NAME[cause.name]
        rows = [_row(item.symbol, cause.parameters[item.name]) for item in known.parameters]
        texts += [
            rf"\subsection*{{{_escaped(cause.name)}: {_escaped(known.title)}}}",
            rf"\raggedright ${_math(known.equation)}$",
            r"\begin{center}\begin{tabular}{lllll}\hline",
            *rows,
            r"\hline\end{tabular}\end{center}",
        ]
    return "\n".join([*texts, *(f"{_escaped(note)}." for note in parts.notes)])


def _law(parts: Content) -> str:
    law = parts.controller.numbers
    used = [(v.field, v.start, v.unit) for v in of_law(law) if v.field not in ("u_low", "u_high", "s_max")]
    values = ", ".join(
        f"${symbol} = {_number(value, wrap=False)}$~{_unit(unit)}"
        for symbol, value, unit in (*used, ("T_s", law.sample_time_s, "s"))
    )
    return (
        "\\[u_c = u_0 - k_i (i_c - i_0) - k_x (x - x_0) + k_p (x_{\\mathrm{ref}} - x)\n"
        "- k_v \\frac{x(k) - x(k-1)}{T_s} + k_s \\sum (x_{\\mathrm{ref}} - x)\\, T_s\\]\n"
        f"{values}."
    )


def _number(value: float, *, wrap: bool = True) -> str:
    mantissa, _, exponent = f"{value:.4g}".partition("e")
    text = mantissa + (rf" \cdot 10^{{{int(exponent)}}}" if exponent else "")
    return f"${text}$" if wrap else text


def _unit(unit: str) -> str:
    return "$" + re.sub(r"([A-Za-z]+)", r"\\mathrm{\1}", unit).replace(" ", r"\,") + "$" if unit else ""


def _escaped(text: str) -> str:
    return "".join(_ESCAPED.get(character, character) for character in text)


def _math(text: str) -> str:
    """A formula of the catalogue, which is plain text, as TeX: names with indices, powers, words."""
    close = re.sub(r" *(->|<=|[-+=/<>]) *", r"\1", text)  # TeX spaces operators by itself
    return "".join(_token(token) for token in _TOKEN.findall(close))


def _token(token: str) -> str:
    if token in _SYMBOLS or token in _FUNCTIONS:
        return _SYMBOLS.get(token) or _FUNCTIONS[token]
    if token.startswith("^("):
        return f"^{{{_math(token[2:-1])}}}"
    if not token[0].isalpha():
        return {" ": r"\ ", "%": r"\%"}.get(token, token)
    primes = token[len(token.rstrip("'")) :]
    head, _, index = token.rstrip("'").partition("_")
    text = rf"\{head} " if head in _GREEK else head if len(head) == 1 else rf"\mathrm{{{head}}}"
    below = index if len(index) <= 1 else rf"\mathrm{{{index}}}"
    return text + (f"_{{{below}}}" if index else "") + primes
