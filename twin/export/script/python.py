"""The rig for Python: a module of numpy and the standard library, and a script of python-control with figure 11."""

from __future__ import annotations

import ast
from collections.abc import Mapping

from twin.export.script.content import STEP_SHARE, Content
from twin.export.translate.specialise import Function, Program
from twin.model.causes.cause import PLACES
from twin.model.extended import I_C, V, X
from twin.model.simulate import I_READ, X_BEFORE, X_READ

HEAD = '''\
"""{title}: the simulation of an identified rig.

Needs Python 3.9 with numpy, nothing else.  SI units; (N) is equation N of T. Tkacik, A. Jadlovska, J. Jadlovsky,
"Modeling, Identification and Validation of the Modified Magnetic Levitation Model".
{notes}"""

import math
from types import SimpleNamespace

import numpy as np

m = SimpleNamespace()
m.T_s = {T_s!r}  # s
m.c = [0.0] * {count}  # parameters of the causes
{numbers}

'''
TAIL = f'''\
def start(i=None, x=None, v=0.0, u=None):
    """The memory of a rig with these readings (A, m) and speed (m/s); default: at rest at the operating point."""
    memory = [0.0] * m.places
    i, x, u = (m.i_0 if i is None else i), (m.x_0 if x is None else x), (m.u_0 if u is None else u)
    BEGIN
    memory[{X_BEFORE}] = memory[{X_READ}]
    return memory


def tick(memory, closed_loop, x_ref=0.0, u=0.0):
    """Run one tick under x_ref or u; returns (readings of i and x, speed, u) of its beginning: A, m, m/s, V."""
    return TICK


def simulate(drive, closed_loop=True, noise=0.0, seed=1):
    """Simulate from rest at the operating point.

    Args:
        drive: x_ref in m (closed loop) or u in V, one for each tick.
        closed_loop: whether the control law runs.
        noise: factor on the identified noise levels.
        seed: of the noise.

    Returns:
        Readings of i and x, speed, u at each tick: shape (n, 4).
    """
    memory, draw = start(), np.random.default_rng(seed).standard_normal((4, len(drive)))
    draw *= noise * np.array([[m.sigma_i], [m.sigma_x], [m.process_i], [m.process_a * m.T_s]])
    out = np.empty((len(drive), 4))
    for k, value in enumerate(drive):
        memory[{I_READ}] += draw[0, k]
        memory[{X_READ}] += draw[1, k]
        out[k] = tick(memory, closed_loop, float(value), float(value))
        memory[{I_C}] += draw[2, k]
        if 0.0 < memory[{X}] < m.travel_m:
            memory[{V}] += draw[3, k]
    return out
'''
FIGURE = f'''\
"""Design with python-control, and figure 11 of the paper: the closed loop with measurement noise, simulated.

Needs numpy, scipy, control and matplotlib: pip install control matplotlib
"""

import control
import numpy as np

import rig
from rig import m

A, B = np.array(m.A), np.array(m.B)
plant = control.ss(A, B, np.eye(2, len(A)), 0.0, name="rig at the operating point (14)")
delay_s = m.delay  # of u_c, not in `plant`
sampled = control.ss(np.array(m.Phi), np.array(m.Gamma), np.eye(2, len(m.Phi)), 0.0, m.T_s, name="(15), with delay")


def gains():
    """K of (18) for [i_c, x, x', integral of (x_ref - x)], without states that no channel measures."""
    Phi, Gamma = np.array(m.Phi_prompt), np.array(m.Gamma_prompt)
    augmented = np.block([[Phi, np.zeros((3, 1))], [np.array([0.0, -m.T_s, 0.0, 1.0])]])
    K, _, _ = control.dlqr(augmented, np.vstack([Gamma, [[0.0]]]), np.diag(m.Q), [[m.R]])
    return K[0]


def figure_11(noise=1.0):
    """Return (t, x_ref, readings and u of `rig.simulate`)."""
    t = np.arange(round(4 / m.T_s)) * m.T_s
    x_ref = m.x_0 + {STEP_SHARE} * m.travel_m * np.sign(np.mod(t - 1, 2) - 1) * (t >= 1)
    return t, x_ref, rig.simulate(x_ref, noise=noise)


if __name__ == "__main__":
    import matplotlib.pyplot as plt

    print("poles of (14), 1/s:", plant.poles())
    print("gains of (18):", gains())
    t, x_ref, out = figure_11()
    _, (above, below) = plt.subplots(2, 1, sharex=True)
    above.plot(t, 1e3 * out[:, 1], t, 1e3 * x_ref)
    above.set_ylabel("x, mm")
    below.plot(t, out[:, 3])
    below.set(xlabel="t, s", ylabel="u_c, V")
    plt.show()
'''


def python(parts: Content) -> Mapping[str, str]:
    """Return the texts of the files, by name."""
    program, begin = parts.begin()
    ticks, tick = parts.tick()
    texts = _functions(program) | _functions(ticks)
    bodies = [*texts.values(), TAIL.replace("BEGIN", begin.call).replace("TICK", tick.call)]
    if not parts.without_rates:
        rates_program, rates, _ = parts.rates()
        bodies[-1:-1] = [text for key, text in _functions(rates_program).items() if key not in texts]
        bodies.append(
            "def rates(i, x, v, u):\n"
            '    """Return the rates of i_c, x and x\', (11)-(12) with the causes, between the stops."""\n'
            f"    return {rates.call}\n"
        )
    head = HEAD.format(
        title=parts.title,
        notes="".join(f"{note}.\n" for note in parts.notes),
        T_s=parts.controller.numbers.sample_time_s,
        count=PLACES,
        numbers="\n".join(_numbers(parts)),
    )
    tables = {**program.tables, **ticks.tables}
    rows = "".join(f"{key} = {row!r}\n" for key, row in tables.items())
    return {"rig.py": head + (f"{rows}\n\n" if rows else "\n") + "\n\n".join(bodies), "figure_11.py": FIGURE}


def _numbers(parts: Content) -> list[str]:
    noise, linear = parts.model.noise, parts.linear
    lines = []
    for variable in parts.listed:
        unit = f"{variable.unit}, " if variable.unit else ""
        lines.append(f"m.{variable.field} = {variable.start!r}  # {unit}{variable.description}")
    lines += [f"m.{key} = {value!r}" for key, value in parts.delays]
    lines += [
        f"m.places = {parts.places}  # length of the memory",
        f"m.sigma_i, m.sigma_x = {noise.sigma_i_c_a!r}, {noise.sigma_x_m!r}  # A, m: noise of the sensors",
        f"m.process_i, m.process_a = {noise.process_i_c_a!r}, {noise.process_a_m_s2!r}  # A, m/s^2: over a tick",
        f"m.Q, m.R = {parts.controller.weights.Q!r}, {parts.controller.weights.R!r}  # weights of (17)",
        f"m.delay = {linear.delay_s!r}  # s, of u_c",
    ]
    for key in ("A", "B", "Phi", "Gamma", "Phi_prompt", "Gamma_prompt"):
        lines.append(f"m.{key} = {getattr(linear, key).tolist()!r}")
    return lines


def _functions(program: Program) -> dict[str, str]:
    return {key: _text(written) for key, written in program.functions.items()}


def _text(written: Function) -> str:
    body = [ast.unparse(ast.fix_missing_locations(statement)) for statement in written.body]
    lines = [f"    {line}" for text in body for line in text.splitlines()]
    return "\n".join([f"def {written.call}:", f'    """{written.summary}"""', *lines, ""])
