"""The rig for MATLAB and Octave: numbers, simulation, differential equation, linear model, gains, figure 11."""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np

from twin.estimation.record import FloatArray
from twin.export.script.content import STEP_SHARE, Content
from twin.export.translate.matlab import functions, number
from twin.export.translate.specialise import Function, Program
from twin.export.variables import Variable
from twin.model.causes.cause import PLACES
from twin.model.extended import I_C, V, X
from twin.model.simulate import I_READ, X_BEFORE, X_READ

FIGURE = f"""\
function [t, x, x_ref, u] = figure_11(noise)
% The closed loop with measurement noise, simulated: figure 11 of the paper.
%
% noise: factor on all noise levels (1); 0: none.  Without outputs the figure is drawn.
    if nargin < 1, noise = 1; end
    m = rig_parameters();
    t = (0:round(4 / m.T_s) - 1)' * m.T_s;
    x_ref = m.x_0 + {STEP_SHARE} * m.travel_m * sign(mod(t - 1, 2) - 1) .* (t >= 1);
    memory = rig_begin(m, m.i_0, m.x_0, 0, m.u_0);
    x = zeros(size(t)); u = x;
    for k = 1:numel(t)
        memory({I_READ + 1}) = memory({I_READ + 1}) + noise * m.sigma_i * randn();
        memory({X_READ + 1}) = memory({X_READ + 1}) + noise * m.sigma_x * randn();
        [memory, ~, x(k), ~, u(k)] = rig_tick(m, memory, true, x_ref(k), 0);
        memory({I_C + 1}) = memory({I_C + 1}) + noise * m.process_i * randn();
        if memory({X + 1}) > 0 && memory({X + 1}) < m.travel_m
            memory({V + 1}) = memory({V + 1}) + noise * m.process_a * m.T_s * randn();
        end
    end
    if nargout == 0
        subplot(2, 1, 1); plot(t, 1e3 * x, t, 1e3 * x_ref); ylabel('x, mm'); legend('simulated', 'reference');
        subplot(2, 1, 2); plot(t, u); ylabel('u_c, V'); xlabel('t, s');
    end
end
"""
GAINS = """\
function K = lqi_gains(Phi, Gamma, T_s, Q, R)
% The gains of (18) for [i_c - i_0, x - x_0, x', integral of (x_ref - x)], by (16) and (17).
%
% The Riccati equation is iterated until it stands still: no toolbox is needed.
    A = [Phi, zeros(3, 1); 0, -T_s, 0, 1];
    B = [Gamma; 0];
    P = diag(Q);
    for n = 1:1000000
        K = (R + B' * P * B) \\ (B' * P * A);
        next = diag(Q) + A' * P * (A - B * K);
        next = (next + next') / 2;
        still = max(max(abs(next - P))) <= 1e-13 * max(max(abs(next)));
        P = next;
        if still, return; end
    end
    error('The gains do not settle: choose weights less far apart');
end
"""


def matlab(parts: Content) -> Mapping[str, str]:
    """Return the texts of the files, by name."""
    files = {
        "rig_parameters.m": _parameters(parts),
        "rig_begin.m": _main("memory = rig_begin(m, i, x, v, u)", _BEGIN, *parts.begin()),
        "rig_tick.m": _main("[memory, i, x, v, u] = rig_tick(m, memory, closed_loop, x_ref, u)", _TICK, *parts.tick()),
        "rig_linear.m": _linear(parts),
        "figure_11.m": FIGURE,
    }
    if parts.controller.law == "lqi":
        files["lqi_gains.m"] = GAINS
    if not parts.without_rates:
        files["rig_ode.m"] = _ode(parts)
    return files


_BEGIN = f"""\
% The memory of a rig with these readings (A, m) and speed (m/s) after a long time under the input u (V).
    memory = zeros(m.places, 1);
    memory = CALL;
    memory({X_BEFORE + 1}) = memory({X_READ + 1});
"""
_TICK = """\
% One tick of T_s under x_ref (closed loop) or u (open loop): readings of i and x, speed and u of its beginning.
    [memory, i, x, v, u] = CALL;
"""


def _main(head: str, body: str, program: Program, called: Function) -> str:
    return "\n".join([f"function {head}", body.replace("CALL", called.call) + "end\n", functions(program)])


def _parameters(parts: Content) -> str:
    noise, T_s = parts.model.noise, parts.controller.numbers.sample_time_s
    lines = [
        "function m = rig_parameters()",
        f"% {parts.title}: all numbers, in SI units.  (N) is equation N of the paper.",
        *(f"% {note}." for note in parts.notes),
        f"    m.T_s = {number(T_s)}; % s",
        f"    m.places = {parts.places}; % length of the memory",
        f"    m.c = zeros(1, {PLACES}); % parameters of the causes",
        *(_line(variable) for variable in parts.listed),
        *(f"    m.{key} = {number(value)};" for key, value in parts.delays),
        f"    m.sigma_i = {number(noise.sigma_i_c_a)}; % A, noise of the current sensor",
        f"    m.sigma_x = {number(noise.sigma_x_m)}; % m, noise of the position sensor",
        f"    m.process_i = {number(noise.process_i_c_a)}; % A, per tick",
        f"    m.process_a = {number(noise.process_a_m_s2)}; % m/s^2, over a tick",
        f"    m.Q = [{', '.join(map(number, parts.controller.weights.Q))}]; m.R = {number(parts.controller.weights.R)};"
        " % weights of (17)",
    ]
    return "\n".join([*lines, "end", ""])


def _line(variable: Variable) -> str:
    field = re.sub(r"\[(\d+)\]", lambda index: f"({int(index[1]) + 1})", variable.field)
    unit = f"{variable.unit}, " if variable.unit else ""
    return f"    m.{field} = {number(variable.start)}; % {unit}{variable.description}"


def _ode(parts: Content) -> str:
    program, right, read = parts.rates()
    return "\n".join(
        [
            "function [dx, y] = rig_ode(t, state, u, m)",
            "% (11)-(12) with the causes of this model: rates of [i_c; x; x'] (A, m, m/s) and readings of i_c and x.",
            "%",
            "% Between the stops only: end the integration at x = 0 and x = m.travel_m.",
            "%   m = rig_parameters();",
            "%   ode45(@(t, s) rig_ode(t, s, m.u_0, m), [0 0.05], [m.i_0; m.x_0; 0])",
            "    i = state(1); x = state(2); v = state(3);",
            "    dx = zeros(3, 1); y = zeros(2, 1);",
            f"    [dx(1), dx(2), dx(3)] = {right.call};",
            f"    [y(1), y(2)] = {read.call};",
            "end",
            "",
            functions(program),
        ]
    )


def _linear(parts: Content) -> str:
    linear, n = parts.linear, len(parts.linear.A)
    return f"""\
function s = rig_linear()
% The linear model (14), (15) at the operating point x_0 of `rig_parameters`, as deviations from it.
%
% States: readings of i_c and x, speed{"" if n == 3 else ", then those of the causes"}; input u_c; outputs i_c and x.
% (14) is without the delay of u_c; in (15) past inputs are the last states.
    s.A = {_matrix(linear.A)};
    s.B = {_matrix(linear.B)};
    s.C = [eye(2), zeros(2, {n - 2})];
    s.D = zeros(2, 1);
    s.delay = {number(linear.delay_s)}; % s, of u_c
    s.Phi = {_matrix(linear.Phi)};
    s.Gamma = {_matrix(linear.Gamma)};
    % Without states that no channel measures: the plant of (18).
    s.Phi_prompt = {_matrix(linear.Phi_prompt)};
    s.Gamma_prompt = {_matrix(linear.Gamma_prompt)};
    s.T_s = {number(parts.controller.numbers.sample_time_s)};
end
"""


def _matrix(values: FloatArray) -> str:
    return "[" + "; ".join(", ".join(map(number, row)) for row in np.asarray(values).tolist()) + "]"
