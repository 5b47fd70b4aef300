"""The rig as a Modelica package: parameters, equations, a model with stops, and its closed loop.

Rule: causes without a differential equation are refused: the FMU has them, and a Modelica tool imports it.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

from twin.export.script.content import STEP_SHARE, Content
from twin.export.translate.modelica import functions, number
from twin.export.translate.specialise import Function
from twin.export.translate.values import NotTranslatableError
from twin.model.causes.cause import PLACES


def modelica(parts: Content) -> Mapping[str, str]:
    """Return the texts of the files, by name.

    Raises:
        NotTranslatableError: a cause has no differential equation; the message says which and why.
    """
    if parts.without_rates:
        raise NotTranslatableError(
            f"Modelica cannot express a part of this model. {'. '.join(parts.without_rates)}",
            remedy="Export with --to fmu, which Modelica tools import, or leave the cause out of the model",
        )
    program, rates, readings = parts.rates()
    body = "\n".join([_parameters(parts), functions(program), _rig(rates, readings), _LOOP])
    indented = "\n".join(f"  {line}" if line else "" for line in body.splitlines())
    return {
        "MagneticLevitation.mo": f'package MagneticLevitation "{parts.title}"\n{indented}\nend MagneticLevitation;\n'
    }


def _parameters(parts: Content) -> str:
    elements, c = [], ["0.0"] * PLACES
    for variable in parts.listed:
        index = re.fullmatch(r"c\[(\d+)\]", variable.field)
        if index:
            c[int(index[1])] = number(variable.start)
            continue
        unit = f'(unit="{_unit(variable.unit)}")' if variable.unit else ""
        elements.append(f'  Real {variable.field}{unit} = {number(variable.start)} "{variable.description}";')
    return "\n".join(
        [
            'record Parameters "Numbers of the rig, SI units"',
            f'  Real T_s(unit="s") = {number(parts.controller.numbers.sample_time_s)} "sampling interval of the law";',
            *elements,
            f'  Real c[{PLACES}] = {{{", ".join(c)}}} "parameters of the causes";',
            "end Parameters;",
            "",
        ]
    )


def _unit(unit: str) -> str:
    """A unit as Modelica writes it: N.m2/A2 and V/(m.s)."""
    return unit.replace("^", "").replace(" ", ".")


def _rig(rates: Function, readings: Function) -> str:
    return f"""\
model Rig "Amplifier, ball and coil, (1) and (6) with the causes, and inelastic stops"
  parameter Parameters m;
  input Real u(unit="V") "u_c";
  Real i(unit="A", start = m.i_0, fixed = true) "current of the coil";
  Real x(unit="m", start = m.x_0, fixed = true) "position of the ball, up from the bottom stop";
  Real v(unit="m/s", start = 0, fixed = true) "speed of the ball";
  output Real y_i(unit="A") "reading of the current sensor";
  output Real y_x(unit="m") "reading of the position sensor";
protected
  Real di, dx, dv;
  Boolean bottom "the ball rests on the bottom stop";
  Boolean top "the ball is held against the top stop";
equation
  (di, dx, dv) = {rates.call};
  (y_i, y_x) = {readings.call};
  bottom = x <= 0 and v <= 0 and dv <= 0;
  top = x >= m.travel_m and v >= 0 and dv >= 0;
  der(i) = di;
  der(x) = if bottom or top then 0 else dx;
  der(v) = if bottom or top then 0 else dv;
  when {{bottom, top}} then
    reinit(v, 0);
    reinit(x, if bottom then 0 else m.travel_m);
  end when;
end Rig;
"""


_LOOP = f"""\
model ClosedLoop "The rig under its control law, with steps of the reference"
  parameter Parameters m;
  Rig rig(m = m);
  discrete Real u(unit="V", start = m.u_0, fixed = true);
  discrete Real x_ref(unit="m", start = m.x_0, fixed = true);
  discrete Real s(unit="m.s", start = 0, fixed = true) "integral of x_ref - x";
  discrete Real x_before(unit="m", start = m.x_0, fixed = true);
protected
  discrete Real free(start = m.u_0, fixed = true) "u without its limits";
equation
  rig.u = u;
algorithm
  when sample(0, m.T_s) then
    x_ref := m.x_0 + (if time < 1 then 0 else {STEP_SHARE} * m.travel_m * (if mod(time - 1, 2) < 1 then -1 else 1));
    free := m.u_0 - m.k_i * (rig.y_i - m.i_0) - m.k_x * (rig.y_x - m.x_0) + m.k_p * (x_ref - rig.y_x)
      - m.k_v * (rig.y_x - x_before) / m.T_s + m.k_s * s;
    u := min(max(free, m.u_low), m.u_high);
    if not (free > m.u_high and m.k_s * (x_ref - rig.y_x) > 0 or free < m.u_low and m.k_s * (x_ref - rig.y_x) < 0) then
      s := min(max(s + (x_ref - rig.y_x) * m.T_s, -m.s_max), m.s_max);
    end if;
    x_before := rig.y_x;
  end when;
  annotation (experiment(StopTime = 4));
end ClosedLoop;
"""
